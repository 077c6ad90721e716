"""Which faults the gate of `deepmf-sumo check` reports when one method attacks all planners.

Each planner has a result folder; the careful planner's is the baseline of the others. Its runs with
other seeds are compared with it as well: what the gate reports there is a false alarm.

Whether a failure is the fault's is tested too. In the first three failures that `report` shows, the
opponent drives the same path again, against the copy and against the careful planner. The failure
is the fault's if the copy is hit again and the careful planner is not.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import yaml

from deepmf_sumo import gate
from deepmf_sumo import spec as specs
from deepmf_sumo.gate.verdict import regression
from deepmf_sumo.plans import run_specs
from deepmf_sumo.results.failures import failures
from deepmf_sumo.results.groups import grouped
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.shrink import read
from deepmf_sumo.shrink.candidate import AFTER_STEPS, Candidate, path_of, spec_values
from deepmf_sumo.spec import FromMoments, Spec
from deepmf_sumo.sweep import batch
from studies.planner_faults.faults import FAULTS
from studies.planner_faults.halves import halves

SUITE: Final = Path(__file__).resolve().parent / "suite"
"""Moments of the packaged networks' traffic: each is a situation of its own for the gate."""
FAULTY: Final = "studies.planner_faults.faults:Faulty"
_SHOWN: Final = 3
"""Groups of failures at the top of `report`, each with an example."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What is measured.

    Attributes:
        method: an adversary as in a spec, YAML; its ``opponent`` stays that of each spec
            that names one.
        budget: simulations of an attack; None is the method's own.
        moments: in place of the number in specs that choose moments; None keeps it.
        other_seeds: of the runs for false alarms, one comparison each.
        thresholds: a file of `check`; None compares what `check` compares by itself.
    """

    method: str
    budget: int | None
    moments: int | None
    jobs: int
    seeds: tuple[int, ...]
    other_seeds: tuple[tuple[int, ...], ...]
    faults: tuple[str, ...]
    specs: tuple[Path, ...]
    thresholds: Path | None
    out: Path

    @classmethod
    def of(cls, given: argparse.Namespace) -> Self:
        """Of the command line."""
        half = halves(FAULTS)
        return cls(
            method=given.method,
            budget=given.budget,
            moments=given.moments,
            jobs=given.jobs,
            seeds=tuple(given.seeds),
            other_seeds=tuple(given.false_alarms),
            faults=tuple(given.faults or (name for name in FAULTS if half[name] == "open")),
            specs=tuple(given.specs or sorted(SUITE.glob("*.yaml"))),
            thresholds=given.thresholds,
            out=given.out,
        )


class Found(NamedTuple):
    """A planner, its runs, and what the gate says of them against the careful planner.

    ``episodes``: simulated ones, all tries counted. ``shown``: failures that `report` shows first;
    ``own``: of these the fault's. ``reported``: a judged quantity is worse.
    """

    planner: str
    runs: int
    episodes: int
    hits: int
    avoidable: int
    valid: int
    shown: int
    own: int
    reported: bool
    verdict: str


def measured(asked: Asked) -> Iterator[Found]:
    """The careful planner, its other seeds, and each faulty copy. Raises DeepmfError."""
    thresholds = gate.load(asked.thresholds) if asked.thresholds else _default()
    baseline = _run(asked, "none", "careful", asked.seeds)
    yield _found("careful", baseline, (0, 0), (False, "baseline"))
    for seeds in asked.other_seeds:
        name = "-".join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))
        again = _run(asked, "none", f"careful_{name}", seeds)
        judged = _verdict(again, thresholds, baseline)
        yield _found(f"careful, seed {name}", again, (0, 0), judged)
    for name in asked.faults:
        out = _run(asked, name, name, asked.seeds, baseline)
        own = _own(asked, name, out)
        yield _found(name, out, own, _verdict(out, thresholds, baseline))


def table(found: Iterator[Found]) -> str:
    """A line a planner, and how many of each kind the gate reports."""
    rows = list(found)
    columns = Found._fields[1:8]
    lines = [
        f"{'planner':22}" + "".join(f"{name:>10}" for name in columns) + "  the gate's verdict"
    ]
    lines.extend(
        f"{one.planner:22}" + "".join(f"{getattr(one, name):10}" for name in columns)
        + f"  {one.verdict}"
        for one in rows
    )  # fmt: skip
    half = halves(FAULTS)
    for title, kind in (("careful, other seeds", ""), ("open", "open"), ("held out", "held out")):
        of = [one for one in rows[1:] if half.get(one.planner, "") == kind]
        reported = f"{title}: {sum(one.reported for one in of)} of {len(of)} reported"
        first = f"; of {sum(one.own > 0 for one in of)} a failure of its own is shown first"
        lines.append(reported + first * bool(kind))
    return "\n".join(lines)


