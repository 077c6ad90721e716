"""Results against a baseline: what has become worse for the AV, and what is ruled out.

A judged quantity is worse if the interval of the difference lies beyond the tolerance, and better
if it does on the other side. It passes if the interval rules out a worsening of the size that must
be ruled out. Else the runs cannot tell. The intervals of all judged comparisons hold together
(Bonferroni), at each end: equal planners raise a false alarm in at most 1 - confidence of all jobs,
and a planner that is worse by more passes in at most as many, however much is compared.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from deepmf_sumo.errors import UsageError
from deepmf_sumo.gate.rows import Results, Row
from deepmf_sumo.gate.thresholds import ALL, SHOWN, Baseline
from deepmf_sumo.results.matching import Matched, answer, match
from deepmf_sumo.results.quantities import COMPARABLE, Quantity

State = Literal["passed", "worse", "better", "cannot tell", "not judged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One quantity over one group of runs, new results and baseline.

    Attributes:
        group: e.g. ``all runs`` or ``planner idm corridor``.
        found: the difference, new minus old, and what it is of.
        tolerance: by how much it may be worse, however sure that is.
        rule_out: a worsening of this size must be ruled out for a pass.
        needed: about how many units would decide, where these do not.
    """

    group: str
    quantity: str
    unit: str
    found: Matched
    tolerance: float
    rule_out: float
    state: State
    needed: int | None = None


def compare(wanted: Baseline, new: Results, old: Results) -> list[Comparison]:
    """A comparison for each quantity asked for, and for `SHOWN` ones, which are not judged.

    Raises UsageError where the baseline has no spec in common with the results.
    """
    ours, theirs = ({row.spec for row in each.rows.values()} for each in (new, old))
    if ours and theirs and not ours & theirs:
        raise UsageError(
            f"{new.source} and the baseline {old.source} have no spec in common ({_some(ours)};"
            f" {_some(theirs)}), so a planner cannot be compared by them: take a baseline of the"
            " same specs."
        )
    groups = _groups(wanted.by, new.rows.values())
    alone = (1 - wanted.confidence) / max(len(groups) * len(wanted.quantities), 1)
    shown = [name for name in SHOWN if name not in wanted.quantities]
    return [
        _compare(
            group, COMPARABLE[name], _of(new, wanted.by, member), _of(old, wanted.by, member),
            alone if name in wanted.quantities else 1 - wanted.confidence, wanted,
        )
        for group, member in groups.items()
        for name in (*wanted.quantities, *shown)
    ]  # fmt: skip


def _some(names: set[str]) -> str:
    """``'cut-in', 'merge' and 4 more``."""
    first = ", ".join(f"'{name}'" for name in sorted(names)[:2])
    return first + (f" and {len(names) - 2} more" if len(names) > 2 else "")


def _groups(by: str, rows: Iterable[Row]) -> dict[str, str]:
    """Name of each group, and what its rows share; groups of the baseline alone are left out."""
    if by == "all":
        return {ALL: ""}
    names = {getattr(row, by) for row in rows if row.judged}
    return {f"{by} {name}": name for name in sorted(names)}


def _of(results: Results, by: str, member: str) -> list[Row]:
    return [row for row in results.rows.values() if by == "all" or getattr(row, by) == member]


def _compare(
    group: str,
    quantity: Quantity,
    new: list[Row],
    old: list[Row],
    one_sided: float,
    wanted: Baseline,
) -> Comparison:
    name = quantity.name
    found = match(name, new, old, 1 - 2 * one_sided, quantity.largest)
    tolerance = wanted.tolerance.get(name, quantity.negligible)
    rule_out = max(wanted.rule_out.get(name, quantity.rule_out), tolerance)
    state, needed = _judged(quantity, found, tolerance, rule_out)
    if name not in wanted.quantities:
        state, needed = "not judged", None
    return Comparison(
        group=group,
        quantity=name,
        unit=quantity.unit,
        found=found,
        tolerance=tolerance,
        rule_out=rule_out,
        state=state,
        needed=needed,
    )


def _judged(
    quantity: Quantity, found: Matched, tolerance: float, rule_out: float
) -> tuple[State, int | None]:
    more_is_worse = quantity.worse == "higher"
    state, needed = answer(found, tolerance, rule_out, more_is_worse=more_is_worse)
    if state == "within margin":
        return "passed", None
    if state == "cannot tell":
        return state, needed
    return ("worse" if (state == "more") == more_is_worse else "better"), None
