"""The opponent predictor: features of each vehicle and the AV, and a score of their interaction.

`Pair` names what is known of a vehicle's relation to the AV. Part of it follows from poses and
motions alone; the other part from routes along the lane graph, on which vehicles follow, cross and
merge. These routes are coarse, since those of many vehicles are needed in a few milliseconds;
`lanes.path_set` prepares one vehicle's paths finely enough to drive on.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.encode import (
    Features,
    agent_arrays,
    draw,
    lane_arrays,
    pack,
    recent_change,
    span,
    stacked,
)
from deepmf_sumo.deepmf.networks.lanes import (
    RoadIndex,
    first_signal,
    lane_sequences,
    road_index,
    signal_colour,
)
from deepmf_sumo.scene import (
    AgentId,
    Bools,
    Floats,
    Ints,
    OpponentScores,
    RoadMap,
    SignalState,
    View,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.frames import pose_of
from deepmf_sumo.scene.geometry.ground import clear

OTHERS: Final = 63
"""Slots of agents around the AV."""
LANES: Final = 48
SLOTS: Final[tuple[str, ...]] = ("pair", "vehicle")
"""Features with a row for each of them."""
RANGE_M: Final = 80.0


class Pair(IntEnum):
    """Columns of ``pair``: a vehicle and the AV, in the AV's frame, scaled for the network.

    Pose and motion of the vehicle (AHEAD to WIDTH), the AV in the vehicle's frame (AV_AHEAD to
    FASTER), the AV's motion, and the number of vehicles.

    STRAIGHT and TURNING: closest approach at constant velocity, and at constant turn and
    acceleration: least distance at the same time and that time, least distance of the paths at any
    two times, both times and their difference. RAY: where the lines along both headings cross:
    distances, times, their difference, and whether that is ahead of both.

    OWN: the vehicle's start lane and first signal. AV_LANE: the same of the AV. PLACE: the vehicle
    on the nearest of the AV's routes. AV_PLACE: the AV on the nearest of the vehicle's routes.
    MEETING: the soonest meeting of two of their routes: least distance; distances of both to it,
    times, and their difference; angle; whether they meet; whether each arrives within 8 s. FIRST:
    of the first routes. SHARE: of all pairs of routes that meet. Then the order on the lanes, and
    ranks among all vehicles.

    PARKED: see `Surroundings`. STANDS_IN, KNOWN: see `opponent_features`.
    """

    AHEAD, LEFT, BESIDE, DISTANCE, LOG_DISTANCE, CLOSENESS, BEARING_COS, BEARING_SIN = range(8)
    HEADING_COS, HEADING_SIN, VX, VY, SPEED, LOG_SPEED, CLOSING, ACCEL, YAW_RATE = range(8, 17)
    MOVED, MOVING, SEEN, LENGTH, WIDTH, AV_AHEAD, AV_LEFT, AV_BESIDE, FASTER = range(17, 26)
    AV_SPEED, AV_LOG_SPEED, AV_ACCEL, AV_YAW_RATE, AV_MOVING, AV_LENGTH = range(26, 32)
    VEHICLES, VEHICLES_MOVING = range(32, 34)
    STRAIGHT_SAME, STRAIGHT_SAME_TIME, STRAIGHT_LEAST = range(34, 37)
    STRAIGHT_TIME, STRAIGHT_AV_TIME, STRAIGHT_LAG = range(37, 40)
    TURNING_SAME, TURNING_SAME_TIME, TURNING_LEAST = range(40, 43)
    TURNING_TIME, TURNING_AV_TIME, TURNING_LAG = range(43, 46)
    RAY_AHEAD, RAY_AV_AHEAD, RAY_TIME, RAY_AV_TIME, RAY_LAG, RAY_CROSSES = range(46, 52)
    OWN_OFFSET, OWN_TURN, OWN_END, OWN_LIMIT, OWN_STOP, OWN_ROUTES, OWN_THERE = range(52, 59)
    OWN_RED, OWN_YELLOW, OWN_GREEN, OWN_UNKNOWN = range(59, 63)
    AV_LANE_OFFSET, AV_LANE_TURN, AV_LANE_END, AV_LANE_LIMIT, AV_LANE_STOP = range(63, 68)
    AV_LANE_ROUTES, AV_LANE_THERE, AV_LANE_RED, AV_LANE_YELLOW = range(68, 72)
    PLACE_OFFSET, PLACE_ALONG, PLACE_ALIGNED, PLACE_LEFT, PLACE_REACH = range(72, 77)
    PLACE_FIRST, PLACE_THERE = range(77, 79)
    AV_PLACE_OFFSET, AV_PLACE_ALONG, AV_PLACE_ALIGNED = range(79, 82)
    AV_PLACE_FIRST, AV_PLACE_THERE = range(82, 84)
    MEETING_LEAST, MEETING_AHEAD, MEETING_AV_AHEAD, MEETING_TIME, MEETING_AV_TIME = range(84, 89)
    MEETING_LAG, MEETING_COS, MEETING_SIN, MEETING_MET, MEETING_SOON, MEETING_AV_SOON = range(
        89, 95
    )
    FIRST_LEAST, SHARE_MET, SHARE_SOON, FIRST_SOON = range(95, 99)
    ORDER_AHEAD, ORDER_BEHIND, IS_BEHIND = range(99, 102)
    RANK_DISTANCE, RANK_MOVING, RANK_STRAIGHT, RANK_TURNING = range(102, 106)
    RANK_PLACE, RANK_MEETING, RANK_SAME, PARKED, STANDS_IN, KNOWN = range(106, 112)


Columns = dict[Pair, Any]
"""Some columns of ``pair``, (V) each for the vehicles around the AV, or a number for all."""
_STRAIGHT: Final = tuple(Pair)[span(Pair.STRAIGHT_SAME, Pair.STRAIGHT_LAG)]
_TURNING: Final = tuple(Pair)[span(Pair.TURNING_SAME, Pair.TURNING_LAG)]
_OWN: Final = tuple(Pair)[span(Pair.OWN_OFFSET, Pair.OWN_UNKNOWN)]
_AV_LANE: Final = tuple(Pair)[span(Pair.AV_LANE_OFFSET, Pair.AV_LANE_YELLOW)]
_PLACE: Final = tuple(Pair)[span(Pair.PLACE_OFFSET, Pair.PLACE_THERE)]
_AV_PLACE: Final = tuple(Pair)[span(Pair.AV_PLACE_OFFSET, Pair.AV_PLACE_THERE)]
_MEETING: Final = tuple(Pair)[span(Pair.MEETING_LEAST, Pair.MEETING_AV_SOON)]
_MET: Final = tuple(Pair)[span(Pair.FIRST_LEAST, Pair.FIRST_SOON)]

_MOVED_M = 0.5
_ON_LANE_M, _ALONG_LANE_RAD = 2.0, np.deg2rad(45.0)
_STILL_MPS = 0.5
_TIMES_S = np.arange(0.0, 8.01, 0.5)
_MOST_YAW_RPS, _MOST_ACCEL_MPS2 = 0.8, 5.0


class OpponentNetwork(Protocol):
    """A network that scores the vehicles around the AV: in torch, or its ONNX graph."""

    @property
    def preset(self) -> Preset:
        """Its sizes."""
        ...

    def scored(self, arrays: Features) -> Floats:
        """(63, 2) logits of both heads, from `opponent_features`."""
        ...


class Opponent:
    """phi(X): how suitable each surrounding vehicle is as the opponent (paper, section IV-B).

    Args:
        net: in evaluation mode.
        temperature, partner_temperature: divide the logits, so that their sigmoid is calibrated.
        offset: added to those of the first head thereafter.
    """

    def __init__(
        self,
        net: OpponentNetwork,
        temperature: float,
        partner_temperature: float,
        offset: float = 0.0,
    ) -> None:
        self.net = net
        self.temperature = temperature
        self.partner_temperature = partner_temperature
        self.offset = offset

    def score(self, view: View, *, everyone: bool = False) -> OpponentScores:
        """Logits of both heads for vehicles within 80 m, nearest first.

        Parked vehicles, which cannot attack, are left out unless ``everyone`` is set.
        """
        arrays, around = opponent_features(view, self.net.preset)
        keep = np.flatnonzero(everyone | ~around.parked)
        logits = self.net.scored(arrays)[keep]
        ids = around.ids(view)
        return OpponentScores(
            ids=tuple(ids[row] for row in keep),
            logits=logits[:, 0] / self.temperature + self.offset,
            partner_logits=logits[:, 1] / self.partner_temperature,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """The agents around the AV.

    Attributes:
        rows: rows of the view: the AV, the vehicles within 80 m, nearest first, then others.
        vehicles: number of these vehicles.
        parked: (vehicles) has not moved in the history and stands off the lanes, or across them. A
            vehicle that waits on a lane may well attack.
    """

    rows: Ints
    vehicles: int
    parked: Bools

    def ids(self, view: View) -> tuple[AgentId, ...]:
        """Ids of the vehicles."""
        return tuple(view.history.ids[row] for row in self.rows[1 : self.vehicles + 1])


def surroundings(view: View) -> Surroundings:
    """The AV's surroundings: at most 63 others."""
    tracks = view.history
    av = tracks.row(view.av_id)
    distance = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[av, -1]).T)
    vehicle = np.array([kind == "vehicle" for kind in tracks.kinds], bool) & (distance <= RANGE_M)
    vehicle[av] = False
    order = np.lexsort((distance, ~vehicle))
    order = order[order != av][:OTHERS]
    vehicles = int(vehicle[order].sum())
    return Surroundings(
        rows=np.concatenate([[av], order]),
        vehicles=vehicles,
        parked=_parked(view, order[:vehicles]),
    )


