"""Results against a baseline: what has become worse for the AV beyond chance.

The intervals of all comparisons hold together (Bonferroni), so that equal planners raise a false
alarm in at most (1 - confidence) / 2 of all jobs, however much is compared.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from deepmf_sumo.benchmark.gate.limits import ALL
from deepmf_sumo.benchmark.gate.matching import Matched, match
from deepmf_sumo.benchmark.gate.quantities import BY_QUANTITY, Quantity
from deepmf_sumo.benchmark.gate.randomisation import Difference
from deepmf_sumo.benchmark.gate.rows import Results, Row
from deepmf_sumo.benchmark.gate.thresholds import Baseline
from deepmf_sumo.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One quantity over one group of runs, new results and baseline.

    Attributes:
        group: e.g. ``all runs`` or ``planner idm corridor``.
        found: the difference, new minus old, and what it is of.
        tolerance: by how much it may be worse.
    """

    group: str
    quantity: str
    unit: str
    found: Matched
    tolerance: float
    state: Literal["same", "worse", "better", "too few"]


def compare(wanted: Baseline, new: Results, old: Results) -> list[Comparison]:
    """A comparison for each quantity asked for.

    Raises UsageError where the baseline was made by another version of the program.
    """
    if new.version != old.version:
        raise UsageError(
            f"{old.source} was made by version {old.version} of deepmf-sumo and {new.source} by"
            f" {new.version}: attacks of two versions differ; make the baseline anew with"
            " --write-baseline."
        )
    groups = _groups(wanted.by, new.rows.values())
    confidence = 1 - (1 - wanted.confidence) / max(len(groups) * len(wanted.quantities), 1)
    return [
        _compare(
            group, BY_QUANTITY[name], _of(new, wanted.by, member), _of(old, wanted.by, member),
            confidence, wanted.tolerance.get(name, BY_QUANTITY[name].negligible),
        )
        for group, member in groups.items()
        for name in wanted.quantities
    ]  # fmt: skip


def _groups(by: str, rows: Iterable[Row]) -> dict[str, str]:
    """Name of each group, and what its rows have in common; a baseline's own are left out."""
    if by == "all":
        return {ALL: ""}
    names = {getattr(row, by) for row in rows if row.judged}
    return {f"{by} {name}": name for name in sorted(names)}


def _of(results: Results, by: str, member: str) -> list[Row]:
    return [row for row in results.rows.values() if by == "all" or getattr(row, by) == member]


def attack_changed(new: Results, old: Results) -> int:
    """Pairs in which the attack was set up differently: a difference may be the attack's."""
    common = new.rows.keys() & old.rows.keys()
    pairs = [(new.rows[run_id], old.rows[run_id]) for run_id in common]
    return sum(bool(a.attack and b.attack and a.attack != b.attack) for a, b in pairs)


def _compare(
    group: str,
    quantity: Quantity,
    new: list[Row],
    old: list[Row],
    confidence: float,
    tolerance: float,
) -> Comparison:
    found = match(quantity.name, new, old, confidence)
    return Comparison(
        group=group,
        quantity=quantity.name,
        unit=quantity.unit,
        found=found,
        tolerance=tolerance,
        state=_state(quantity, found.difference, tolerance),
    )


def _state(
    quantity: Quantity, difference: Difference | None, tolerance: float
) -> Literal["same", "worse", "better", "too few"]:
    if difference is None or difference.low is None or difference.high is None:
        return "too few"
    low, high = difference.low, difference.high
    if quantity.worse == "lower":
        low, high = -high, -low
    if low > tolerance:
        return "worse"
    return "better" if high < 0 else "same"
