"""A quantity of two sets of runs: what became worse for the AV, what is ruled out, what is open.

`check`, `compare` and the tables of plans choose runs, quantities and words; the difference, its
interval and what that decides are made here, of `matching`.
"""

from dataclasses import dataclass
from statistics import fmean
from typing import Final, Literal

import pandas as pd

from deepmf_sumo.results.matching import Matched, answer, match
from deepmf_sumo.results.quantities import Quantity, share

State = Literal["worse", "better", "within margin", "cannot tell", "not judged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantityChange:
    """One quantity of two sets of runs, new and old.

    Attributes:
        found: the difference, new minus old, and what it is of.
        tolerance: a difference up to it does not matter, however sure it is.
        margin: the whole interval must lie within it for ``within margin``.
        needed: about how many units would decide, where these do not.
        group: what the runs have in common, e.g. ``planner idm corridor``; empty for all.
    """

    quantity: str
    unit: str
    found: Matched
    state: State
    tolerance: float
    margin: float
    needed: int | None = None
    group: str = ""


_WORSE: Final = {"higher": "more", "lower": "less"}


def change(
    quantity: Quantity,
    new: pd.DataFrame,
    old: pd.DataFrame,
    confidence: float,
    bounds: tuple[float, float] | None = None,
    *,
    one_sided: bool = False,
) -> QuantityChange:
    """What the runs say of a quantity, by name a column of both frames.

    Args:
        quantity: what is compared.
        new: runs as of `Results.frame`.
        old: the same.
        confidence: of the two-sided interval.
        bounds: tolerance and margin; those of the quantity where none are given.
        one_sided: only a worsening beyond the margin must be ruled out for ``within margin``.
    """
    tolerance, margin = bounds or (quantity.negligible, quantity.margin)
    found = match(quantity.name, new, old, confidence, quantity.largest)
    more_is_worse = quantity.worse == "higher" if one_sided else None
    said, needed = answer(found, tolerance, margin, more_is_worse=more_is_worse)
    state: State
    if said in {"more", "less"}:
        state = "worse" if said == _WORSE[quantity.worse] else "better"
    else:
        state = "within margin" if said == "within margin" else "cannot tell"
    return QuantityChange(
        quantity=quantity.name,
        unit=quantity.unit,
        found=found,
        state=state,
        tolerance=tolerance,
        margin=margin,
        needed=needed,
    )


LEANING: Final = "pairs with worse "
"""Begin of the name of a quantity of `leaning`."""


def leaning(
    quantity: Quantity,
    new: pd.DataFrame,
    old: pd.DataFrame,
    confidence: float,
    *,
    one_sided: bool = False,
) -> QuantityChange:
    """The shares of pairs in which one side is worse by more than is negligible.

    A few runs with large differences hide many small ones in a mean, but not in these shares. A
    planner compared with itself in the same situations is worse in none.

    Args:
        quantity: a number, not a rate.
        new: runs; those of pairs have equal ids.
        old: the same.
        confidence: see `change`.
        one_sided: the same.
    """
    sign = 1.0 if quantity.worse == "higher" else -1.0
    of_share = share(f"{LEANING}{quantity.name}")
    before, now = _values(old, quantity.name), _values(new, quantity.name)
    worse = {key: sign * (value - before[key]) for key, value in now.items() if key in before}
    pairs = new.drop_duplicates("run_id", keep="last").set_index("run_id", drop=False)
    pairs = pairs.loc[list(worse)]
    ours, theirs = (
        [float(way * one > quantity.negligible) for one in worse.values()] for way in (1.0, -1.0)
    )
    marked = pairs.assign(**{of_share.name: ours}), pairs.assign(**{of_share.name: theirs})
    return change(of_share, *marked, confidence, one_sided=one_sided)


def _values(runs: pd.DataFrame, name: str) -> dict[str, float]:
    """The value of each situation and seed that has one."""
    values: dict[str, list[float]] = {}
    for run_id, value in zip(runs["run_id"], runs[name], strict=True):
        if not pd.isna(value):
            values.setdefault(run_id, []).append(float(value))
    return {run_id: fmean(found) for run_id, found in values.items()}