def opponent_features(
    view: View, preset: Preset, *, known_s: float = 8.0, stands_in: bool = False
) -> tuple[Features, Surroundings]:
    """Arrays around the AV, and the agents in them.

    Keys: vehicle (63) 1 for slots that hold a vehicle, which come first. With the preset's pairs:
    pair (63) of `Pair`; with its vectors: agents (64, 11), agent_info (64), the AV first, then the
    slots; lanes (48, 10, 2), lane_info (48); with its image: raster; all as in `encode.Features`.

    Args:
        view: of the present.
        preset: of the network.
        known_s: time ahead from which the labels are made, a feature.
        stands_in: the AV of this view is another vehicle of the recording: it observed less.
    """
    around = surroundings(view)
    arrays: Features = {"vehicle": (np.arange(OTHERS) < around.vehicles).astype(np.float32)}
    if preset.pairs:
        pair = np.zeros((OTHERS, len(Pair)), np.float32)
        if around.vehicles:
            columns = pair_columns(view, around)
            columns |= {Pair.STANDS_IN: float(stands_in), Pair.KNOWN: known_s / 8.0}
            pair[: around.vehicles] = stacked(Pair, columns, around.vehicles)
        arrays["pair"] = pair
    index, pose = road_index(view.road), pose_of(view, view.av_id)
    if preset.vectors:
        agents, info = agent_arrays(view, around.rows, OTHERS + 1, pose)
        lanes, lane_info = lane_arrays(view, index, LANES, pose)
        arrays["agents"], arrays["agent_info"] = agents.astype(np.float32), info.astype(np.float32)
        arrays["lanes"] = lanes.astype(np.float32)
        arrays["lane_info"] = lane_info.astype(np.float32)
    if preset.raster:
        arrays["raster"] = pack(draw(view, index, preset, pose))
    return arrays, around


