"""Line of sight: which road users the AV can see past the boxes of vehicles and past buildings.

The eye is behind the middle of the windscreen, where a driver sits and where cameras of automated
vehicles are: two fifths of the AV's length behind its front, at most 2 m, at four fifths of its
height, at most 2.33 m (the eye of a truck driver in AASHTO's Green Book; a car of 1.5 m gives
1.2 m, between its 1.08 m for cars and the upper edge of a windscreen).

A road user is looked at in columns, upright strips of equal width between the two outermost
corners that its box shows to the eye. A column is in sight if the straight line to 0.12 m below its
top (the middle of a head) meets nothing. Vehicles are opaque boxes from the ground to their height:
a car of 1.5 m hides a child behind it, and the legs of an adult, but not his head where the car
stands in the last third of the way to him; a truck hides both. Walls of buildings are infinitely
high. A road user is visible if half of its columns are in sight.

Simplifications: people hide nobody; windows of vehicles are no windows; there is no weather, night,
field of view or range of sensors; bridges and ground hide nothing.
"""

from typing import Final, Literal, NamedTuple

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, Tracks, agent_ids
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.lane_map import per_road
from deepmf_sumo.scene.road_users import PEOPLE, road_user

COLUMNS: Final = 9
VISIBLE: Final = 0.5
"""Least share of the columns of a visible road user."""
HEAD_M: Final = 0.12
_EYE_BACK, _EYE_BACK_M = 0.4, 2.0
_EYE_HEIGHT, _EYE_HEIGHT_M = 0.8, 2.33
_WALLS_M: Final = 200.0
"""Buildings farther away are not looked at."""


class Eye(NamedTuple):
    """Where the AV sees from: (2) position, and height in the scene."""

    position_m: Floats
    z_m: float

    @classmethod
    def of(cls, position_m: Floats, heading_rad: float, size_m: Floats, z_m: float) -> "Eye":
        """Of an AV at a pose, of size (3), on ground at a height."""
        length, _, height = (float(one) for one in size_m)
        ahead = length / 2 - min(_EYE_BACK * length, _EYE_BACK_M)
        up = min(_EYE_HEIGHT * height, _EYE_HEIGHT_M)
        return cls(position_m + ahead * frames.unit(heading_rad), z_m + up)


class Upright(NamedTuple):
    """N boxes that stand on the ground: (N, 2) centre, (N) heading, (N, 3) size, (N) ground."""

    centre_m: Floats
    heading_rad: Floats
    size_m: Floats
    z_m: Floats

    def among(self, rows: Ints) -> "Upright":
        """These boxes, in this order."""
        return Upright(*(one[rows] for one in self))


def visible(tracks: Tracks, step: int, av_row: int, road: RoadMap) -> Bools:
    """(A) whether the AV can see each agent at a step; True for itself, False for who is absent."""
    share = shares(tracks, step, av_row, road)
    return (share >= VISIBLE) & tracks.valid[:, step]


def shares(
    tracks: Tracks, step: int, av_row: int, road: RoadMap, only: int | None = None
) -> Floats:
    """(A) share of the columns of each agent that the AV has in sight at a step; 1 of the AV's own.

    Of agents that are absent it is 0. The AV and its parts hide nobody. ``only``: a row that is
    looked at; 0 of the others.
    """
    found, there = np.zeros(tracks.agents), tracks.valid[:, step]
    if not there[av_row]:
        return found
    size_m = _with_heights(tracks)
    everyone = Upright(
        tracks.position_m[:, step], tracks.heading_rad[:, step], size_m, tracks.z_m[:, step]
    )
    pose = everyone.centre_m[av_row], float(everyone.heading_rad[av_row])
    eye = Eye.of(*pose, size_m[av_row], float(everyone.z_m[av_row]))
    av = agent_ids.whole_of(tracks.ids[av_row])
    wholes = [agent_ids.whole_of(one) for one in tracks.ids]
    own = np.array([one == av for one in wholes])
    opaque = np.array([kind not in PEOPLE for kind in tracks.kinds])
    wanted = np.ones(tracks.agents, bool) if only is None else np.arange(tracks.agents) == only
    seen, hides = np.flatnonzero(there & ~own & wanted), np.flatnonzero(there & opaque & ~own)
    names = {name: number for number, name in enumerate(dict.fromkeys(wholes))}
    whole = np.array([names[one] for one in wholes])
    found[seen] = column_shares(
        eye,
        everyone.among(seen),
        everyone.among(hides),
        whole[seen][:, None] == whole[hides],
        walls_near(road, eye.position_m),
    )
    found[own & there] = 1.0
    return found


