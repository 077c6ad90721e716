"""One quantity of new and old runs -> their difference, by what the runs have in common.

Runs of equal spec, scene, planner and seed are pairs. Where seeds differ, scenes are: their means
are compared. Where scenes differ too, nothing is paired. Runs of one scene depend on each other: of
many scenes, each counts once.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from statistics import fmean
from typing import Final, Literal

from deepmf_sumo.benchmark.gate import randomisation
from deepmf_sumo.benchmark.gate.randomisation import Difference
from deepmf_sumo.benchmark.gate.rows import Row

_ENOUGH_SCENES: Final = 10
_MOST_ALONE: Final = 0.5
"""Share of the smaller side; with more that the other side does not have, pairs are no use."""

Scene = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched:
    """What was compared.

    Attributes:
        by: pairs of runs, means of scenes that both sides have, or nothing in common.
        count: pairs, scenes, or runs of both sides. units: of them that are independent.
        old, new: means; None, like the difference, where there is nothing to compare.
    """

    by: Literal["pairs", "scenes", "nothing"]
    count: int
    units: int
    old: float | None = None
    new: float | None = None
    difference: Difference | None = None


def match(name: str, new: Iterable[Row], old: Iterable[Row], confidence: float) -> Matched:
    """New minus old of a quantity, with the interval of that confidence."""
    ours, theirs = ([row for row in side if name in row.values] for side in (new, old))
    if not (ours and theirs):
        return Matched(by="pairs", count=0, units=0)
    pairs = _paired(_means(name, ours, _run), _means(name, theirs, _run), confidence, "pairs")
    if pairs:
        return pairs
    if min(len({_scene(row) for row in side}) for side in (ours, theirs)) < _ENOUGH_SCENES:
        return _unpaired(_means(name, ours, _run), _means(name, theirs, _run), confidence)
    situations = [_means(name, side, _situation) for side in (ours, theirs)]
    scenes = _paired(situations[0], situations[1], confidence, "scenes")
    if scenes:
        return scenes
    return _unpaired(_means(name, ours, _scene), _means(name, theirs, _scene), confidence)


Means = dict[Hashable, tuple[Scene, float]]


def _means(name: str, rows: Iterable[Row], key: Callable[[Row], Hashable]) -> Means:
    """Scene and mean value of all rows with the same key."""
    values: dict[Hashable, list[float]] = defaultdict(list)
    scenes: dict[Hashable, Scene] = {}
    for row in rows:
        values[key(row)].append(row.values[name])
        scenes[key(row)] = _scene(row)
    return {one: (scenes[one], fmean(found)) for one, found in values.items()}


def _paired(
    ours: Means, theirs: Means, confidence: float, by: Literal["pairs", "scenes"]
) -> Matched | None:
    """None where too many of both sides are alone."""
    both = [key for key in ours if key in theirs]
    if len(both) < _MOST_ALONE * min(len(ours), len(theirs)):
        return None
    by_scene: dict[Scene, list[float]] = defaultdict(list)
    for key in both:
        scene, value = ours[key]
        by_scene[scene].append(value - theirs[key][1])
    units = list(by_scene.values())
    if len(units) < _ENOUGH_SCENES:
        units = [[value] for unit in units for value in unit]
    return Matched(
        by=by,
        count=len(both),
        units=len(units),
        old=fmean(theirs[key][1] for key in both),
        new=fmean(ours[key][1] for key in both),
        difference=randomisation.paired(units, confidence),
    )


def _unpaired(ours: Means, theirs: Means, confidence: float) -> Matched:
    new, old = ([value for _, value in side.values()] for side in (ours, theirs))
    return Matched(
        by="nothing",
        count=len(new) + len(old),
        units=len(new) + len(old),
        old=fmean(old),
        new=fmean(new),
        difference=randomisation.unpaired(new, old, confidence),
    )


def _run(row: Row) -> Hashable:
    return row.run_id


def _situation(row: Row) -> Hashable:
    return row.spec, row.scene, row.method, row.planner


def _scene(row: Row) -> Scene:
    return row.spec, row.scene