def _parked(view: View, rows: Ints) -> Bools:
    """(A) see `Surroundings`."""
    tracks = view.history
    valid = tracks.valid[rows][..., None]
    high = np.where(valid, tracks.position_m[rows], -np.inf).max(1)
    low = np.where(valid, tracks.position_m[rows], np.inf).min(1)
    still = ((high - low).max(-1) <= _MOVED_M) & (tracks.speed_mps[rows, -1] <= _STILL_MPS)
    pose = tracks.position_m[rows, -1], tracks.heading_rad[rows, -1]
    index, turn = road_index(view.road), float(_ALONG_LANE_RAD)
    return still & ~index.on_lanes(*pose, _ON_LANE_M, turn, tracks.z_m[rows, -1])


def pair_columns(view: View, around: Surroundings) -> Columns:
    """All columns of `Pair` that follow from the view, for the vehicles around the AV."""
    rows = around.rows[: around.vehicles + 1]
    motion = motion_of(view, rows)
    found = _motion_columns(motion) | _constant_columns(motion) | _lane_columns(view, rows, motion)
    return found | _rank_columns(motion, found) | {Pair.PARKED: around.parked}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Motion of V vehicles now, in the AV's frame; the AV is the first.

    Attributes:
        position_m, velocity_mps: (V, 2). heading_rad, speed_mps: (V).
        accel_mps2, yaw_rps: (V) change of speed and heading over the last half second.
        moved_m: (V) distance to the first known position of the last second. seen: (V) share of its
            steps in which the vehicle is known.
        size_m: (V, 2) length, width.
    """

    position_m: Floats
    velocity_mps: Floats
    heading_rad: Floats
    speed_mps: Floats
    accel_mps2: Floats
    yaw_rps: Floats
    moved_m: Floats
    seen: Floats
    size_m: Floats

    @property
    def moving(self) -> Bools:
        """(V)."""
        return (self.moved_m > 0.5) | (self.speed_mps > _STILL_MPS)


def motion_of(view: View, rows: Ints) -> Motion:
    """Motion of the given rows of the view, the AV's first."""
    tracks = view.history
    pose = pose_of(view, tracks.ids[rows[0]])
    valid = tracks.valid[rows]
    first = valid.argmax(1)
    accel, yaw = recent_change(tracks, rows, view.dt_s)
    apart = tracks.position_m[rows, -1] - tracks.position_m[rows, first]
    return Motion(
        position_m=pose.to_local(tracks.position_m[rows, -1]),
        velocity_mps=pose.vectors(tracks.velocity_mps[rows, -1]),
        heading_rad=pose.turn_rad(tracks.heading_rad[rows, -1]),
        speed_mps=tracks.speed_mps[rows, -1],
        accel_mps2=np.clip(accel, -_MOST_ACCEL_MPS2, _MOST_ACCEL_MPS2),
        yaw_rps=np.clip(yaw, -_MOST_YAW_RPS, _MOST_YAW_RPS),
        moved_m=np.hypot(apart[:, 0], apart[:, 1]),
        seen=valid.mean(1),
        size_m=tracks.size_m[rows, :2],
    )


