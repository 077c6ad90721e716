"""A quantity of two sets of runs: what became worse for the AV, what is ruled out, what is open.

`check`, `compare` and the tables of plans choose runs, quantities and words; the difference, its
interval and what that decides are made here, of `matching`.
"""

from dataclasses import dataclass
from typing import Final, Literal

import pandas as pd

from deepmf_sumo.results.matching import Matched, answer, match
from deepmf_sumo.results.quantities import Quantity

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
