"""Randomisation tests of a difference, and the intervals that agree with them.

If nothing has changed, it is chance which of two paired values is the newer one: swapping them in
any subset of the pairs was as likely. A difference delta is refused where the observed mean is
among the most extreme of all swaps of ``difference - delta``. Solved for delta, every swap gives
the mean difference over the pairs that it swaps, and the interval is a range of quantiles of these
"typical values" (Hartigan, JASA 64, 1969). Nothing is assumed of the distribution, and rates are no
special case. Without pairs, which values belong to which side is drawn anew instead (Fisher, 1935).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Floats

DRAWS: Final = 9_999
_BATCH: Final = 1_111
_EXHAUSTIVE: Final = 13
"""Up to so many pairs all subsets are taken: 8,192."""
_SEED: Final = 20241217


class Difference(NamedTuple):
    """New minus old, with a two-sided interval; an end that too few values leave open is None."""

    mean: float
    low: float | None
    high: float | None


def fewest(confidence: float) -> int:
    """Units with which `paired` can have an interval: of n, one swap in 2^n is the rarest."""
    return math.ceil(math.log2(2 / (1 - confidence)) - 1e-9)


def fewest_unpaired(confidence: float) -> int:
    """Values, half of them on each side, with which `unpaired` can have an interval."""
    rarest = (1 - confidence) / 2
    side = 1
    while math.comb(2 * side, side) * rarest < 1 - 1e-9:
        side += 1
    return 2 * side


def paired(units: Sequence[Sequence[float]], confidence: float) -> Difference:
    """Of the differences within pairs; those of one unit depend on each other and swap together."""
    sums = np.array([sum(unit) for unit in units])
    counts = np.array([len(unit) for unit in units])
    swaps = _swaps(len(units))
    typical = (swaps @ sums) / (swaps @ counts)
    return _interval(float(sums.sum() / counts.sum()), typical, confidence)


@lru_cache(maxsize=8)
def _swaps(units: int) -> Floats:
    """(swaps, units) of 1 where a unit is swapped; all that swap something, or drawn ones."""
    if units <= _EXHAUSTIVE:
        return np.array(list(product((0.0, 1.0), repeat=units)))[1:]
    drawn = np.random.default_rng(_SEED).integers(0, 2, (DRAWS, units))
    return drawn[drawn.any(1)].astype(float)


def unpaired(new: Sequence[float], old: Sequence[float], confidence: float) -> Difference:
    """Of the means of two sets of values."""
    values = np.array([*new, *old])
    mine = np.arange(len(values)) < len(new)
    observed = values[mine].mean() - values[~mine].mean()
    rng = np.random.default_rng(_SEED)
    typical: list[Floats] = []
    for _ in range(DRAWS // _BATCH):
        drawn = rng.random((_BATCH, len(values))).argsort(1)
        side, rest = drawn[:, : len(new)], drawn[:, len(new) :]
        kept = mine[side].mean(1) - mine[rest].mean(1)  # of a shift of all new values
        moved = kept < 1
        shift = values[side].mean(1) - values[rest].mean(1)
        typical.append((observed - shift[moved]) / (1 - kept[moved]))
    found = np.concatenate(typical)
    return _interval(float(observed), found, confidence, as_observed=1 + DRAWS - len(found))


def _interval(mean: float, typical: Floats, confidence: float, as_observed: int = 1) -> Difference:
    """Quantiles of the typical values.

    Arrangements as observed, one at least, are as extreme as the observation for any difference.
    """
    order = np.sort(np.round(typical, 9))  # so that sums in another order do not break ties
    rare = int((1 - confidence) / 2 * (len(order) + as_observed) + 1e-9)
    if rare < as_observed:  # not even the most extreme arrangement is rare enough
        return Difference(mean, None, None)
    beyond = rare - as_observed
    return Difference(mean, float(order[beyond]), float(order[-1 - beyond]))