def _motion_columns(motion: Motion) -> Columns:
    """Poses and motions of all but the AV, the AV in their frames, the AV's motion."""
    x, y = motion.position_m[1:].T
    vx, vy = motion.velocity_mps[1:].T
    ego_speed = motion.speed_mps[0]
    heading, speed = motion.heading_rad[1:], motion.speed_mps[1:]
    distance = np.hypot(x, y)
    closing = -(x * (vx - ego_speed) + y * vy) / np.maximum(distance, 1.0)
    cos, sin = np.cos(heading), np.sin(heading)
    back_x, back_y = -(x * cos + y * sin), x * sin - y * cos
    return {
        Pair.AHEAD: x / 30,
        Pair.LEFT: y / 30,
        Pair.BESIDE: np.minimum(np.abs(y) / 10, 4),
        Pair.DISTANCE: distance / 30,
        Pair.LOG_DISTANCE: np.log1p(distance) / 2,
        Pair.CLOSENESS: np.exp(-distance / 10),
        Pair.BEARING_COS: x / np.maximum(distance, 1.0),
        Pair.BEARING_SIN: y / np.maximum(distance, 1.0),
        Pair.HEADING_COS: cos,
        Pair.HEADING_SIN: sin,
        Pair.VX: vx / 15,
        Pair.VY: vy / 15,
        Pair.SPEED: speed / 15,
        Pair.LOG_SPEED: np.log1p(speed),
        Pair.CLOSING: closing / 15,
        Pair.ACCEL: motion.accel_mps2[1:] / 3,
        Pair.YAW_RATE: motion.yaw_rps[1:] * 3,
        Pair.MOVED: np.minimum(motion.moved_m[1:] / 5, 5),
        Pair.MOVING: motion.moving[1:],
        Pair.SEEN: motion.seen[1:],
        Pair.LENGTH: motion.size_m[1:, 0] / 5,
        Pair.WIDTH: motion.size_m[1:, 1] / 2,
        Pair.AV_AHEAD: back_x / 30,
        Pair.AV_LEFT: back_y / 30,
        Pair.AV_BESIDE: np.minimum(np.abs(back_y) / 10, 4),
        Pair.FASTER: (speed - ego_speed) / 15,
    } | _av_columns(motion)


def _av_columns(motion: Motion) -> Columns:
    """The AV's motion, and the number of vehicles: the same for all vehicles."""
    speed = motion.speed_mps[0]
    return {
        Pair.AV_SPEED: speed / 15,
        Pair.AV_LOG_SPEED: np.log1p(speed),
        Pair.AV_ACCEL: motion.accel_mps2[0] / 3,
        Pair.AV_YAW_RATE: motion.yaw_rps[0] * 3,
        Pair.AV_MOVING: motion.moving[0],
        Pair.AV_LENGTH: motion.size_m[0, 0] / 5,
        Pair.VEHICLES: (len(motion.speed_mps) - 1) / 30,
        Pair.VEHICLES_MOVING: motion.moving[1:].sum() / 15,
    }


def _constant_columns(motion: Motion) -> Columns:
    """STRAIGHT, TURNING and RAY, see `Pair`."""
    straight = _constant_paths(
        motion, np.zeros_like(motion.speed_mps), np.zeros_like(motion.yaw_rps)
    )
    turning = _constant_paths(motion, motion.accel_mps2, motion.yaw_rps)
    found = dict(zip(_STRAIGHT, _nearest(straight), strict=True))
    return found | dict(zip(_TURNING, _nearest(turning), strict=True)) | _ray_columns(motion)


def _constant_paths(motion: Motion, accel_mps2: Floats, yaw_rps: Floats) -> Floats:
    """(V, 17, 2) positions over 8 s; acceleration acts for 2 s, turning for 4 s."""
    time = _TIMES_S[None]
    speed = np.maximum(motion.speed_mps[:, None] + accel_mps2[:, None] * np.minimum(time, 2.0), 0.0)
    course = motion.heading_rad[:, None] + yaw_rps[:, None] * np.minimum(time, 4.0)
    moves = motion.speed_mps > _STILL_MPS
    drift = np.arctan2(motion.velocity_mps[:, 1], motion.velocity_mps[:, 0])
    slip = np.where(moves, frames.difference(drift, motion.heading_rad), 0.0)
    step = 0.5 * (speed[:, 1:] + speed[:, :-1]) * np.diff(time)
    middle = 0.5 * (course[:, 1:] + course[:, :-1]) + slip[:, None]
    paths = np.zeros((len(speed), len(_TIMES_S), 2))
    paths[:, 1:] = np.cumsum(step[..., None] * frames.unit(middle), axis=1)
    return paths + motion.position_m[:, None]


def _nearest(paths: Floats) -> list[Any]:
    """Six columns of each path and the first path, see STRAIGHT of `Pair`."""
    own, ego = paths[1:], paths[0]
    same = np.linalg.norm(own - ego, axis=-1)
    apart = np.linalg.norm(own[:, :, None] - ego, axis=-1).reshape(len(own), -1)
    when = apart.argmin(1)
    least = np.take_along_axis(apart, when[:, None], 1)[:, 0]
    own_time, ego_time = np.divmod(when, len(_TIMES_S))
    return [
        np.minimum(same.min(1) / 10, 4), same.argmin(1) / 16, np.minimum(least / 10, 4),
        own_time / 16, ego_time / 16, (own_time - ego_time) / 16,
    ]  # fmt: skip


