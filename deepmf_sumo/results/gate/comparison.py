"""Results against a baseline: what has become worse for the AV, and what is ruled out.

A judged quantity is worse if the interval of the difference lies beyond the tolerance, and better
if it does on the other side. It passes if the interval rules out a worsening of the size that must
be ruled out. Else the runs cannot tell. The intervals of all judged comparisons hold together
(Bonferroni), at each end: equal planners raise a false alarm in at most 1 - confidence of all jobs,
and a planner that is worse by more passes in at most as many, however much is compared.
"""

from dataclasses import replace

import pandas as pd

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results.comparison import QuantityChange, change
from deepmf_sumo.results.gate.thresholds import ALL, COLUMN, SHOWN, Baseline
from deepmf_sumo.results.quantities import COMPARABLE
from deepmf_sumo.results.run_sets import RunSet


def compare(wanted: Baseline, new: RunSet, old: RunSet) -> list[QuantityChange]:
    """A comparison for each quantity asked for, and for `SHOWN` ones, which are not judged.

    Raises UsageError where the baseline has no spec in common with the results.
    """
    ours, theirs = (set(side.runs["spec"]) for side in (new, old))
    if ours and theirs and not ours & theirs:
        raise UsageError(
            f"{new.source} and the baseline {old.source} have no spec in common ({_some(ours)};"
            f" {_some(theirs)}), so a planner cannot be compared by them: take a baseline of the"
            " same specs."
        )
    groups = _groups(wanted.by, new.runs)
    alone = (1 - wanted.confidence) / max(len(groups) * len(wanted.quantities), 1)
    shown = [name for name in SHOWN if name not in wanted.quantities]
    found = []
    for group, member in groups.items():
        sides = _of(new, wanted.by, member), _of(old, wanted.by, member)
        judged = [_judged(name, *sides, alone, wanted) for name in wanted.quantities]
        beside = [_judged(name, *sides, 1 - wanted.confidence, wanted) for name in shown]
        beside = [replace(one, state="not judged", needed=None) for one in beside]
        found += [replace(one, group=group) for one in (*judged, *beside)]
    return found


def _some(names: set[str]) -> str:
    """``'cut-in', 'merge' and 4 more``."""
    first = ", ".join(f"'{name}'" for name in sorted(names)[:2])
    return first + (f" and {len(names) - 2} more" if len(names) > 2 else "")


def _groups(by: str, runs: pd.DataFrame) -> dict[str, str]:
    """Name of each group, and what its runs share; groups of the baseline alone are left out."""
    if by == "all":
        return {ALL: ""}
    names = set(runs.loc[runs["judged"], COLUMN[by]])
    return {f"{by} {name}": name for name in sorted(names)}


def _of(side: RunSet, by: str, member: str) -> pd.DataFrame:
    return side.runs if by == "all" else side.runs[side.runs[COLUMN[by]] == member]


def _judged(
    name: str, new: pd.DataFrame, old: pd.DataFrame, one_sided: float, wanted: Baseline
) -> QuantityChange:
    quantity = COMPARABLE[name]
    tolerance = wanted.tolerance.get(name, quantity.negligible)
    margin = max(wanted.rule_out.get(name, quantity.rule_out), tolerance)
    bounds = tolerance, margin
    return change(quantity, new, old, 1 - 2 * one_sided, bounds, one_sided=True)
