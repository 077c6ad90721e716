"""Which faults the gate of `deepmf-sumo check` reports when one method attacks all planners.

Each planner has a result folder; the careful planner's is the baseline of the others. Its runs with
other seeds are compared with it as well: what the gate reports there is a false alarm.

The hits of both planners are repeated as well (`check --same-attacks`): a hit that the careful
planner avoids where the opponent drives the same path is the fault's own. Whether one of the first
three failures that `report` shows is such a hit is counted.
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
from deepmf_sumo.gate.verdict import own_hits, regression
from deepmf_sumo.plans import run_specs
from deepmf_sumo.results.failures import failures
from deepmf_sumo.results.groups import grouped
from deepmf_sumo.results.reader import Results
from deepmf_sumo.spec import FromMoments, Spec
from deepmf_sumo.sweep import batch
from studies.planner_faults.faults import FAULTS
from studies.planner_faults.halves import halves

SUITE: Final = Path(__file__).resolve().parents[2] / "suite"
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

    ``episodes``: simulated ones, all tries counted, without the ``repeated`` ones. ``own``: hits
    that the careful planner avoids in the same attack; ``baseline_own``: the other way round.
    ``shown``: failures that `report` shows first; ``first``: own hits among them. ``reported``: a
    judged quantity is worse, or the own hits are more than chance.
    """

    planner: str
    runs: int
    episodes: int
    hits: int
    avoidable: int
    valid: int
    own: int = 0
    baseline_own: int = 0
    repeated: int = 0
    shown: int = 0
    first: int = 0
    reported: bool = False
    verdict: str = ""


def measured(asked: Asked) -> Iterator[Found]:
    """The careful planner, its other seeds, and each faulty copy. Raises DeepmfError."""
    thresholds = gate.load(asked.thresholds) if asked.thresholds else _default()
    baseline = _run(asked, "none", "careful", asked.seeds)
    yield _found(asked, "careful", baseline)
    for seeds in asked.other_seeds:
        name = "-".join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))
        again = _run(asked, "none", f"careful_{name}", seeds)
        yield _found(asked, f"careful, seed {name}", again, baseline, thresholds)
    for name in asked.faults:
        out = _run(asked, name, name, asked.seeds, baseline)
        yield _found(asked, name, out, baseline, thresholds)


def table(found: Iterator[Found]) -> str:
    """A line a planner, and how many of each kind the gate reports."""
    rows = list(found)
    columns = Found._fields[1:11]
    lines = [
        f"{'planner':22}" + "".join(f"{name:>13}" for name in columns) + "  the gate's verdict"
    ]
    lines.extend(
        f"{one.planner:22}" + "".join(f"{getattr(one, name):13}" for name in columns)
        + f"  {one.verdict}"
        for one in rows
    )  # fmt: skip
    half = halves(FAULTS)
    for title, kind in (("careful, other seeds", ""), ("open", "open"), ("held out", "held out")):
        of = [one for one in rows[1:] if half.get(one.planner, "") == kind]
        reported = f"{title}: {sum(one.reported for one in of)} of {len(of)} reported"
        first = f"; of {sum(one.first > 0 for one in of)} an own hit is shown first"
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


def _shown(out: Path, same: gate.SameAttacks) -> tuple[int, int]:
    """The number of failures that are shown first, and of those the fault's own."""
    results = Results.of(out)
    found = [one for _, one, _ in failures(results) if one is not None and one.kind == "hit"]
    examples = [one.example.run.run_id for one in grouped(found, len(results.runs))[:_SHOWN]]
    return len(examples), sum(one in same.own for one in examples)


def _found(
    asked: Asked,
    name: str,
    out: Path,
    baseline: Path | None = None,
    thresholds: gate.Thresholds | None = None,
) -> Found:
    """A planner's runs; with a baseline, what the gate says of them."""
    done = Results.of(out).done
    metrics = [sum(run.metric(one) == 1 for run in done) for one in ("avoidable", "finding")]
    found = Found(
        planner=name,
        runs=len(done),
        episodes=sum(int(run.result["search"]["simulations"]) for run in done),
        hits=sum(run.hit for run in done),
        avoidable=metrics[0],
        valid=metrics[1],
        verdict="baseline",
    )
    if baseline is None or thresholds is None:
        return found

    def repeat(new: Path, old: Path) -> gate.SameAttacks:
        folder, level = asked.out / "same_attacks" / out.name, thresholds.baseline.confidence
        return gate.repeated(new, old, folder, level, asked.jobs)

    verdict = gate.check(out, thresholds, baseline, repeat=repeat)
    judged = [one for one in verdict.comparisons or () if one.state != "not judged"]
    same = verdict.same_attacks
    assert same is not None
    worse = [f"REPORTED: {regression(one)}" for one in judged if one.state == "worse"]
    worse += [f"REPORTED: {own_hits(same)}"] if same.state == "worse" else []
    states = [f"{one.quantity}: {one.state}" for one in judged]
    shown, first = _shown(out, same)
    return found._replace(
        own=len(same.own),
        baseline_own=len(same.baseline_own),
        repeated=2 * (same.hits + same.baseline_hits),
        shown=shown,
        first=first,
        reported=bool(worse),
        verdict="; ".join(worse or states),
    )
