"""One quantity of new and old runs -> their difference, by what the runs have in common.

Runs of equal spec, scene, planner and seed are pairs. Where seeds differ, scenes are: their means
are compared, those of a planner if both sides have it. Where scenes differ too, nothing is paired.
Runs of one scene depend on each other, so a scene (of a spec on a network: the spec) counts once,
however many seeds it has.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from statistics import fmean
from typing import Final, Literal

from deepmf_sumo.benchmark.gate import randomisation
from deepmf_sumo.benchmark.gate.randomisation import Difference
from deepmf_sumo.benchmark.gate.rows import Row

_MOST_ALONE: Final = 0.5
"""Share of the smaller side; with more that the other side does not have, pairs are no use."""

Scene = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched:
    """What was compared.

    Attributes:
        by: pairs of runs, means of scenes that both sides have, or nothing in common.
        count: pairs, scenes, or runs of both sides.
        units: of them that are independent. fewest: units without which there is no interval.
        specs: whether each unit is a spec of its own; else units are scenes.
        old, new: means; None, like the difference, where there is nothing to compare.
    """

    by: Literal["pairs", "scenes", "nothing"]
    count: int
    units: int
    fewest: int
    specs: bool = False
    old: float | None = None
    new: float | None = None
    difference: Difference | None = None


def match(name: str, new: Iterable[Row], old: Iterable[Row], confidence: float) -> Matched:
    """New minus old of a quantity, with the two-sided interval of that confidence."""
    ours, theirs = ([row for row in side if name in row.values] for side in (new, old))
    if not (ours and theirs):
        return Matched(by="pairs", count=0, units=0, fewest=randomisation.fewest(confidence))
    keys: tuple[tuple[Literal["pairs", "scenes"], Callable[[Row], Hashable]], ...]
    keys = (("pairs", _run), ("scenes", _situation), ("scenes", _scene))
    for by, key in keys:
        found = _paired(_means(name, ours, key), _means(name, theirs, key), confidence, by)
        if found:
            return found
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
    return Matched(
        by=by,
        count=len(both),
        units=len(by_scene),
        fewest=randomisation.fewest(confidence),
        specs=_of_specs(by_scene),
        old=fmean(theirs[key][1] for key in both),
        new=fmean(ours[key][1] for key in both),
        difference=randomisation.paired(list(by_scene.values()), confidence),
    )


def _unpaired(ours: Means, theirs: Means, confidence: float) -> Matched:
    new, old = ([value for _, value in side.values()] for side in (ours, theirs))
    return Matched(
        by="nothing",
        count=len(new) + len(old),
        units=len(new) + len(old),
        fewest=randomisation.fewest_unpaired(confidence),
        specs=_of_specs({scene for side in (ours, theirs) for scene, _ in side.values()}),
        old=fmean(old),
        new=fmean(new),
        difference=randomisation.unpaired(new, old, confidence),
    )


def _of_specs(scenes: Iterable[Scene]) -> bool:
    known = set(scenes)
    return len({spec for spec, _ in known}) == len(known)


def _run(row: Row) -> Hashable:
    return row.run_id


def _situation(row: Row) -> Hashable:
    return row.spec, row.scene, row.method, row.planner


def _scene(row: Row) -> Scene:
    return row.spec, row.scene
