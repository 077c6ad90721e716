"""A quantity of two sets of runs: what became worse for the AV, what is ruled out, what is open.

`check`, `compare` and the tables of plans choose runs, quantities and words; the difference, its
interval and what that decides are made here, of `matching`.
"""

from dataclasses import dataclass
from typing import Final, Literal

import pandas as pd

from deepmf_sumo.results.matching import Matched, answer, match
from deepmf_sumo.results.quantities import Quantity
from deepmf_sumo.results.statistics import by_chance

State = Literal["worse", "better", "within margin", "cannot tell", "not judged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantityChange:
    """One quantity of two sets of runs, new and old.

    Attributes:
        found: the difference, new minus old, and what it is of.
        tolerance: a difference up to it does not matter, however sure it is.
        margin: the whole interval must lie within it for ``within margin``.
        needed: about how many units would decide, where these do not.
        often: situations that are worse by more than the tolerance, and better; where they alone
            say ``worse``, else None.
        group: what the runs have in common, e.g. ``planner idm corridor``; empty for all.
    """

    quantity: str
    unit: str
    found: Matched
    state: State
    tolerance: float
    margin: float
    needed: int | None = None
    often: tuple[int, int] | None = None
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

    The mean says little where few situations differ, or differ little beside how much situations
    vary. ``one_sided``, a quantity is therefore worse, too, if more situations are worse than
    better, by more than the tolerance, than a fair coin would give (sign test), and if the mean is
    not better. A planner compared with itself in the same situations differs in none.

    Args:
        quantity: what is compared.
        new: runs as of `Results.frame`.
        old: the same.
        confidence: of the two-sided interval.
        bounds: tolerance and margin; those of the quantity where none are given.
        one_sided: only a worsening beyond the margin must be ruled out for ``within margin``, and
            situations are counted.
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
    often = None
    if one_sided and state != "worse":
        often = _oftener_worse(found, quantity, tolerance, (1 - confidence) / 2)
    return QuantityChange(
        quantity=quantity.name,
        unit=quantity.unit,
        found=found,
        state="worse" if often else state,
        tolerance=tolerance,
        margin=margin,
        needed=None if often else needed,
        often=often,
    )


def _oftener_worse(
    found: Matched, quantity: Quantity, tolerance: float, level: float
) -> tuple[int, int] | None:
    """How many situations are worse, and better; None if chance explains that."""
    sign = -1 if quantity.worse == "lower" else 1
    changes = [sign * mean for _, mean in found.each]
    worse = sum(one > tolerance for one in changes)
    better = sum(one < -tolerance for one in changes)
    told = sum(changes) > 0 and by_chance(worse, better) < level
    return (worse, better) if told else None
