"""How much a quantity differs between two sets of runs: new minus old, with an interval.

Runs of equal spec, scene, planner and seed are pairs. Where seeds differ, scenes are: their means
are compared, those of a planner if both sides have it. Where scenes differ too, nothing is paired.
Runs of one scene depend on each other, so a scene (of a spec on a network: the spec) counts once,
however many seeds it has.

Intervals agree with randomisation tests. If nothing has changed, chance decided which of two paired
values is the newer one: swapping them in any subset of the pairs was as likely. A difference delta
is refused where the observed mean is among the most extreme of all swaps of ``difference - delta``.
Solved for delta, every swap gives the mean difference over the pairs that it swaps, and the
interval is a range of quantiles of these "typical values" (Hartigan, JASA 64, 1969). Nothing is
assumed of the distribution, and rates need no special case. Without pairs, the test redraws which
values belong to which side (Fisher, 1935).
"""

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from statistics import fmean
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np

from deepmf_sumo.datatypes import Floats

DRAWS: Final = 9_999
_BATCH: Final = 1_111
_EXHAUSTIVE: Final = 13
"""Up to this number of pairs all 8,192 subsets are taken."""
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
    """The difference within pairs; those of one unit depend on each other and swap together."""
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
    """The difference of the means of two sets of values."""
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
    if rare < as_observed:  # even the most extreme arrangement is too frequent
        return Difference(mean, None, None)
    beyond = rare - as_observed
    return Difference(mean, float(order[beyond]), float(order[-1 - beyond]))


_MOST_ALONE: Final = 0.5
"""Share of the smaller side; with more values that the other side lacks, pairs say too little."""

Scene = tuple[str, str]


class Sample(Protocol):
    """What a run measured: the values that it has, by quantity, and what tells it from others."""

    @property
    def run_id(self) -> str: ...

    @property
    def spec(self) -> str: ...

    @property
    def scene(self) -> str: ...

    @property
    def method(self) -> str: ...

    @property
    def planner(self) -> str: ...

    @property
    def values(self) -> Mapping[str, float]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched:
    """What was compared.

    Attributes:
        by: pairs of runs, means of scenes that both sides have, or nothing in common.
        count: pairs, scenes, or runs of both sides.
        units: independent ones among them. fewest: units that an interval needs.
        specs: whether each unit is a separate spec; else units are scenes.
        old, new: means; None, like the difference, where there is nothing to compare.
        each: name of each unit (spec or scene) and its mean difference; empty without pairs.
    """

    by: Literal["pairs", "scenes", "nothing"]
    count: int
    units: int
    fewest: int
    specs: bool = False
    old: float | None = None
    new: float | None = None
    difference: Difference | None = None
    each: tuple[tuple[str, float], ...] = ()


def match(name: str, new: Iterable[Sample], old: Iterable[Sample], confidence: float) -> Matched:
    """New minus old of a quantity, with the two-sided interval of that confidence."""
    ours, theirs = ([sample for sample in side if name in sample.values] for side in (new, old))
    if not (ours and theirs):
        return Matched(by="pairs", count=0, units=0, fewest=fewest(confidence))
    keys: tuple[tuple[Literal["pairs", "scenes"], Callable[[Sample], Hashable]], ...]
    keys = (("pairs", _run), ("scenes", _situation), ("scenes", _scene))
    for by, key in keys:
        found = _paired(_means(name, ours, key), _means(name, theirs, key), confidence, by)
        if found:
            return found
    return _unpaired(_means(name, ours, _scene), _means(name, theirs, _scene), confidence)


Means = dict[Hashable, tuple[Scene, float]]


def _means(name: str, samples: Iterable[Sample], key: Callable[[Sample], Hashable]) -> Means:
    """Scene and mean value of all samples with the same key."""
    values: dict[Hashable, list[float]] = defaultdict(list)
    scenes: dict[Hashable, Scene] = {}
    for sample in samples:
        values[key(sample)].append(sample.values[name])
        scenes[key(sample)] = _scene(sample)
    return {one: (scenes[one], fmean(found)) for one, found in values.items()}


def _paired(
    ours: Means, theirs: Means, confidence: float, by: Literal["pairs", "scenes"]
) -> Matched | None:
    """None where too many values of both sides have no partner."""
    both = [key for key in ours if key in theirs]
    if len(both) < _MOST_ALONE * min(len(ours), len(theirs)):
        return None
    by_scene: dict[Scene, list[float]] = defaultdict(list)
    for key in both:
        scene, value = ours[key]
        by_scene[scene].append(value - theirs[key][1])
    specs = _of_specs(by_scene)
    return Matched(
        by=by,
        count=len(both),
        units=len(by_scene),
        fewest=fewest(confidence),
        specs=specs,
        old=fmean(theirs[key][1] for key in both),
        new=fmean(ours[key][1] for key in both),
        difference=paired(list(by_scene.values()), confidence),
        each=tuple(
            (spec if specs else scene, fmean(values)) for (spec, scene), values in by_scene.items()
        ),
    )


def _unpaired(ours: Means, theirs: Means, confidence: float) -> Matched:
    new, old = ([value for _, value in side.values()] for side in (ours, theirs))
    return Matched(
        by="nothing",
        count=len(new) + len(old),
        units=len(new) + len(old),
        fewest=fewest_unpaired(confidence),
        specs=_of_specs({scene for side in (ours, theirs) for scene, _ in side.values()}),
        old=fmean(old),
        new=fmean(new),
        difference=unpaired(new, old, confidence),
    )


def _of_specs(scenes: Iterable[Scene]) -> bool:
    known = set(scenes)
    return len({spec for spec, _ in known}) == len(known)


def _run(sample: Sample) -> Hashable:
    return sample.run_id


def _situation(sample: Sample) -> Hashable:
    return sample.spec, sample.scene, sample.method, sample.planner


def _scene(sample: Sample) -> Scene:
    return sample.spec, sample.scene


def units_needed(found: Matched, reach: float, distance: float) -> int | None:
    """About how many units would decide, if the mean stays: intervals shrink with their root.

    None where no number would, because the mean lies at the bound.

    Args:
        found: what these units say.
        reach: of the interval, from the mean to the end.
        distance: from the mean to the bound that the end must not cross.
    """
    if distance <= 0 or reach / distance > 100:
        return None
    return max(found.fewest, found.units + 1, math.ceil(found.units * (reach / distance) ** 2))


def two_sided(
    found: Matched, negligible: float
) -> tuple[Literal["more", "less", "within margin", "cannot tell"], int | None]:
    """What a difference of two equal sides says, and how many units would decide.

    ``within margin`` is an interval that lies within ``negligible`` on both sides of zero. Where no
    number of units would show a difference, that which would show it to be so small counts.
    """
    difference = found.difference
    if difference is None or difference.low is None or difference.high is None:
        return "cannot tell", max(found.fewest, found.units + 1)
    mean, low, high = difference.mean, difference.low, difference.high
    if low > 0 or high < 0:
        return ("more" if low > 0 else "less"), None
    if -negligible <= low and high <= negligible:
        return "within margin", None
    reach = mean - low if mean > 0 else high - mean
    needed = units_needed(found, reach, abs(mean))
    if needed is None:
        needed = units_needed(found, (high - low) / 2, negligible - abs(mean))
    return "cannot tell", needed
