"""Which runs of two sides are compared, what their difference is, and what it decides.

Runs of equal spec, scene, planner and seed are pairs. Where seeds differ, scenes are: their means
are compared, those of a planner if both sides have it. Where scenes differ too, nothing is paired.
A scene (of a spec on a network: the spec) is one unit of `statistics`, however many seeds it has.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import fmean
from typing import Final, Literal

import pandas as pd

from deepmf_sumo.results import statistics
from deepmf_sumo.results.statistics import Difference, Units

_MOST_ALONE: Final = 0.5
"""Share of the smaller side; with more values that the other side lacks, pairs say too little."""

Scene = tuple[str, str]
Beyond = Callable[[float], bool]
_PAIR: Final = ("run_id",)
_SITUATION: Final = ("spec", "scene", "method", "planner_label")
_SCENE: Final = ("spec", "scene")
"""Columns of a frame of runs that runs have in common."""
KEYS: Final = (*_PAIR, *_SITUATION)
"""All columns that `match` looks at, beside the quantity."""


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
        more, fewer: pairs, or scenes, in which the new side has more than the old one, or less.
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
    more: int = 0
    fewer: int = 0
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
    new: pd.DataFrame,
    old: pd.DataFrame,
    confidence: float,
    largest: float | None = None,
) -> Matched:
    """New minus old of a quantity.

    Args:
        name: of the quantity: a column.
        new: runs of the new side, as `Results.frame` has them.
        old: runs of the old side.
        confidence: of the two-sided interval.
        largest: difference that another unit may have, see `quantities.Quantity.largest`.
    """
    if not (new[name].notna().any() and old[name].notna().any()):
        enough = statistics.fewest(confidence)
        return Matched(by="pairs", count=0, units=0, fewest=enough, confidence=confidence)
    keys: tuple[tuple[Literal["pairs", "scenes"], tuple[str, ...]], ...]
    keys = (("pairs", _PAIR), ("scenes", _SITUATION), ("scenes", _SCENE))
    for by, key in keys:
        sides = _means(name, new, key), _means(name, old, key)
        both = sum(one in sides[1] for one in sides[0])
        if both >= _MOST_ALONE * min(map(len, sides)):  # else too many have no partner
            return _paired(*sides, by, confidence, largest)
    return _unpaired(_means(name, new, _SCENE), _means(name, old, _SCENE), confidence, largest)


def match_pairs(
    name: str,
    new: pd.DataFrame,
    old: pd.DataFrame,
    confidence: float,
    largest: float | None = None,
) -> Matched | None:
    """`match` of the runs alone that have a partner, however few they are; None without any."""
    sides = _means(name, new, _PAIR), _means(name, old, _PAIR)
    if not any(one in sides[1] for one in sides[0]):
        return None
    return _paired(*sides, "pairs", confidence, largest)


Means = dict[Hashable, tuple[Scene, float]]


def _means(name: str, runs: pd.DataFrame, key: Sequence[str]) -> Means:
    """Scene and mean value of all runs with the same key."""
    values: dict[Hashable, list[float]] = defaultdict(list)
    scenes: dict[Hashable, Scene] = {}
    measured = runs[runs[name].notna()]
    keys, of = (zip(*(measured[column] for column in columns), strict=True)
                for columns in (key, _SCENE))  # fmt: skip
    for one, scene, value in zip(keys, of, measured[name], strict=True):
        values[one].append(float(value))
        scenes[one] = scene
    return {one: (scenes[one], fmean(found)) for one, found in values.items()}


def _paired(
    ours: Means,
    theirs: Means,
    by: Literal["pairs", "scenes"],
    confidence: float,
    largest: float | None,
) -> Matched:
    both = [key for key in ours if key in theirs]
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
        more=sum(ours[key][1] > theirs[key][1] for key in both),
        fewer=sum(ours[key][1] < theirs[key][1] for key in both),
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
