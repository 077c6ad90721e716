"""Which runs of two sides are compared, what their difference is, and what it decides.

Runs of equal spec, scene, planner and seed are pairs. Where seeds differ, scenes are: their means
are compared, those of a planner if both sides have it. Where scenes differ too, nothing is paired.
A scene (of a spec on a network: the spec) is one unit of `statistics`, however many seeds it has.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import fmean
from typing import Final, Literal, Protocol

from deepmf_sumo.results import statistics
from deepmf_sumo.results.statistics import Difference, Units

_MOST_ALONE: Final = 0.5
"""Share of the smaller side; with more values that the other side lacks, pairs say too little."""

Scene = tuple[str, str]
Beyond = Callable[[float], bool]


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
        units: independent ones among them. fewest: units that can show a difference.
        confidence: of the interval. largest: see `statistics.paired`.
        specs: whether each unit is a separate spec; else units are scenes.
        old, new: means; None, like the difference, where there is nothing to compare.
        each: name of each unit (spec or scene) and its mean difference; empty without pairs.
        values: the differences of units; without pairs, the values of units, new and old.
    """

    by: Literal["pairs", "scenes", "nothing"]
    count: int
    units: int
    fewest: int
    confidence: float
    largest: float | None = None
    specs: bool = False
    old: float | None = None
    new: float | None = None
    difference: Difference | None = None
    each: tuple[tuple[str, float], ...] = ()
    values: tuple[Units, ...] = ()

    def ends_of(self, units: int) -> tuple[Beyond, Beyond]:
        """If there were another number of units like these: is the interval above, or below it?"""
        found = [one.as_many(units * len(one.values) / self.units) for one in self.values]
        if self.by == "nothing":
            return _ends_of(_difference(found, self.confidence, self.largest))
        given = self.confidence, self.largest
        return (
            lambda bound: statistics.below(found[0].other_way, *given, -bound),
            lambda bound: statistics.below(found[0], *given, bound),
        )


def _difference(values: Sequence[Units], confidence: float, largest: float | None) -> Difference:
    if len(values) == 1:
        return statistics.of_pairs(values[0], confidence, largest)
    return statistics.unpaired(values[0], values[1], confidence, largest)


def match(
    name: str,
    new: Iterable[Sample],
    old: Iterable[Sample],
    confidence: float,
    largest: float | None = None,
) -> Matched:
    """New minus old of a quantity.

    Args:
        name: of the quantity.
        new: runs of the new side.
        old: runs of the old side.
        confidence: of the two-sided interval.
        largest: difference that another unit may have, see `quantities.Quantity.largest`.
    """
    ours, theirs = ([sample for sample in side if name in sample.values] for side in (new, old))
    if not (ours and theirs):
        enough = statistics.fewest(confidence)
        return Matched(by="pairs", count=0, units=0, fewest=enough, confidence=confidence)
    keys: tuple[tuple[Literal["pairs", "scenes"], Callable[[Sample], Hashable]], ...]
    keys = (("pairs", _run), ("scenes", _situation), ("scenes", _scene))
    for by, key in keys:
        sides = _means(name, ours, key), _means(name, theirs, key)
        found = _paired(*sides, by, confidence, largest)
        if found:
            return found
    sides = _means(name, ours, _scene), _means(name, theirs, _scene)
    return _unpaired(*sides, confidence, largest)


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
    ours: Means,
    theirs: Means,
    by: Literal["pairs", "scenes"],
    confidence: float,
    largest: float | None,
) -> Matched | None:
    """None where too many values of both sides have no partner."""
    both = [key for key in ours if key in theirs]
    if len(both) < _MOST_ALONE * min(len(ours), len(theirs)):
        return None
    by_scene: dict[Scene, list[float]] = defaultdict(list)
    for key in both:
        scene, value = ours[key]
        by_scene[scene].append(value - theirs[key][1])
    specs, units = _of_specs(by_scene), statistics.units_of(by_scene.values())
    return Matched(
        by=by,
        count=len(both),
        units=len(by_scene),
        fewest=statistics.fewest(confidence),
        confidence=confidence,
        largest=largest,
        specs=specs,
        old=fmean(theirs[key][1] for key in both),
        new=fmean(ours[key][1] for key in both),
        difference=_difference([units], confidence, largest),
        each=tuple(
            (spec if specs else scene, fmean(values)) for (spec, scene), values in by_scene.items()
        ),
        values=(units,),
    )


def _unpaired(ours: Means, theirs: Means, confidence: float, largest: float | None) -> Matched:
    sides = [statistics.units_of([value] for _, value in side.values()) for side in (ours, theirs)]
    count = len(ours) + len(theirs)
    return Matched(
        by="nothing",
        count=count,
        units=count,
        fewest=statistics.fewest_unpaired(confidence),
        confidence=confidence,
        largest=largest,
        specs=_of_specs({scene for side in (ours, theirs) for scene, _ in side.values()}),
        old=sides[1].mean,
        new=sides[0].mean,
        difference=_difference(sides, confidence, largest),
        values=tuple(sides),
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


Answer = Literal["more", "less", "within margin", "cannot tell"]
_MOST_UNITS: Final = 10_000


def answer(
    found: Matched, tolerance: float, margin: float, *, more_is_worse: bool | None = None
) -> tuple[Answer, int | None]:
    """What a difference says, and about how many units would decide where it says nothing.

    The number is of units like these: the same differences, as often in proportion. None if not
    even `_MOST_UNITS` would decide.

    Args:
        found: the difference.
        tolerance: the whole interval must be beyond it for ``more`` and ``less``.
        margin: the interval must be within it, on both sides of zero, for ``within margin``.
        more_is_worse: on the worse side only; None: on both.
    """
    if found.difference is None:
        return "cannot tell", found.fewest
    said = partial(_state, tolerance=tolerance, margin=margin, more_is_worse=more_is_worse)
    state = said(*_ends_of(found.difference))
    if found.units >= found.fewest and state != "cannot tell":
        return state, None

    def enough(units: int) -> bool:
        return said(*found.ends_of(units)) != "cannot tell"

    return "cannot tell", _least(enough, max(found.units, found.fewest - 1))


def _ends_of(found: Difference) -> tuple[Beyond, Beyond]:
    low, high = found.low, found.high
    return (
        lambda bound: low is not None and low > bound,
        lambda bound: high is not None and high < bound,
    )


def _state(
    above: Beyond, below: Beyond, tolerance: float, margin: float, more_is_worse: bool | None
) -> Answer:
    if above(tolerance) or below(-tolerance):
        return "more" if above(tolerance) else "less"
    not_less = more_is_worse is True or above(-margin)
    not_more = more_is_worse is False or below(margin)
    return "within margin" if not_less and not_more else "cannot tell"


def _least(enough: Callable[[int], bool], too_few: int) -> int | None:
    """The least number of units that is enough, to one in a hundred; None where none is."""
    if not enough(_MOST_UNITS):
        return None
    many = too_few + 1
    while not enough(many):
        too_few, many = many, min(2 * many, _MOST_UNITS)
    while many - too_few > max(1, many // 100):
        middle = (too_few + many) // 2
        too_few, many = (too_few, middle) if enough(middle) else (middle, many)
    return many