def hidden_by(
    tracks: Tracks, step: int, av_row: int, row: int, road: RoadMap
) -> int | Literal["building"] | None:
    """What hides most of an agent from the AV at a step: the row of a vehicle, or a building.

    None where the agent is visible, or is hidden by several of which none hides half of it.
    """
    if shares(tracks, step, av_row, road, only=row)[row] >= VISIBLE:
        return None
    clear = RoadMap(lanes={})
    alone = {
        other: float(shares(tracks.select([av_row, row, other]), step, 0, clear, only=1)[1])
        for other in np.flatnonzero(tracks.valid[:, step]).tolist()
        if other not in {av_row, row}
    }
    most = min(alone, key=alone.__getitem__, default=None)
    if most is not None and alone[most] < VISIBLE:
        return most
    rest = shares(tracks.select([av_row, row]), step, 0, road, only=1)[1]
    return "building" if rest < VISIBLE else None


def _with_heights(tracks: Tracks) -> Floats:
    """(A, 3) sizes, with the usual height of its class where none is known."""
    size_m = tracks.size_m
    unknown = np.flatnonzero(size_m[:, 2] <= 0)
    if len(unknown):
        size_m = size_m.copy()
        usual = [road_user(tracks.kinds[row], size_m[row]).size_m[2] for row in unknown.tolist()]
        size_m[unknown, 2] = usual
    return size_m


def column_shares(eye: Eye, seen: Upright, hides: Upright, same: Bools, walls_m: Floats) -> Floats:
    """(N) share of the columns of N boxes that an eye has in sight past M boxes and W walls.

    Args:
        eye: where it is looked from.
        seen: the N boxes.
        hides: the M boxes; one that the eye is in hides nothing.
        same: (N, M) pairs in which the second does not hide the first, e.g. itself.
        walls_m: (W, 2, 2) ends.
    """
    if not len(seen.z_m):
        return np.zeros(0)
    outside = np.flatnonzero(~_contain(hides, eye.position_m))
    hides, same = hides.among(outside), same[:, outside]
    columns = _Strips.of(eye, seen)
    hidden = np.zeros(columns.angle_rad.shape, bool)
    if len(hides.z_m):
        corners = boxes.corners(hides.centre_m, hides.heading_rad, hides.size_m[:, :2])
        theirs = _Sector.of(eye, corners)
        target, other = np.nonzero(_may_hide(columns.sector, theirs) & ~same)
        low, high = hides.z_m[other], (hides.z_m + hides.size_m[:, 2])[other]
        highest = np.maximum(columns.top_m[target], eye.z_m)
        lowest = np.minimum(columns.top_m[target], eye.z_m)
        sure = theirs.before(columns.sector, target, other) & (highest < high) & (lowest > low)
        _mark(hidden, target[sure], theirs.covers(columns, target[sure], other[sure]))
        target, other = target[~sure], other[~sure]
        way = columns.points_m[target], columns.top_m[target]
        _mark(hidden, target, _past_boxes(eye, *way, hides.among(other)))
    if len(walls_m):
        theirs = _Sector.of(eye, walls_m)
        target, wall = np.nonzero(_may_hide(columns.sector, theirs))
        sure = theirs.before(columns.sector, target, wall)
        _mark(hidden, target[sure], theirs.covers(columns, target[sure], wall[sure]))
        target, wall = target[~sure], wall[~sure]
        _mark(hidden, target, _past_walls(eye, columns.points_m[target], walls_m[wall]))
    return 1.0 - hidden.mean(axis=1)


