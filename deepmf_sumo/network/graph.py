"""The scene's lanes as a graph: simplified centre lines, and the joins that really touch."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from deepmf_sumo.datatypes import Floats, Lane, RoadMap
from deepmf_sumo.geometry import angles, polylines
from deepmf_sumo.network import cutting

TOLERANCE_M: Final = 0.02
"""Douglas-Peucker tolerance. Recorded points lie 0.5 m apart; SUMO's map matching takes time in
proportion to the points, and 0.02 m leaves a tenth of them."""
TOUCH_M: Final = 1.0
"""Lanes that join have ends nearer than this; where they have not, a lane between them is missing
in the recording, and the join needs a way of its own."""
WIDEST_GAP_M: Final = 100.0
SHARPEST_TURN_RAD: Final = 2.9
"""A way across a gap that turns more than this is none that a vehicle could drive."""
SAME_POINT_M: Final = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneGraph:
    """Lanes that can be driven, and how they join.

    Attributes:
        lanes: the scene's own, those that have a place in the graph.
        shapes: (P, 3) simplified centre line; P = 1 for lanes of one point.
        lengths_m: arc length of the shapes.
        following, preceding: lane ids by lane id.
        gaps: joins of lanes that do not touch, with the distance.
        loose: lanes of one point that join nothing on one side -> the lane that they touch, and
            whether at its end.
        connections: number of joins that the scene names.
        lost_lanes: id, reason. lost_connections: from, to, reason.
    """

    lanes: dict[str, Lane]
    shapes: dict[str, Floats]
    lengths_m: dict[str, float]
    following: dict[str, tuple[str, ...]]
    preceding: dict[str, tuple[str, ...]]
    gaps: dict[tuple[str, str], float]
    loose: dict[str, tuple[str, bool]]
    connections: int
    lost_lanes: tuple[tuple[str, str], ...]
    lost_connections: tuple[tuple[str, str, str], ...]

    def is_point(self, lane_id: str) -> bool:
        """Whether the lane is a single point, which joins others but has no length."""
        return len(self.shapes[lane_id]) == 1


def lane_graph(road: RoadMap) -> LaneGraph:
    """The graph of a scene's lanes."""
    shapes = simplified(road)
    lost = [(lane_id, "it has no points") for lane_id in road.lanes if lane_id not in shapes]
    named = _named_pairs(road)
    pairs, lost_pairs, gaps = [], [], {}
    for pair in named:
        if reason := _no_join(shapes, *pair):
            lost_pairs.append((*pair, reason))
            continue
        pairs.append(pair)
        gap = float(np.hypot(*_gap(shapes, *pair)))
        if gap > TOUCH_M:
            gaps[pair] = gap
    loose, alone, pairs = _without_loose_points(shapes, pairs)
    lost += [(lane_id, "it is a single point that joins nothing") for lane_id in alone]
    drivable = {key: xyz for key, xyz in shapes.items() if key not in loose and key not in alone}
    following: dict[str, list[str]] = {lane_id: [] for lane_id in drivable}
    preceding: dict[str, list[str]] = {lane_id: [] for lane_id in drivable}
    for first, second in pairs:
        following[first].append(second)
        preceding[second].append(first)
    return LaneGraph(
        lanes={lane_id: road.lanes[lane_id] for lane_id in drivable},
        shapes=drivable,
        lengths_m={
            key: float(polylines.arc_lengths(xyz[:, :2])[-1]) for key, xyz in drivable.items()
        },
        following={key: tuple(ids) for key, ids in following.items()},
        preceding={key: tuple(ids) for key, ids in preceding.items()},
        gaps=gaps,
        loose=loose,
        connections=len(named),
        lost_lanes=tuple(lost),
        lost_connections=tuple(lost_pairs),
    )