def _default() -> gate.Thresholds:
    return gate.Thresholds.model_validate({"version": 1})


def _run(
    asked: Asked, fault: str, folder: str, seeds: Sequence[int], like: Path | None = None
) -> Path:
    """The result folder of a planner; with ``like`` at the moments of that folder's runs."""
    out = asked.out / folder
    loaded = [spec_of(file, asked, fault, like) for file in asked.specs]
    each = [one.model_copy(update={"seed": seed}) for one in loaded for seed in seeds]
    run_specs(each, batch.Options(out=out, jobs=asked.jobs, resume=out.exists()))
    return out


def spec_of(file: Path, asked: Asked, fault: str, like: Path | None = None) -> Spec:
    """A spec with the method and the faulty copy in place of its own."""
    before = specs.load(file).adversary.settings
    method: Any = yaml.safe_load(asked.method)
    adversary = {"name": method} if isinstance(method, str) else dict(method)
    if "opponent" in before and adversary.get("name", "deepmf") == "deepmf":
        adversary.setdefault("opponent", before["opponent"])
    sets = [
        f"planner={yaml.safe_dump({'name': FAULTY, 'fault': fault}, default_flow_style=True)}",
        f"adversary={yaml.safe_dump(adversary, default_flow_style=True)}",
        "expect={}",
    ]
    if asked.budget is not None:
        sets.append(f"budget={{simulations: {asked.budget}}}")
    spec = specs.load(file, sets)
    if not isinstance(spec.source, FromMoments):
        return spec
    if like is not None:
        sets.append(f"source.moments={{of: {json.dumps(str(like.resolve()))}}}")
    elif asked.moments is not None:
        sets.append(f"source.moments.count={asked.moments}")
    return specs.load(file, sets)


def _own(asked: Asked, fault: str, out: Path) -> tuple[int, int]:
    """The number of failures that are shown first, and of those the fault's own."""
    results = Results.of(out)
    found = [one for _, one, _ in failures(results) if one is not None and one.kind == "hit"]
    examples = [one.example.run for one in grouped(found, len(results.runs))[:_SHOWN]]
    if not examples:
        return 0, 0
    planners = fault, "none"
    each = [_again(run, planner) for run in examples for planner in planners]
    folder = asked.out / "again" / fault
    done = run_specs(each, batch.Options(out=folder, jobs=asked.jobs, resume=folder.exists()))
    hit = [one["outcome"] == "av_opponent" for one in done]
    return len(examples), sum(
        bad and not good for bad, good in zip(hit[::2], hit[1::2], strict=True)
    )


def _again(run: Run, planner: str) -> Spec:
    """The run again, with the opponent on the path that it drove."""
    failure = read(run.folder)
    last, plans = failure.contact + AFTER_STEPS, len(failure.plans)
    candidate = Candidate(last=last, contact=failure.contact, only=None, plans=plans)
    values = spec_values(candidate, failure, path_of(candidate, failure, None))
    values["name"] = f"{planner} {failure.run_id[:180]}"
    values["planner"] = {"name": FAULTY, "fault": planner}
    return Spec.model_validate(values | {"expect": {}})


def _verdict(out: Path, thresholds: gate.Thresholds, baseline: Path) -> tuple[bool, str]:
    """What is worse than the baseline and by how much; else the state of each judged quantity."""
    judged = [
        one
        for one in gate.check(out, thresholds, baseline).comparisons or ()
        if one.state != "not judged"
    ]
    worse = [f"REPORTED: {regression(one)}" for one in judged if one.state == "worse"]
    states = [f"{one.quantity}: {one.state}" for one in judged]
    return bool(worse), "; ".join(worse or states)


def _found(name: str, out: Path, own: tuple[int, int], verdict: tuple[bool, str]) -> Found:
    done = Results.of(out).done
    metrics = [
        sum(run.metric(one) == 1 for run in done) for one in ("avoidable", "valid_collision")
    ]
    episodes = sum(int(run.result["search"]["simulations"]) for run in done)
    return Found(name, len(done), episodes, sum(run.hit for run in done), *metrics, *own, *verdict)
