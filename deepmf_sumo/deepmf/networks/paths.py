"""Paths that a vehicle can take from its pose: along the lane graph, and a fan off the lanes.

Every path begins at the pose with the pose's heading, joins its lane within three seconds of
driving, and is given at equal distances, so that a point at any distance is one look-up.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.lanes import Foot, RoadIndex, first_signal, lane_sequences
from deepmf_sumo.scene import Bools, Floats, SignalState
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.signals import Colour, colour

LANE_PATHS: Final = 11
FAN_TURNS_RAD: Final = (0.0, 0.5, -0.5, 1.3, -1.3)
PATHS: Final = LANE_PATHS + len(FAN_TURNS_RAD)
NODES: Final = 121
NODE_SPACING_M: Final = 2.0
INFO: Final = 14
"""Columns of `PathSet.info`."""

_REACH_M = 6.5
_TURN_RAD = np.deg2rad(52.0)
_MAX_ROUTES = 48
_DUPLICATE_M = 1.2
_COLOURS: Final[tuple[Colour, ...]] = ("red", "yellow", "green")
_ALONG = np.arange(NODES) * NODE_SPACING_M


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathSet:
    """Up to 16 paths in the vehicle's frame; the valid ones come first, lane paths before the fan.

    Attributes:
        points_m: (16, 121, 2) every 2 m, straight on past the end of the lane graph.
        info: (16, 14) valid, fan, start offset m, start turn rad, length of the lane graph m, speed
            limit m/s (0 unknown), stop line ahead m (200 none), signal one-hot (none, red, yellow,
            green, unknown), start distance m, number of lanes.
        lanes: rows of the lanes of each lane path.
    """

    points_m: Floats
    info: Floats
    lanes: tuple[tuple[int, ...], ...]

    @property
    def valid(self) -> Bools:
        """(16)."""
        return self.info[:, 0] > 0


def path_set(
    index: RoadIndex,
    position_m: Floats,
    heading_rad: float,
    speed_mps: float,
    signals: dict[str, SignalState],
    z_m: float | None = None,
) -> PathSet:
    """The paths of a vehicle at a pose; see `RoadIndex.feet` for its height."""
    depth = min(8 * speed_mps + 60.0, 230.0)
    merge = max(3 * speed_mps, 10.0)
    routes = _routes(index, position_m, heading_rad, depth, z_m)
    points = np.zeros((PATHS, NODES, 2))
    info = np.zeros((PATHS, INFO))
    lanes: list[tuple[int, ...]] = []
    if routes:
        lines, ends = _lines(index, routes)
        lines = _joined(lines, routes, merge)
        kept = _distinct(lines, int(depth / NODE_SPACING_M))[:LANE_PATHS]
        local = frames.to_local(lines[kept], position_m, heading_rad)
        points[: len(kept)] = local
        for row, pick in enumerate(kept):
            info[row] = _describe(index, routes[pick], ends[pick], signals)
            lanes.append(routes[pick][1])
    count = len(lanes)
    points[count : count + len(FAN_TURNS_RAD)] = _fan(merge)
    info[count : count + len(FAN_TURNS_RAD), [0, 1, 7]] = 1.0
    info[count : count + len(FAN_TURNS_RAD), 6] = 200.0
    return PathSet(points_m=points, info=info, lanes=tuple(lanes))


Route = tuple[Foot, tuple[int, ...]]


def _routes(
    index: RoadIndex, position_m: Floats, heading_rad: float, depth: float, z_m: float | None
) -> list[Route]:
    """Lane sequences from all start lanes, cheapest start first."""
    feet = index.feet(position_m, heading_rad, _REACH_M, float(_TURN_RAD), z_m)
    feet.sort(key=lambda foot: foot.distance_m + 4 * abs(foot.turn_rad))
    routes: list[Route] = []
    for foot in feet:
        most = _MAX_ROUTES - len(routes)
        found = lane_sequences(index, foot.lane, foot.along_m, depth, most)
        routes += [(foot, lanes) for lanes in found]
    return routes


def _lines(index: RoadIndex, routes: list[Route]) -> tuple[Floats, Floats]:
    """(R, 121, 2) centre lines from the foot on, and (R) where the lane graph ends."""
    lines = np.empty((len(routes), NODES, 2))
    ends = np.empty(len(routes))
    for row, (foot, lanes) in enumerate(routes):
        first, *rest = (index.map.line_m[lane] for lane in lanes)
        spacing = index.length_m[lanes[0]] / (len(first) - 1)
        at = min(foot.along_m / spacing, len(first) - 1 - 1e-6)
        base = int(at)
        start = first[base] + (at - base) * (first[base + 1] - first[base])
        points = np.concatenate([start[None], first[base + 1 :], *(line[1:] for line in rest)])
        step = np.diff(points, axis=0)
        length = np.hypot(step[:, 0], step[:, 1])
        keep = length > 1e-6
        direction = step[keep][-1] / length[keep][-1] if keep.any() else np.array([1.0, 0.0])
        along = np.concatenate([[0.0], np.cumsum(length)])
        ends[row] = along[-1]
        points = np.concatenate([points, points[-1:] + 400.0 * direction])
        along = np.append(along, along[-1] + 400.0)
        lines[row, :, 0] = np.interp(_ALONG, along, points[:, 0])
        lines[row, :, 1] = np.interp(_ALONG, along, points[:, 1])
    return lines, ends


def _joined(lines: Floats, routes: list[Route], merge_m: float) -> Floats:
    """The lines, shifted sideways so that they begin at the pose, with its heading (Hermite)."""
    left = np.array([foot.left_m for foot, _ in routes])[:, None]
    slope = np.tan(np.clip([foot.turn_rad for foot, _ in routes], -0.9, 0.9))[:, None]
    share = np.minimum(_ALONG / merge_m, 1.0)
    offset = left * (1 + 2 * share) * (1 - share) ** 2
    offset = offset + merge_m * slope * share * (1 - share) ** 2
    tangent = np.gradient(lines, axis=1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    return lines + offset[..., None] * normal


def _distinct(lines: Floats, nodes: int) -> list[int]:
    """Rows of lines that are somewhere more than 1.2 m from all rows kept before."""
    sampled = lines[:, : max(nodes, 2) : 3]
    kept: list[int] = []
    for row in range(len(lines)):
        apart = np.abs(sampled[kept] - sampled[row]).max(axis=(1, 2))
        if not kept or apart.min() > _DUPLICATE_M:
            kept.append(row)
        if len(kept) == LANE_PATHS:
            break
    return kept


def _describe(
    index: RoadIndex, route: Route, end_m: float, signals: dict[str, SignalState]
) -> Floats:
    """(14) see `PathSet.info`."""
    foot, lanes = route
    stop, state = 200.0, np.array([1.0, 0, 0, 0, 0])
    met = first_signal(index, lanes, foot.along_m, signals)
    if met is not None:
        stop, state = met[0], _one_hot(met[1])
    limit = index.limit_mps[lanes[0]]
    head = [1.0, 0.0, foot.left_m, foot.turn_rad, min(end_m, 240.0), limit, min(stop, 200.0)]
    return np.array([*head, *state, foot.distance_m, len(lanes)])


def _one_hot(signal: SignalState) -> Floats:
    state = np.zeros(5)
    state[1 + signal_colour(signal)] = 1.0
    return state


def signal_colour(signal: SignalState) -> int:
    """0 red, 1 yellow, 2 green, 3 unknown."""
    found = colour(signal)
    return len(_COLOURS) if found is None else _COLOURS.index(found)


def _fan(merge_m: float) -> Floats:
    """(5, 121, 2) straight on, and arcs that turn by the fan's angles, then go straight."""
    reach = max(1.5 * merge_m, 18.0)
    turns = np.array(FAN_TURNS_RAD)[:, None]
    heading = turns * np.minimum((_ALONG[:-1] + NODE_SPACING_M / 2) / reach, 1.0)
    steps = NODE_SPACING_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    points = np.zeros((len(turns), NODES, 2))
    points[:, 1:] = np.cumsum(steps, axis=1)
    return points