def _ray_columns(motion: Motion) -> Columns:
    """Crossing of the lines along both headings."""
    x, y = motion.position_m[1:].T
    sin, cos = np.sin(motion.heading_rad[1:]), np.cos(motion.heading_rad[1:])
    parallel = np.abs(sin) < 0.1
    safe = np.where(parallel, 1.0, sin)
    own_way = np.where(parallel, 200.0, np.clip(-y / safe, -100, 200))
    ego_way = np.where(parallel, 200.0, np.clip(x + own_way * cos, -100, 200))
    own_time = own_way / np.maximum(motion.speed_mps[1:], 2.0)
    ego_time = ego_way / max(float(motion.speed_mps[0]), 2.0)
    return {
        Pair.RAY_AHEAD: own_way / 50,
        Pair.RAY_AV_AHEAD: ego_way / 50,
        Pair.RAY_TIME: np.clip(own_time / 8, -1, 2),
        Pair.RAY_AV_TIME: np.clip(ego_time / 8, -1, 2),
        Pair.RAY_LAG: np.clip((own_time - ego_time) / 8, -2, 2),
        Pair.RAY_CROSSES: ~parallel & (own_way > 0) & (ego_way > 0),
    }


NODES: Final = 46
SPACING_M: Final = 4.0
"""Routes reach 180 m."""

_REACH_M = 5.0
_TURN_RAD = np.deg2rad(60.0)
_STARTS = 3
"""Start lanes of a vehicle, and continuations of each of them."""
_ROUTES_OF_START = (5, 2, 2)
_AHEAD_S, _AHEAD_M, _MOST_M = 8.0, 60.0, (NODES - 1) * SPACING_M
_ALONG = np.arange(NODES) * SPACING_M
_NO_STOP_M = 200.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Routes:
    """R routes, those of a vehicle together, the likeliest start lane first.

    Attributes:
        owner: (R) row of the vehicle in the arguments.
        rank: (R) 0 for the first route of each vehicle.
        node_m: (R, 46, 2) every 4 m along the lanes, straight on past the end of the graph.
        node_z_m: (R, 46) heights of the lanes there.
        direction: (R, 46, 2) unit vectors along the lanes.
        left_m, turn_rad: (R) the vehicle's offset from the start lane and its heading to it.
        end_m: (R) length of the lane graph, at most 180 m. limit_mps: (R) 0 where unknown.
        stop_m: (R) distance to the first signal, 200 without one.
        signal: (R, 4) one-hot red, yellow, green, unknown; zeros without a signal.
    """

    owner: Ints
    rank: Ints
    node_m: Floats
    node_z_m: Floats
    direction: Floats
    left_m: Floats
    turn_rad: Floats
    end_m: Floats
    limit_mps: Floats
    stop_m: Floats
    signal: Floats


class _Feet(NamedTuple):
    """Feet of vehicles on lanes, cheapest first within each vehicle."""

    vehicle: Ints
    segment: Ints
    lane: Ints
    along_m: Floats
    left_m: Floats
    turn_rad: Floats


def lane_routes(
    road: RoadMap,
    position_m: Floats,
    heading_rad: Floats,
    speed_mps: Floats,
    signals: dict[str, SignalState],
    z_m: Floats | None = None,
) -> Routes:
    """Routes of V vehicles: positions (V, 2), headings (V), speeds (V). Off the lanes: none.

    Where roads cross they start on the level nearest to the vehicles' heights (V), if given.
    """
    index = road_index(road)
    feet = _feet(index, position_m, heading_rad, z_m)
    owner, rank, foot_of, chains = [], [], [], []
    taken: dict[int, int] = {}
    starts: dict[int, int] = {}
    for foot, vehicle in enumerate(feet.vehicle.tolist()):
        number = starts.get(vehicle, 0)
        if number == _STARTS:
            continue
        starts[vehicle] = number + 1
        depth = min(_AHEAD_S * float(speed_mps[vehicle]) + _AHEAD_M, _MOST_M)
        lane, along = int(feet.lane[foot]), float(feet.along_m[foot])
        for chain in lane_sequences(index, lane, along, depth, _ROUTES_OF_START[number]):
            owner.append(vehicle)
            rank.append(taken.get(vehicle, 0))
            taken[vehicle] = rank[-1] + 1
            foot_of.append(foot)
            chains.append(chain)
    picked = np.array(foot_of, np.int64)
    return Routes(
        owner=np.array(owner, np.int64),
        rank=np.array(rank, np.int64),
        left_m=feet.left_m[picked],
        turn_rad=feet.turn_rad[picked],
        limit_mps=index.limit_mps[feet.lane[picked]],
        **_geometry(index, feet, picked, chains),
        **_stops(index, feet, picked, chains, signals),
    )


def passes_over(
    road: RoadMap, position_m: Floats, heading_rad: Floats, speed_mps: Floats, z_m: Floats
) -> Bools:
    """(V - 1) vehicles whose routes cross those of the first vehicle only on another level."""
    others = len(position_m) - 1
    over, level = np.zeros((2, others), bool)
    if not road_index(road).has_levels:
        return over
    routes = lane_routes(road, position_m, heading_rad, speed_mps, {}, z_m)
    mine = routes.owner == 0
    node, height = routes.node_m[mine].reshape(-1, 2), routes.node_z_m[mine].reshape(-1)
    for row in np.flatnonzero(~mine):
        other = routes.owner[row] - 1
        apart = routes.node_m[row][:, None] - node
        near = (apart**2).sum(-1) < SPACING_M**2
        same = ~clear(routes.node_z_m[row][:, None], height)
        over[other] |= near.any()
        level[other] |= (near & same).any()
    return over & ~level