class _Sector(NamedTuple):
    """(N) directions that shapes cover, seen from an eye: middle, half of it; and distances.

    ``far_m``: of the farthest corner. ``near_m``: at most that of the nearest point.
    """

    middle_rad: Floats
    half_rad: Floats
    near_m: Floats
    far_m: Floats

    @classmethod
    def of(cls, eye: Eye, corners_m: Floats) -> "_Sector":
        """Of the corners (N, P, 2) of convex shapes, P > 1. The eye is in none of them."""
        offset = corners_m - eye.position_m
        centre = offset.mean(axis=1)
        middle = np.arctan2(centre[:, 1], centre[:, 0])
        angle = _angles(offset, middle)
        low, high = angle.min(axis=1), angle.max(axis=1)
        far = np.hypot(offset[..., 0], offset[..., 1]).max(axis=1)
        around = offset - centre[:, None]
        near = np.hypot(centre[:, 0], centre[:, 1])
        near = near - np.hypot(around[..., 0], around[..., 1]).max(axis=1)
        return cls(middle + (low + high) / 2, (high - low) / 2, near, far)

    def before(self, seen: "_Sector", target: Ints, own: Ints) -> Bools:
        """(K) pairs in which all of a shape is nearer than all of another."""
        return self.far_m[own] < seen.near_m[target]

    def covers(self, columns: "_Strips", target: Ints, own: Ints) -> Bools:
        """(K, C) whether columns lie in the directions of a shape, in pairs."""
        apart = np.abs(columns.angle_rad[target] - self.middle_rad[own, None])
        apart = np.minimum(apart, np.abs(2 * np.pi - apart))
        return np.asarray(apart < self.half_rad[own, None])


class _Strips(NamedTuple):
    """Of N boxes: sectors; (N, C, 2) middles of columns and (N, C) directions; (N) seen heights."""

    sector: _Sector
    points_m: Floats
    angle_rad: Floats
    top_m: Floats

    @classmethod
    def of(cls, eye: Eye, seen: Upright) -> "_Strips":
        """Between the outermost corners that the boxes show to an eye."""
        corners = boxes.corners(seen.centre_m, seen.heading_rad, seen.size_m[:, :2])
        sector = _Sector.of(eye, corners)
        angle = _angles(corners - eye.position_m, sector.middle_rad)
        rows = np.arange(len(corners))
        right, left = corners[rows, angle.argmin(axis=1)], corners[rows, angle.argmax(axis=1)]
        share = ((np.arange(COLUMNS) + 0.5) / COLUMNS)[:, None]
        points = right[:, None] + share * (left - right)[:, None]
        x, y = np.moveaxis(points - eye.position_m, -1, 0)
        height = seen.size_m[:, 2]
        top = seen.z_m + np.maximum(height - HEAD_M, height / 2)
        return cls(sector, points, np.arctan2(y, x), top)


def _contain(one: Upright, point_m: Floats) -> Bools:
    """(N) whether boxes, seen from above, contain a point."""
    x, y = (point_m - one.centre_m).T
    cos, sin = np.cos(one.heading_rad), np.sin(one.heading_rad)
    along, left = np.abs(x * cos + y * sin), np.abs(y * cos - x * sin)
    return np.asarray((along < one.size_m[:, 0] / 2) & (left < one.size_m[:, 1] / 2))


def _angles(offset_m: Floats, middle_rad: Floats) -> Floats:
    """(N, P) of points (N, P, 2) around directions (N), in (-pi, pi]."""
    return frames.wrap(np.arctan2(offset_m[..., 1], offset_m[..., 0]) - middle_rad[:, None])


def _may_hide(seen: _Sector, hides: _Sector) -> Bools:
    """(N, M) whether a shape may hide another: their directions overlap, and it is not behind."""
    apart = np.abs(seen.middle_rad[:, None] - hides.middle_rad)
    apart = np.minimum(apart, np.abs(2 * np.pi - apart))
    overlap = apart < seen.half_rad[:, None] + hides.half_rad
    return overlap & (hides.near_m < seen.far_m[:, None])


