"""The lanes of a recorded road map as a graph, with the places where they cross and join."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from deepmf_sumo.scene import Floats, Lane, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines

OVERPASS_M: Final = 2.5
"""Lanes with a larger difference of height are a road and its overpass."""
END_M: Final = 0.5
"""Lanes that meet closer to an end join there; they do not cross."""
PARALLEL_SINE: Final = 0.09
"""Centre lines that meet at less than 5 degrees diverge or merge; they do not cross."""


def crossings(shapes: dict[str, Floats]) -> list[tuple[str, str]]:
    """Pairs of lanes (P, 3) whose centre lines cross away from their ends, each once, in order."""
    names = [lane_id for lane_id, xyz in shapes.items() if len(xyz) > 1]
    if len(names) < 2:
        return []
    start = np.concatenate([shapes[name][:-1] for name in names])
    delta = np.concatenate([np.diff(shapes[name], axis=0) for name in names])
    owner = np.repeat(np.arange(len(names)), [len(shapes[name]) - 1 for name in names])
    before, after = _distances_to_ends(delta, owner)
    ends = np.stack([start[:, :2], start[:, :2] + delta[:, :2]], axis=1)
    lines = np.asarray(shapely.linestrings(ends))
    one, two = shapely.STRtree(lines).query(lines)
    later = owner[one] < owner[two]
    one, two = one[later], two[later]
    share_one, share_two, sine = _intersections(start, delta, one, two)
    hit = (sine > PARALLEL_SINE) & _inside(share_one) & _inside(share_two)
    for segment, share in ((one, share_one), (two, share_two)):
        length = np.hypot(delta[segment, 0], delta[segment, 1])
        hit &= before[segment] + share * length > END_M
        hit &= after[segment] + (1 - share) * length > END_M
    height_one = start[one, 2] + share_one * delta[one, 2]
    height_two = start[two, 2] + share_two * delta[two, 2]
    hit &= np.abs(height_one - height_two) <= OVERPASS_M
    pairs = np.unique(np.stack([owner[one[hit]], owner[two[hit]]], axis=1), axis=0)
    return [(names[first], names[second]) for first, second in pairs]


def _distances_to_ends(delta: Floats, owner: np.ndarray) -> tuple[Floats, Floats]:
    """(S) lane length before the segment's start, and after its end."""
    length = np.hypot(delta[:, 0], delta[:, 1])
    total = np.bincount(owner, length)
    offset = np.concatenate([[0.0], np.cumsum(total)])[owner]
    before = np.cumsum(length) - length - offset
    return before, total[owner] - before - length


def _intersections(
    start: Floats, delta: Floats, one: np.ndarray, two: np.ndarray
) -> tuple[Floats, Floats, Floats]:
    """Shares along two segments at which their lines meet, and the sine of their angle."""
    a, b = delta[one, :2], delta[two, :2]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    sine = np.abs(cross) / np.maximum(np.hypot(*a.T) * np.hypot(*b.T), 1e-12)
    safe = np.where(np.abs(cross) < 1e-12, 1.0, cross)
    gap = start[two, :2] - start[one, :2]
    share_one = (gap[:, 0] * b[:, 1] - gap[:, 1] * b[:, 0]) / safe
    share_two = (gap[:, 0] * a[:, 1] - gap[:, 1] * a[:, 0]) / safe
    return share_one, share_two, sine


def _inside(share: Floats) -> np.ndarray:
    return (share >= 0.0) & (share <= 1.0)


LATERAL_MPS2: Final = 5.5
"""Sideways acceleration in turns, netconvert's default."""
BEND_M: Final = 5
"""Distance over which a turn is measured; single corners of a simplified line are not bends."""


def part(points_m: Floats, start_m: float, end_m: float) -> Floats:
    """The polyline (P, 2) between two arc lengths, with all vertices between them."""
    along = polylines.arc_lengths(points_m)
    between = (along > start_m + 1e-6) & (along < end_m - 1e-6)
    first, last = polylines.points_at(points_m, np.array([start_m, end_m]))[0]
    return np.vstack([first, points_m[between], last])


def tail(points_m: Floats, length_m: float) -> Floats:
    """The last part of a polyline (P, 2), or all of a shorter one."""
    length = float(polylines.arc_lengths(points_m)[-1])
    return part(points_m, max(0.0, length - length_m), length)


def end_direction(points_m: Floats, over_m: float = 3.0) -> Floats:
    """(2) unit vector in which a polyline ends, taken over its last metres."""
    last = tail(points_m, over_m)
    direction = last[-1] - last[0]
    unit: Floats = direction / max(float(np.hypot(*direction)), 1e-9)
    return unit


def joined(parts: list[Floats]) -> Floats:
    """Polylines (P, 2) in a row, without repeated points."""
    points = np.vstack(parts)
    apart = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    chain: Floats = points[apart]
    return chain


def bridge(before_m: Floats, after_m: Floats) -> Floats:
    """A smooth line (P, 2) from the end of a polyline to the start of another (a cubic Bezier)."""
    start, end = before_m[-1], after_m[0]
    reach = 0.4 * float(np.hypot(*(end - start)))
    first = start + reach * end_direction(before_m)
    second = end + reach * end_direction(after_m[::-1])
    share = np.linspace(0.0, 1.0, 25)[:, None]
    rest = 1.0 - share
    curve: Floats = (
        rest**3 * start
        + 3 * rest**2 * share * first
        + 3 * rest * share**2 * second
        + share**3 * end
    )
    return curve


def bend_speed_mps(points_m: Floats) -> float:
    """Speed at which the sharpest bend of a polyline (P, 2) can be driven."""
    steps = np.diff(polylines.resample(points_m, 1.0), axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    over = min(BEND_M, len(heading) - 1)
    if over < 1:
        return float("inf")
    turn = float(np.abs(heading[over:] - heading[:-over]).max()) / over
    return float(np.sqrt(LATERAL_MPS2 / max(turn, 1e-6)))


TOLERANCE_M: Final = 0.02
"""Douglas-Peucker tolerance. Recorded points lie 0.5 m apart; SUMO's map matching takes time in
proportion to the points, and 0.02 m leaves a tenth of them."""
TOUCH_M: Final = 1.0
"""Lanes that join have ends closer than this; otherwise a lane between them is missing in the
recording, and the join needs a bridge."""
WIDEST_GAP_M: Final = 100.0
SHARPEST_TURN_RAD: Final = 2.9
"""No vehicle can drive a bridge across a gap that turns more than this."""
SAME_POINT_M: Final = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneGraph:
    """Lanes that can be driven, and how they join.

    Attributes:
        lanes: the scene's lanes that are in the graph.
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
    leaving = end_direction(shapes[first][:, :2])
    entering = -end_direction(shapes[second][::-1, :2])
    courses = np.array([leaving, gap, entering])
    turns = frames.wrap(np.diff(np.arctan2(courses[:, 1], courses[:, 0])))
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
    """Remove one-point lanes with no predecessor or no successor: they are dead ends.

    Returns those that touch a lane, with that lane and whether at its end; those that touch none;
    and the joins of all others.
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