def _feet(index: RoadIndex, position_m: Floats, heading_rad: Floats, z_m: Floats | None) -> _Feet:
    """The foot of each vehicle on each lane within reach and angle."""
    pairs = index.near(position_m, heading_rad, z_m)
    kept = np.flatnonzero((pairs.apart_m < _REACH_M) & (np.abs(pairs.turn_rad) < _TURN_RAD))
    kept = kept[np.argsort(pairs.apart_m[kept], kind="stable")]
    lane = index.map.lane[pairs.segment[kept]]
    _, first = np.unique(pairs.pose[kept] * (len(index.lane_ids) + 1) + lane, return_index=True)
    kept = kept[first]
    cost = pairs.apart_m[kept] + 4 * np.abs(pairs.turn_rad[kept])
    kept = kept[np.lexsort((cost, pairs.pose[kept]))]
    segment = pairs.segment[kept]
    return _Feet(
        pairs.pose[kept],
        segment,
        index.map.lane[segment],
        index.along_m[segment] + pairs.along_m[kept],
        pairs.left_m[kept],
        pairs.turn_rad[kept],
    )


def _geometry(
    index: RoadIndex, feet: _Feet, picked: Ints, chains: list[tuple[int, ...]]
) -> dict[str, Floats]:
    """Nodes, directions and ends of the routes."""
    node, direction = np.empty((2, len(chains), NODES, 2))
    height = np.empty((len(chains), NODES))
    end = np.empty(len(chains))
    first_of = index.map.first
    for row, (foot, lanes) in enumerate(zip(picked.tolist(), chains, strict=True)):
        spans = [np.arange(feet.segment[foot], first_of[lanes[0] + 1])]
        spans += [np.arange(first_of[lane], first_of[lane + 1]) for lane in lanes[1:]]
        segment = np.concatenate(spans)
        length = index.step_m[segment]
        before = np.cumsum(length) - length
        first = feet.along_m[foot] - index.along_m[feet.segment[foot]]
        at = np.maximum(np.searchsorted(before, _ALONG + first, side="right") - 1, 0)
        direction[row] = index.direction[segment[at]]
        height[row] = index.map.z_m[segment[at]]
        on = _ALONG + first - before[at]
        node[row] = index.map.start_m[segment[at]] + on[:, None] * direction[row]
        end[row] = before[-1] + length[-1] - first
    return {
        "node_m": node,
        "node_z_m": height,
        "direction": direction,
        "end_m": np.minimum(end, _MOST_M),
    }


def _stops(
    index: RoadIndex,
    feet: _Feet,
    picked: Ints,
    chains: list[tuple[int, ...]],
    signals: dict[str, SignalState],
) -> dict[str, Floats]:
    """Distance and colour of the first signal that is not behind."""
    stop, colour = np.full(len(chains), _NO_STOP_M), np.zeros((len(chains), 4))
    if not signals:
        return {"stop_m": stop, "signal": colour}
    for row, (foot, lanes) in enumerate(zip(picked.tolist(), chains, strict=True)):
        met = first_signal(index, lanes, float(feet.along_m[foot]), signals)
        if met is not None:
            stop[row] = min(met[0], _NO_STOP_M)
            colour[row, signal_colour(met[1])] = 1.0
    return {"stop_m": stop, "signal": colour}


_FAR = 4.0
_MEET_M = 2.5
"""Routes whose centre lines come nearer than this meet."""
_NODES_OWN = 36
"""Nodes of other vehicles' routes that are compared: 140 m."""
_ELSEWHERE_M = 400.0
"""Distance of nodes of which one passes over the other: above the cap of all features."""
_TIME_CAP_S = 16.0
_LEAST_MPS = 4.0
"""Times of arrival are at this speed at least: a vehicle that stands may drive off."""


def _lane_columns(view: View, rows: Ints, motion: Motion) -> Columns:
    """What routes tell of all but the AV, which is the first of the rows."""
    tracks = view.history
    routes = lane_routes(
        view.road,
        tracks.position_m[rows, -1],
        tracks.heading_rad[rows, -1],
        tracks.speed_mps[rows, -1],
        view.signals,
        tracks.z_m[rows, -1],
    )
    pose = pose_of(view, tracks.ids[rows[0]])
    levels = road_index(view.road).has_levels
    relative = replace(
        routes,
        node_m=pose.to_local(routes.node_m),
        direction=pose.vectors(routes.direction),
        node_z_m=routes.node_z_m if levels else np.zeros_like(routes.node_z_m),
    )
    own = np.stack([_own_lane(relative, owner) for owner in range(len(rows))])
    found: Columns = dict(zip(_OWN, own[1:].T, strict=True))
    found |= dict(zip(_AV_LANE, own[0], strict=False))
    found |= _place_columns(relative, motion) | _av_place_columns(relative, len(rows) - 1)
    found |= _meeting_columns(relative, motion, len(rows) - 1)
    return found | _order_columns(found)


