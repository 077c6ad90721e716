"""Which faults the gate of `deepmf-sumo check` reports when one method attacks all planners.

Each planner has a result folder; the careful planner's is the baseline of the others. Its runs with
other seeds are compared with it as well: what the gate reports there is a false alarm.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import yaml

from deepmf_sumo import gate
from deepmf_sumo import spec as specs
from deepmf_sumo.gate.verdict import regression
from deepmf_sumo.spec import Spec
from deepmf_sumo.sweep import batch
from studies.planner_faults.faults import FAULTS
from studies.planner_faults.halves import halves

SCENARIOS: Final = Path(__file__).resolve().parents[2] / "scenarios"
FAULTY: Final = "studies.planner_faults.faults:Faulty"


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What is measured.

    Attributes:
        method: an adversary as in a spec, YAML; its ``opponent`` stays that of each spec
            that names one.
        budget: simulations of an attack; None is the method's own.
        other_seeds: of the runs for false alarms.
        thresholds: a file of `check`; None compares what `check` compares by itself.
    """

    method: str
    budget: int | None
    jobs: int
    seeds: tuple[int, ...]
    other_seeds: tuple[int, ...]
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
            jobs=given.jobs,
            seeds=tuple(given.seeds),
            other_seeds=tuple(given.false_alarms),
            faults=tuple(given.faults or (name for name in FAULTS if half[name] == "open")),
            specs=tuple(given.specs or sorted(SCENARIOS.glob("*.yaml"))),
            thresholds=given.thresholds,
            out=given.out,
        )


class Found(NamedTuple):
    """A planner, its runs, and what the gate says of them against the careful planner."""

    planner: str
    runs: int
    hits: int
    avoidable: int
    verdict: str


def measured(asked: Asked) -> Iterator[Found]:
    """The careful planner, its other seeds, and each faulty copy. Raises DeepmfError."""
    thresholds = gate.load(asked.thresholds) if asked.thresholds else _default()
    baseline = _run(asked, "none", "careful", asked.seeds)
    yield _found("careful", baseline, "baseline")
    again = _run(asked, "none", "careful_again", asked.other_seeds)
    yield _found("careful, other seeds", again, _verdict(again, thresholds, baseline))
    for name in asked.faults:
        out = _run(asked, name, name, asked.seeds)
        yield _found(name, out, _verdict(out, thresholds, baseline))


def table(found: Iterator[Found]) -> str:
    """A line a planner."""
    lines = [f"{'planner':22} {'runs':>5} {'hits':>5} {'avoidable':>9}  the gate's verdict"]
    lines.extend(
        f"{one.planner:22} {one.runs:5} {one.hits:5} {one.avoidable:9}  {one.verdict}"
        for one in found
    )
    return "\n".join(lines)


def _default() -> gate.Thresholds:
    return gate.Thresholds.model_validate({"version": 1})


def _run(asked: Asked, fault: str, folder: str, seeds: Sequence[int]) -> Path:
    out = asked.out / folder
    loaded = [spec_of(file, asked, fault) for file in asked.specs]
    each = [one.model_copy(update={"seed": seed}) for one in loaded for seed in seeds]
    options = batch.Options(out=out, jobs=asked.jobs, resume=out.exists())
    batch.run(each, options)
    return out


def spec_of(file: Path, asked: Asked, fault: str) -> Spec:
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
    return specs.load(file, sets)


def _verdict(out: Path, thresholds: gate.Thresholds, baseline: Path) -> str:
    """What is worse than the baseline and by how much; else the state of each judged quantity."""
    judged = [
        one
        for one in gate.check(out, thresholds, baseline).comparisons or ()
        if one.state != "not judged"
    ]
    worse = [f"REPORTED: {regression(one)}" for one in judged if one.state == "worse"]
    return "; ".join(worse or [f"{one.quantity}: {one.state}" for one in judged])


def _found(name: str, out: Path, verdict: str) -> Found:
    rows = list(gate.read(out).rows.values())
    hits = sum(row.values.get("collision_rate", 0.0) for row in rows)
    avoidable = sum(row.values.get("avoidable_rate", 0.0) for row in rows)
    return Found(name, len(rows), round(hits), round(avoidable), verdict)