def _mark(hidden: Bools, target: Ints, columns: Bools) -> None:
    """Add to (N, C) what of the pairs' columns (K, C) is hidden, of targets (K), in order."""
    rows, first = np.unique(target, return_index=True)
    if len(rows):
        hidden[rows] |= np.logical_or.reduceat(columns, first, axis=0)


def _past_boxes(eye: Eye, points_m: Floats, top_m: Floats, hides: Upright) -> Bools:
    """(K, C) whether a box (K) is in the way to points (K, C, 2) at heights (K)."""
    cos, sin = np.cos(hides.heading_rad), np.sin(hides.heading_rad)
    start = eye.position_m - hides.centre_m
    way = points_m - eye.position_m
    half = hides.size_m[:, :2] / 2
    origin = np.stack([start[:, 0] * cos + start[:, 1] * sin,
                       start[:, 1] * cos - start[:, 0] * sin], axis=-1)  # fmt: skip
    cos, sin = cos[:, None], sin[:, None]
    along = np.stack([way[..., 0] * cos + way[..., 1] * sin,
                      way[..., 1] * cos - way[..., 0] * sin], axis=-1)  # fmt: skip
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    one = (-half - origin)[:, None] / along
    other = (half - origin)[:, None] / along
    enters = np.maximum(np.minimum(one, other).max(axis=-1), 0.0)
    leaves = np.minimum(np.maximum(one, other).min(axis=-1), 1.0)
    rise = (top_m - eye.z_m)[:, None]
    first, last = eye.z_m + rise * enters, eye.z_m + rise * leaves
    ground, height = hides.z_m[:, None], (hides.z_m + hides.size_m[:, 2])[:, None]
    below = np.maximum(first, last) < ground  # it is on a road above
    over = np.minimum(first, last) >= height
    return np.asarray((enters < leaves) & ~below & ~over)


def _past_walls(eye: Eye, points_m: Floats, walls_m: Floats) -> Bools:
    """(K, C) whether a wall (K, 2, 2) is crossed on the way to points (K, C, 2)."""
    way = points_m - eye.position_m
    begin = (walls_m[:, 0] - eye.position_m)[:, None]
    wall = (walls_m[:, 1] - walls_m[:, 0])[:, None]
    area = way[..., 0] * wall[..., 1] - way[..., 1] * wall[..., 0]
    parallel = np.abs(area) < 1e-12
    area = np.where(parallel, 1.0, area)
    on_way = (begin[..., 0] * wall[..., 1] - begin[..., 1] * wall[..., 0]) / area
    on_wall = (begin[..., 0] * way[..., 1] - begin[..., 1] * way[..., 0]) / area
    crossed = (on_way > 0) & (on_way < 1) & (on_wall >= 0) & (on_wall <= 1)
    return np.asarray(crossed & ~parallel)


class _Walls(NamedTuple):
    """(W, 2, 2) ends of all walls, (W) row of the building of each."""

    ends_m: Floats
    building: Ints


@per_road
def _walls(road: RoadMap) -> _Walls:
    ends = [
        np.stack([one.points_m, np.roll(one.points_m, -1, axis=0)], 1) for one in road.buildings
    ]
    if not ends:
        return _Walls(np.empty((0, 2, 2)), np.empty(0, np.int64))
    number = np.repeat(np.arange(len(ends)), [len(one) for one in ends])
    return _Walls(np.concatenate(ends), number)


def walls_near(road: RoadMap, point_m: Floats) -> Floats:
    """(W, 2, 2) walls within 200 m of a point, without those of a building that the point is in."""
    if not road.buildings:
        return np.empty((0, 2, 2))
    ends, building = _walls(road)
    near = np.hypot(*np.moveaxis(ends - point_m, -1, 0)).min(axis=1) < _WALLS_M
    around = ends - point_m
    (x0, y0), (x1, y1) = around[:, 0].T, around[:, 1].T
    spans = (y0 > 0) != (y1 > 0)
    rise = np.where(spans, y1 - y0, 1.0)
    right = spans & (x0 - y0 * (x1 - x0) / rise > 0)
    crossings = np.bincount(building, right, minlength=len(road.buildings)).astype(int)
    outside: Bools = np.equal(crossings % 2, 0)
    return ends[near & outside[building]]