def simplified(road: RoadMap) -> dict[str, Floats]:
    """(P, 3) simplified centre line of each lane that has a point."""
    shapes: dict[str, Floats] = {}
    for lane_id, lane in road.lanes.items():
        xyz = np.column_stack([lane.centre_m, lane.z_m])
        if len(xyz) > 1:
            apart = np.hypot(*np.diff(xyz[:, :2], axis=0).T) > SAME_POINT_M
            xyz = xyz[np.concatenate([[True], apart])]
        if len(xyz):
            shapes[lane_id] = xyz
    long = [lane_id for lane_id, xyz in shapes.items() if len(xyz) > 2]
    if long:
        counts = [len(shapes[lane_id]) for lane_id in long]
        lines = shapely.linestrings(
            np.concatenate([shapes[lane_id] for lane_id in long]),
            indices=np.repeat(np.arange(len(long)), counts),
        )
        thin = shapely.simplify(lines, TOLERANCE_M, preserve_topology=False)
        points, owner = shapely.get_coordinates(thin, include_z=True, return_index=True)
        breaks = np.searchsorted(owner, np.arange(1, len(long)))
        shapes.update(zip(long, np.split(points, breaks), strict=True))
    return shapes


def _named_pairs(road: RoadMap) -> list[tuple[str, str]]:
    """Joins that either of the two lanes names, each once, in the scene's order."""
    pairs: dict[tuple[str, str], None] = {}
    for lane_id, lane in road.lanes.items():
        for other in lane.previous:
            pairs[other, lane_id] = None
        for other in lane.next:
            pairs[lane_id, other] = None
    return list(pairs)


def _no_join(shapes: dict[str, Floats], first: str, second: str) -> str:
    """Why two lanes do not join; empty where they do."""
    for lane_id in (first, second):
        if lane_id not in shapes:
            return f"lane {lane_id} is not in the map"
    gap = _gap(shapes, first, second)
    width = float(np.hypot(*gap))
    if width <= TOUCH_M:
        return ""
    if min(len(shapes[first]), len(shapes[second])) == 1 or width > WIDEST_GAP_M:
        return f"their ends are {width:.1f} m apart"
    leaving = cutting.end_direction(shapes[first][:, :2])
    entering = -cutting.end_direction(shapes[second][::-1, :2])
    courses = np.array([leaving, gap, entering])
    turns = angles.wrap(np.diff(np.arctan2(courses[:, 1], courses[:, 0])))
    if np.abs(turns).sum() > SHARPEST_TURN_RAD:
        return f"their ends are {width:.1f} m apart and face away from each other"
    return ""


def _gap(shapes: dict[str, Floats], first: str, second: str) -> Floats:
    """(2) from the end of a lane to the start of another."""
    gap: Floats = shapes[second][0, :2] - shapes[first][-1, :2]
    return gap


def _without_loose_points(
    shapes: dict[str, Floats], pairs: list[tuple[str, str]]
) -> tuple[dict[str, tuple[str, bool]], list[str], list[tuple[str, str]]]:
    """Take out the one-point lanes that join nothing on one side: they are ends, not ways.

    Returns those that touch a lane, with it and whether at its end; those that touch none; and the
    joins of all others.
    """
    loose: dict[str, tuple[str, bool]] = {}
    alone: list[str] = []
    points = [key for key, xyz in shapes.items() if len(xyz) == 1]
    while True:
        entered, left = {second for _, second in pairs}, {first for first, _ in pairs}
        ends = [key for key in points if key not in entered or key not in left]
        if not ends:
            break
        points = [key for key in points if key not in ends]
        for key in ends:
            touched = [(first, True) for first, second in pairs if second == key]
            touched += [(second, False) for first, second in pairs if first == key]
            touched = [other for other in touched if other[0] not in ends]
            if touched:
                loose[key] = touched[0]
            else:
                alone.append(key)
        pairs = [pair for pair in pairs if pair[0] not in ends and pair[1] not in ends]
    for key in loose:
        while loose[key][0] in loose:
            loose[key] = loose[loose[key][0]]
    alone += [key for key, (lane_id, _) in loose.items() if lane_id in alone]
    return {key: to for key, to in loose.items() if key not in alone}, alone, pairs