def _own_lane(routes: Routes, owner: int) -> Floats:
    """(11) of the first route, see OWN of `Pair`."""
    out = np.zeros(len(_OWN))
    mine = np.flatnonzero(routes.owner == owner)
    if len(mine) == 0:
        return out
    row, stop = mine[0], mine[routes.stop_m[mine].argmin()]
    out[:7] = (
        routes.left_m[row] / 3, routes.turn_rad[row] * 2, routes.end_m[row] / 100,
        routes.limit_mps[row] / 15, min(routes.stop_m[stop] / 50, _FAR), len(mine) / 5, 1.0,
    )  # fmt: skip
    out[7:] = routes.signal[stop]
    return out


def _place_columns(routes: Routes, motion: Motion) -> Columns:
    """Each vehicle on the nearest of the AV's routes."""
    position = motion.position_m[1:]
    mine = np.flatnonzero(routes.owner == 0)
    if len(mine) == 0:
        found: Columns = dict.fromkeys(_PLACE, 0.0)
        return found | {Pair.PLACE_OFFSET: np.full(len(position), _FAR)}
    along, left, cos, sin = _feet_on_routes(routes, mine, position)  # (E, C)
    best = np.abs(left).argmin(0)
    each = np.arange(len(position))
    unit = frames.unit(motion.heading_rad[1:])
    along, left = along[best, each], left[best, each]
    return {
        Pair.PLACE_OFFSET: np.minimum(np.abs(left) / 5, _FAR),
        Pair.PLACE_ALONG: np.clip(along / 50, -1, _FAR),
        Pair.PLACE_ALIGNED: cos[best, each] * unit[:, 0] + sin[best, each] * unit[:, 1],
        Pair.PLACE_LEFT: np.clip(left / 5, -_FAR, _FAR),
        Pair.PLACE_REACH: np.clip(along / max(8 * float(motion.speed_mps[0]), 8.0), -1, _FAR),
        Pair.PLACE_FIRST: best == 0,
        Pair.PLACE_THERE: 1.0,
    }


def _av_place_columns(routes: Routes, count: int) -> Columns:
    """The AV on the nearest of each vehicle's routes."""
    found = {column: np.zeros(count) for column in _AV_PLACE}
    found[Pair.AV_PLACE_OFFSET][:] = _FAR
    others = np.flatnonzero(routes.owner > 0)
    if len(others) == 0:
        return dict(found)
    along, left, cos, _ = _feet_on_routes(routes, others, np.zeros((1, 2)))
    owner = routes.owner[others]
    order = np.lexsort((np.abs(left[:, 0]), owner))
    owner, first = np.unique(owner[order], return_index=True)
    pick, row = order[first], owner - 1
    found[Pair.AV_PLACE_OFFSET][row] = np.minimum(np.abs(left[pick, 0]) / 5, _FAR)
    found[Pair.AV_PLACE_ALONG][row] = np.clip(along[pick, 0] / 50, -1, _FAR)
    found[Pair.AV_PLACE_ALIGNED][row] = cos[pick, 0]
    found[Pair.AV_PLACE_FIRST][row] = routes.rank[others[pick]] == 0
    found[Pair.AV_PLACE_THERE][row] = 1.0
    return dict(found)


