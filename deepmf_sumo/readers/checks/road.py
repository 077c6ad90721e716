"""Checks and repairs of the recorded road. Every repair leaves a sentence."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Lane, Neighbour, Polygon, Polyline, RoadMap, StopSign
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers.checks.motion import FARTHEST_M

MOST_FEATURES: Final = 50_000
MOST_POINTS: Final = 2_000_000
"""The largest maps of scenes have 2 000 features with 100 000 points in all."""


def refuse(road: RoadMap) -> None:
    """Raises ReaderError where there is no lane, or a lane is not made of finite numbers.

    Also where the map is larger than any recording's.
    """
    if not road.lanes:
        raise ReaderError("the record has no lanes")
    features: tuple[Polyline | Polygon, ...] = (*road.lines, *road.edges, *road.polygons)
    if len(road.lanes) + len(features) + len(road.stop_signs) > MOST_FEATURES:
        raise ReaderError(f"the map has more than {MOST_FEATURES} features")
    points = sum(len(lane.centre_m) for lane in road.lanes.values())
    if points + sum(len(feature.points_m) for feature in features) > MOST_POINTS:
        raise ReaderError(f"the map has more than {MOST_POINTS} points")
    for lane in road.lanes.values():
        if not is_placed(lane):
            # Other lanes point into this one by index: no point of it can be left out.
            raise ReaderError(
                f"lane {lane.id} has points that are not finite numbers, or too far away"
            )


def refuse_links(road: RoadMap) -> None:
    """Raises ReaderError for what `mended` would leave out: for maps that were mended before."""
    repairs: list[str] = []
    mended(road, repairs)
    if repairs:
        raise ReaderError(f"the road was changed: {repairs[0].rstrip('.')}")


def is_placed(lane: Lane) -> bool:
    """Whether all points are finite numbers, not farther away than any recording."""
    points = np.column_stack([lane.centre_m, lane.z_m])
    return bool((np.abs(points) < FARTHEST_M).all())  # false for NaN, too


def mended(road: RoadMap, repairs: list[str]) -> RoadMap:
    """The road without features that have no usable points, and without links to nowhere."""
    refuse(road)
    empty = [lane.id for lane in road.lanes.values() if not len(lane.centre_m)]
    if empty:
        repairs.append(f"Lanes without points were left out: {', '.join(empty)}.")
    lanes = {name: lane for name, lane in road.lanes.items() if len(lane.centre_m)}
    if not lanes:
        raise ReaderError("no lane of the record has points")
    lost: list[str] = []
    linked = {name: _linked(lane, lanes, lost) for name, lane in lanes.items()}
    signs = [_sign_of(sign, lanes, lost) for sign in road.stop_signs]
    if lost:
        repairs.append(
            f"{len(lost)} links to lanes, or to points of lanes, that are not in the record were "
            f"left out, e.g. {lost[0]}."
        )
    return RoadMap(
        lanes=linked,
        lines=_usable(road.lines, "lines", repairs),
        edges=_usable(road.edges, "edges", repairs),
        polygons=_usable_polygons(road.polygons, repairs),
        stop_signs=_usable_signs(signs, repairs),
    )


def _linked(lane: Lane, lanes: dict[str, Lane], lost: list[str]) -> Lane:
    beside = (*lane.left, *lane.right)
    missing = [other for other in (*lane.next, *lane.previous) if other not in lanes]
    missing += [other.lane_id for other in beside if not _lies_beside(other, lane, lanes)]
    if not missing:
        return lane
    lost.extend(f"lane {lane.id} to {other}" for other in missing)
    return replace(
        lane,
        next=tuple(other for other in lane.next if other in lanes),
        previous=tuple(other for other in lane.previous if other in lanes),
        left=tuple(other for other in lane.left if _lies_beside(other, lane, lanes)),
        right=tuple(other for other in lane.right if _lies_beside(other, lane, lanes)),
    )


def _lies_beside(neighbour: Neighbour, lane: Lane, lanes: dict[str, Lane]) -> bool:
    """Whether the neighbour is there; ends may be one past the last point, as in WOMD."""
    if neighbour.lane_id not in lanes:
        return False
    own, other = len(lane.centre_m), len(lanes[neighbour.lane_id].centre_m)
    return (
        0 <= neighbour.self_start < own
        and neighbour.self_start <= neighbour.self_end <= own
        and 0 <= neighbour.other_start < other
        and neighbour.other_start <= neighbour.other_end <= other
    )


def _sign_of(sign: StopSign, lanes: dict[str, Lane], lost: list[str]) -> StopSign:
    lost.extend(f"stop sign {sign.id} to {other}" for other in sign.lane_ids if other not in lanes)
    return replace(sign, lane_ids=tuple(other for other in sign.lane_ids if other in lanes))


def _is_usable(feature: Polyline | Polygon) -> bool:
    points = np.column_stack([feature.points_m, feature.z_m])
    return len(points) > 0 and bool((np.abs(points) < FARTHEST_M).all())


def _usable(features: tuple[Polyline, ...], what: str, repairs: list[str]) -> tuple[Polyline, ...]:
    _report((one.id for one in features if not _is_usable(one)), what, repairs)
    return tuple(feature for feature in features if _is_usable(feature))


def _usable_polygons(features: tuple[Polygon, ...], repairs: list[str]) -> tuple[Polygon, ...]:
    _report((one.id for one in features if not _is_usable(one)), "polygons", repairs)
    return tuple(feature for feature in features if _is_usable(feature))


def _usable_signs(signs: list[StopSign], repairs: list[str]) -> tuple[StopSign, ...]:
    _report((s.id for s in signs if not _is_placed_sign(s)), "stop signs", repairs)
    return tuple(sign for sign in signs if _is_placed_sign(sign))


def _is_placed_sign(sign: StopSign) -> bool:
    return bool((np.abs([*sign.position_m, sign.z_m]) < FARTHEST_M).all())


def _report(lost: Iterable[str], what: str, repairs: list[str]) -> None:
    names = list(lost)
    if names:
        repairs.append(
            f"{len(names)} {what} without points, or with points that are no places, "
            f"were left out: {', '.join(names[:5])}{', ...' if len(names) > 5 else ''}."
        )