def _feet_on_routes(
    routes: Routes, rows: Ints, query: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Queries (Q, 2) on R of the routes: along, left (R, Q) and the route's direction there.

    Behind the first node and past the last the route goes on straight.
    """
    node, direction = routes.node_m[rows], routes.direction[rows]
    offset = query[None, :, None] - node[:, None]
    best = (offset * offset).sum(-1).argmin(-1)
    row = np.arange(len(node))[:, None]
    way = direction[row, best]
    away = query[None] - node[row, best]
    along = best * SPACING_M + (away * way).sum(-1)
    left = way[..., 0] * away[..., 1] - way[..., 1] * away[..., 0]
    return along, left, way[..., 0], way[..., 1]


class _PairOnRoutes(NamedTuple):
    """First meetings of pairs of routes: (R, E, 11) of MEETING in `Pair`, met, seconds until then.

    Of pairs that do not meet it is the point of least distance; their ``late`` is 40 and this
    distance, later than all that meet.
    """

    columns: Floats
    met: Bools
    late: Floats


def _meeting_columns(routes: Routes, motion: Motion, count: int) -> Columns:
    """The soonest meeting of routes, the distance of the first routes, shares that meet."""
    soonest, rest = np.zeros((count, len(_MEETING))), np.zeros((count, len(_MET)))
    soonest[:, 0], soonest[:, 1] = _FAR, _FAR
    soonest[:, 2:8] = 2.0
    mine, others = np.flatnonzero(routes.owner == 0), np.flatnonzero(routes.owner > 0)
    if len(mine) and len(others):
        owner = routes.owner[others]
        own_mps = np.maximum(motion.speed_mps[owner], _LEAST_MPS)[:, None]
        ego_mps = max(float(motion.speed_mps[0]), _LEAST_MPS)
        found = _first_meetings(routes, others, mine, own_mps, ego_mps)
        soon = found.met & (found.late < 8)
        for other in np.unique(owner):
            part = np.flatnonzero(owner == other)
            row, column = np.divmod(int(found.late[part].argmin()), len(mine))
            soonest[other - 1] = found.columns[part[row], column]
            rest[other - 1] = (
                found.columns[part[0], 0, 0], found.met[part].mean(), soon[part].mean(),
                soon[part[0], 0],
            )  # fmt: skip
    return dict(zip((*_MEETING, *_MET), (*soonest.T, *rest.T), strict=True))


def _first_meetings(
    routes: Routes, others: Ints, mine: Ints, own_mps: Floats, ego_mps: float
) -> _PairOnRoutes:
    """First meetings of R of the routes and E of the AV's; speeds (R, 1) and the AV's."""
    own, ego = routes.node_m[others], routes.node_m[mine]
    own_direction, ego_direction = routes.direction[others], routes.direction[mine]
    apart = _apart(own[:, :_NODES_OWN], ego)  # (R, 36, E, 46)
    own_z_m, ego_z_m = routes.node_z_m[others], routes.node_z_m[mine]
    if own_z_m.any() or ego_z_m.any():
        apart[clear(own_z_m[:, :_NODES_OWN, None, None], ego_z_m)] = _ELSEWHERE_M**2
    nearest = apart.argmin(3)
    square = np.take_along_axis(apart, nearest[..., None], 3)[..., 0]
    least = np.sqrt(square)  # (R, 36, E)
    meets = least < _MEET_M
    met: Bools = np.asarray(meets.any(1))
    first = np.where(met, meets.argmax(1), least.argmin(1))  # (R, E) own node
    ego_node = np.take_along_axis(nearest, first[:, None], 1)[:, 0]
    own_m, ego_m = first * SPACING_M, ego_node * SPACING_M
    own_s = np.minimum(own_m / own_mps, _TIME_CAP_S)
    ego_s = np.minimum(ego_m / ego_mps, _TIME_CAP_S)
    way = own_direction[np.arange(len(own))[:, None], first]
    ego_way = ego_direction[np.arange(len(ego))[None], ego_node]
    columns = np.stack(
        [
            np.minimum(least.min(1), 40.0) / 10, np.minimum(own_m / 50, _FAR),
            np.minimum(ego_m / 50, _FAR), own_s / 8, ego_s / 8, (own_s - ego_s) / 8,
            (way * ego_way).sum(-1), ego_way[..., 0] * way[..., 1] - ego_way[..., 1] * way[..., 0],
            met, own_m < 8 * own_mps, ego_m < 8 * ego_mps,
        ],
        axis=-1,
    )  # fmt: skip
    late = np.where(met, np.maximum(own_s, ego_s), 40.0 + least.min(1))
    return _PairOnRoutes(columns, met, late)


def _apart(own: Floats, ego: Floats) -> NDArray[np.float32]:
    """(R, N, E, M) squared distances of nodes (R, N, 2) and (E, M, 2)."""
    first = own.reshape(-1, 2, 1).astype(np.float32)
    second = ego.reshape(-1, 2).T.astype(np.float32)
    square = first[:, 0] - second[0]
    square *= square
    across = first[:, 1] - second[1]
    across *= across
    square += across
    apart: NDArray[np.float32] = square.reshape(*own.shape[:2], *ego.shape[:2])
    return apart


def _order_columns(found: Columns) -> Columns:
    """1 / rank of the vehicles ahead on the AV's route, and of those behind it; is behind."""
    place, av_place = found[Pair.PLACE_ALONG], found[Pair.AV_PLACE_ALONG]
    ahead = (found[Pair.PLACE_OFFSET] < 0.4) & (found[Pair.PLACE_ALIGNED] > 0.5) & (place > 0)
    behind = found[Pair.AV_PLACE_OFFSET] < 0.4
    behind = behind & (found[Pair.AV_PLACE_ALIGNED] > 0.5) & (av_place > 0)
    return {
        Pair.ORDER_AHEAD: _nearness(ahead, place),
        Pair.ORDER_BEHIND: _nearness(behind, av_place),
        Pair.IS_BEHIND: behind,
    }


def _nearness(there: Bools, gap: Floats) -> Floats:
    """(V) 1 / (1 + rank by the gap) of the vehicles that are there, else 0."""
    out, rows = np.zeros(len(there)), np.flatnonzero(there)
    if len(rows):
        out[rows] = 1 / (1 + gap[rows].argsort(kind="stable").argsort(kind="stable"))
    return out


def _rank_columns(motion: Motion, found: Columns) -> Columns:
    """Each vehicle's rank by several measures of nearness."""
    distance = np.hypot(*motion.position_m[1:].T)
    late = np.maximum(found[Pair.MEETING_TIME], found[Pair.MEETING_AV_TIME])
    measures = {
        Pair.RANK_DISTANCE: distance,
        Pair.RANK_MOVING: distance + 1e3 * ~motion.moving[1:],
        Pair.RANK_STRAIGHT: found[Pair.STRAIGHT_LEAST],
        Pair.RANK_TURNING: found[Pair.TURNING_LEAST],
        Pair.RANK_PLACE: found[Pair.PLACE_OFFSET],
        Pair.RANK_MEETING: found[Pair.MEETING_LEAST] + late,
        Pair.RANK_SAME: found[Pair.STRAIGHT_SAME],
    }
    return {column: _rank(measure) for column, measure in measures.items()}


def _rank(values: Floats) -> Floats:
    """Logarithm of one plus the rank of each value; the least value has rank 0."""
    return np.log1p(values.argsort(kind="stable").argsort(kind="stable"))
