"""phi_M of people: futures of a pedestrian or a cyclist (paper, section IV-C1, for its class).

The trajectory networks know vehicles on lanes. People walk where no lane is, start within a step,
and turn on the spot. Their futures are a mixture of motions: a way that is chosen (straight on,
a turn, over the road at a right angle, beside it; of cyclists also along the lane), times a speed
(kept, stopped, walking, running; now or some seconds later). No number here is trained: directions
and delays are spread evenly over what people can do, speeds are published.

- Walking 1.36 m/s +- 0.24, starting with 0.14 g (Randles, 288 people).
- Running at 8 km/h, which is the adult from the far side of Euro NCAP's protocol of 2026.
- A rider of Euro NCAP's protocol has 15 km/h, or 20.

Widths of the kernels are those of such a motion: along it the speed's standard deviation, across it
a wandering of 6 degrees; both as Laplace distributions of the same deviation.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np

from deepmf_sumo.deepmf.networks import decode
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS
from deepmf_sumo.scene import (
    DT_S,
    FUTURE_STEPS,
    AgentId,
    Floats,
    Forecast,
    Futures,
    Heat,
    Lane,
    RoadMap,
    View,
)
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.frames import AgentFrame, pose_of
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.scene.geometry.lane_map import Feet, LaneMap
from deepmf_sumo.scene.geometry.road import all_lanes, lanes_for_cars
from deepmf_sumo.scene.road_users import ROAD_USERS, MotionModel, road_user

_SECONDS: Final = DT_S * np.arange(1, FUTURE_STEPS + 1)
_MOVES_MPS: Final = 0.3
"""A person who is slower stands: recorded positions of one who stands move as fast."""
_MEASURED_STEPS: Final = 5
"""The speed now is that of the last 0.5 s: a step goes left and right."""
_WALKS: Final = ROAD_USERS["pedestrian"].motion
_WANDERS_RAD: Final = np.radians(6.0)
_LAPLACE: Final = 1 / np.sqrt(2.0)
"""Scale of a Laplace distribution per standard deviation."""
_NOW_M: Final = 0.15
"""Deviation at the start: half a step aside."""
_NEAR_ROAD_M: Final = 15.0
"""Farther from every lane nobody is about to cross."""
_TURN_M: Final = 0.6
"""Metres in which a walking person turns."""
_LANE_M: Final = 3.0
"""A cyclist who is nearer to the middle of a lane rides along it, or beside it."""
_ALONG: Final = 0.5
"""Cosine: within 60 degrees."""
_BRANCHES: Final = 4
_SHOWN: Final = 0.95
"""Share of the mass that a heat map shows."""


class _Way(NamedTuple):
    """A way from where the person is: (P, 2) points and its share of the choices."""

    points_m: Floats
    share: float


class _Pace(NamedTuple):
    """(80) metres that are covered, and its share of the choices."""

    covered_m: Floats
    share: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PeoplePrediction:
    """Where a person may go from one moment on: N motions with their shares.

    Attributes:
        agent_id: the person.
        position_m: (N, 80, 2) in the scene's frame. heading_rad: (N, 80).
        share: (N) sums to 1.
        width_m: (N, 5, 2) scales of the Laplace kernels along and across at 1, 2, 4, 6, 8 s.
        along_rad: (N, 5) the direction that is along, at these times.
    """

    agent_id: AgentId
    position_m: Floats
    heading_rad: Floats
    share: Floats
    width_m: Floats
    along_rad: Floats

    def modes(self, count: int, *, chosen_at: int | None = None) -> Forecast:
        """At most ``count`` futures of 80 steps each, most likely first.

        They are chosen to cover where the person may be at 8 s, or at the step ``chosen_at`` (0 to
        79). There are fewer where there are fewer motions.
        """
        count = min(count, len(self.share))
        ends = self.position_m[:, FUTURE_STEPS - 1 if chosen_at is None else chosen_at]
        local = (ends - self.position_m[0, 0]).astype(np.float32)  # single: far from the origin
        share = self.share.astype(np.float32)[None, :, None]
        chosen, mass = decode.select(share, local[None], count)
        rows = chosen[0]
        return Forecast(
            futures=Futures(
                agent_id=self.agent_id,
                position_m=self.position_m[rows],
                heading_rad=self.heading_rad[rows],
            ),
            probability=mass[0].astype(float) / float(mass[0].sum()),
        )

    def log_density(self, position_m: Floats) -> Floats:
        """(K) log density of trajectories (K, 80, 2) at the knots, in log 1/m^10."""
        kernel = self._kernels(np.asarray(position_m, float)[:, list(KNOT_STEPS)])
        return _logsumexp(kernel.sum(-1) + np.log(self.share))

    def knot_log_density(self, knots_m: Floats) -> Floats:
        """(K, 5) log density of places (K, 5, 2) at each knot by itself, in log 1/m^2."""
        kernel = self._kernels(np.asarray(knots_m, float)).swapaxes(1, 2)
        return _logsumexp(kernel + np.log(self.share))

    def drawn(self, count: int, rng: np.random.Generator) -> Floats:
        """(count, 5, 2) places at the knots, drawn from the mixture."""
        rows = rng.choice(len(self.share), count, p=self.share)
        place = self.position_m[rows][:, list(KNOT_STEPS)]
        off = rng.laplace(size=(count, len(KNOT_STEPS), 2)) * self.width_m[rows]
        along = frames.unit(self.along_rad[rows])
        left = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        return np.asarray(place + off[..., :1] * along + off[..., 1:] * left)

    def _kernels(self, knots_m: Floats) -> Floats:
        """(K, N, 5) log of each motion's kernel at places (K, 5, 2)."""
        away = knots_m[:, None] - self.position_m[None, :, list(KNOT_STEPS)]
        along = frames.unit(self.along_rad)
        ahead = np.abs((away * along).sum(-1))
        left = np.abs(away[..., 1] * along[..., 0] - away[..., 0] * along[..., 1])
        scale, across = self.width_m[..., 0], self.width_m[..., 1]
        return np.asarray(-ahead / scale - left / across - np.log(4 * scale * across))

    def end_density(self, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) log density of end points (Q, 2): a Gaussian of width ``kernel_m`` on each motion."""
        away = np.asarray(ends_m, float)[:, None] - self.position_m[None, :, -1]
        square = (away**2).sum(-1)
        kernel = -square / (2 * kernel_m**2) - np.log(2 * np.pi * kernel_m**2)
        return _logsumexp(kernel + np.log(self.share))

    def heat(self) -> Heat:
        """The likeliest ends that have 95 % of the mass."""
        best = np.argsort(-self.share, kind="stable")
        best = best[: int(np.searchsorted(np.cumsum(self.share[best]), _SHOWN)) + 1]
        return Heat(position_m=self.position_m[best, -1], probability=self.share[best])


def _logsumexp(values: Floats) -> Floats:
    top = values.max(-1, keepdims=True)
    found: Floats = np.log(np.exp(values - top).sum(-1)) + top[..., 0]
    return found


class Refinement(Protocol):
    """What is learned of people: `people_net.PeopleNet`."""

    def refined(self, view: View, untrained: PeoplePrediction) -> PeoplePrediction:
        """The prediction with other shares, places and widths."""
        ...


class People:
    """The predictor of people: `predict`.

    Args:
        net: what a set of weights has learned of people; None: as the module says.
    """

    def __init__(self, net: Refinement | None = None) -> None:
        self.net = net

    def predict(self, view: View, agent_id: AgentId) -> PeoplePrediction:
        """The prediction for a pedestrian or a cyclist. Raises KeyError if it is not in view."""
        found = untrained(view, agent_id)
        return found if self.net is None else self.net.refined(view, found)


def untrained(view: View, agent_id: AgentId) -> PeoplePrediction:
    """The prediction without what is learned. Raises KeyError if the agent is not in view."""
    tracks, row = view.history, view.history.row(agent_id)
    motion = road_user(tracks.kinds[row], tracks.size_m[row]).motion
    pose = moving_pose(view, agent_id)
    walks = motion.body == "point"
    z_m = float(tracks.z_m[row, -1])
    ways = [*(_walked if walks else _ridden)(view.road, pose, z_m)]
    paces = [*_paces(pose.speed_mps, motion)]
    position, heading, share = [], [], []
    for way in ways:
        points = polylines.Measured(way.points_m)
        for pace in paces:
            where, course = points.at(pace.covered_m)
            position.append(where)
            heading.append(np.where(pace.covered_m > 0, course, pose.heading_rad))
            share.append(way.share * pace.share)
    mass = np.array(share)
    return PeoplePrediction(
        agent_id=agent_id,
        position_m=np.stack(position),
        heading_rad=frames.wrap(np.stack(heading)),
        share=mass / mass.sum(),
        width_m=np.tile(_widths(pose.speed_mps), (len(mass), 1, 1)),
        along_rad=np.stack(heading)[:, list(KNOT_STEPS)],
    )


def moving_pose(view: View, agent_id: AgentId) -> AgentFrame:
    """The pose with the speed and the course of the last 0.5 s; at rest with its heading."""
    pose = pose_of(view, agent_id)
    tracks, row = view.history, view.history.row(pose.agent_id)
    known = np.flatnonzero(tracks.valid[row])[-_MEASURED_STEPS - 1 :]
    moved = tracks.position_m[row, -1] - tracks.position_m[row, known[0]]
    speed = float(np.hypot(*moved)) / (max(tracks.valid.shape[1] - 1 - known[0], 1) * view.dt_s)
    moves = speed > _MOVES_MPS
    heading = float(np.arctan2(moved[1], moved[0])) if moves else pose.heading_rad
    return AgentFrame(
        agent_id=pose.agent_id,
        position_m=pose.position_m,
        heading_rad=heading,
        speed_mps=speed if moves else 0.0,
    )


def _widths(speed_mps: float) -> Floats:
    """(5, 2) scales of the kernels along and across at the knots."""
    seconds = _SECONDS[list(KNOT_STEPS)]
    along = np.hypot(_NOW_M, _WALKS.spread_mps * seconds)
    across = np.hypot(_NOW_M, max(speed_mps, _WALKS.usual_mps[0]) * seconds * np.tan(_WANDERS_RAD))
    return np.stack([along, across], axis=-1) * _LAPLACE


def _paces(speed_mps: float, motion: MotionModel) -> Iterator[_Pace]:
    """What the person may do with its speed; at rest half of the people stay."""
    usual = motion.usual_mps
    if speed_mps > 0.0:
        yield _Pace(_covered(speed_mps, speed_mps, 0.0, motion), 0.5)
        yield _Pace(_covered(speed_mps, 0.0, 0.0, motion), 0.1)
        yield _Pace(_covered(speed_mps, 0.0, 2.0, motion), 0.1)
        yield _Pace(_covered(speed_mps, speed_mps / 2, 0.0, motion), 0.1)
        for other in usual:
            yield _Pace(_covered(speed_mps, other, 0.0, motion), 0.1)
        return
    yield _Pace(np.zeros(FUTURE_STEPS), 0.5)
    for delay_s in (0.0, 1.0, 2.0, 4.0):
        yield _Pace(_covered(0.0, usual[0], delay_s, motion), 0.1)
    yield _Pace(_covered(0.0, usual[1], 0.0, motion), 0.1)


def _covered(now_mps: float, then_mps: float, delay_s: float, motion: MotionModel) -> Floats:
    """(80) metres at a speed that changes to another one after a delay, within the limits."""
    then_mps = min(then_mps, motion.fastest_mps)
    rate = motion.planned.accel if then_mps > now_mps else -motion.planned.brake
    since = np.maximum(_SECONDS - delay_s, 0.0)
    changes_s = (then_mps - now_mps) / rate
    changing = np.minimum(since, changes_s)
    before = np.minimum(_SECONDS, delay_s) * now_mps
    return np.asarray(
        before + now_mps * changing + rate * changing**2 / 2 + then_mps * (since - changing)
    )


def _walked(road: RoadMap, pose: AgentFrame, z_m: float) -> Iterator[_Way]:
    """Ways of a pedestrian: on, to all sides, over the nearest road."""
    on = _WALKING_ON if pose.speed_mps > 0.0 else {0.0: 0.1}
    for degrees, share in (on | _TO_THE_SIDES).items():
        yield _Way(_straight(pose, np.radians(degrees)), share)
    across = _across(road, pose, z_m)
    for heading in across:
        turn = float(frames.difference(heading, pose.heading_rad))
        yield _Way(_straight(pose, turn), 0.3 / len(across))


_WALKING_ON: Final = {0.0: 0.4, 15.0: 0.1, -15.0: 0.1, 40.0: 0.05, -40.0: 0.05}
_TO_THE_SIDES: Final = {90.0: 0.05, -90.0: 0.05, 180.0: 0.05}
_RIDING_ON: Final = {
    0.0: 0.2, 20.0: 0.06, -20.0: 0.06, 45.0: 0.04, -45.0: 0.04, 90.0: 0.02, -90.0: 0.02,
}  # fmt: skip
"""Shares of ways by their turn, degrees to the left."""


def _across(road: RoadMap, pose: AgentFrame, z_m: float) -> list[float]:
    """Directions over the nearest road: from beside it towards it; on it to both sides."""
    lanes = lanes_for_cars(road)
    if not lanes.lanes:
        return []
    feet = _near(road, lanes, pose, _NEAR_ROAD_M, z_m)
    if not len(feet.segment):
        return []
    nearest = int(np.hypot(*feet.away_m.T).argmin())
    away = feet.away_m[nearest]
    lane = float(np.arctan2(*lanes.vector_m[feet.segment[nearest]][::-1]))
    if np.hypot(*away) <= lanes.reach_m[lanes.lane[feet.segment[nearest]]]:
        return [lane + np.pi / 2, lane - np.pi / 2]
    left = np.cos(np.arctan2(-away[1], -away[0]) - lane - np.pi / 2) > 0
    return [lane + (np.pi / 2 if left else -np.pi / 2)]


def _straight(pose: AgentFrame, turn_rad: float) -> Floats:
    """(P, 2) a way that turns within a step or two, then goes straight on."""
    first = pose.position_m
    bend = _TURN_M if 0.0 < abs(turn_rad) < np.pi / 2 and pose.speed_mps > 0.0 else 0.0
    middle = first + bend * frames.unit(np.array(pose.heading_rad + turn_rad / 2))
    end = middle + frames.unit(np.array(pose.heading_rad + turn_rad))
    return np.array([first, end]) if bend == 0.0 else np.array([first, middle, end])


_TURNED_M: Final = 4.0
"""Length of a rider's turn to another course."""


def _ridden(road: RoadMap, pose: AgentFrame, z_m: float) -> Iterator[_Way]:
    """Ways of a cyclist: along its lane and those that it leads to, on, and to both sides."""
    lanes = _ahead(road, pose, z_m)
    for points in lanes:
        yield _Way(points, 0.6 / len(lanes))
    for degrees, share in _RIDING_ON.items():
        yield _Way(_bent(pose, np.radians(degrees)), share)


def _bent(pose: AgentFrame, turn_rad: float) -> Floats:
    """(P, 2) a way that turns over some metres."""
    share = np.linspace(0.0, 1.0, 9)
    heading = pose.heading_rad + turn_rad * (share[:-1] + share[1] / 2)
    steps = frames.unit(heading) * _TURNED_M * share[1]
    points = pose.position_m + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.concatenate([points, points[-1:] + frames.unit(pose.heading_rad + turn_rad)])


def _ahead(road: RoadMap, pose: AgentFrame, z_m: float) -> list[Floats]:
    """(P, 2) each: along the lane under the rider, or beside it, and on to where it leads."""
    lanes = all_lanes(road)
    feet = _near(road, lanes, pose, _LANE_M, z_m)
    away = np.hypot(*feet.away_m.T)
    x, y = lanes.vector_m[feet.segment].T
    along = np.cos(np.arctan2(y, x) - pose.heading_rad) > _ALONG
    away = np.where(along & (away < _LANE_M), away, np.inf)
    if not np.isfinite(away).any():
        return []
    own = lanes.lanes[lanes.lane[feet.segment[int(away.argmin())]]]
    begins_m = float(polylines.project(own.centre_m, pose.position_m).along_m)
    ways = _led_on(road, own, begins_m + _REACH_M)
    return [_beside(points, pose) for points in ways][:_BRANCHES]


def _near(road: RoadMap, lanes: LaneMap, pose: AgentFrame, reach_m: float, z_m: float) -> Feet:
    """Feet of the person on lanes around it, on its level."""
    feet = lanes.feet(pose.position_m[None], reach_m)
    if not ground_of(road).has_levels:
        return feet
    return feet.among(~clear(lanes.heights_m(feet), np.array(z_m)))


_REACH_M: Final = 8.5 * FUTURE_STEPS * DT_S
"""A rider gets no farther."""


def _led_on(road: RoadMap, lane: Lane, reach_m: float) -> Iterator[Floats]:
    """(P, 2) each: the lane and the lanes that follow, up to a distance from its beginning."""
    open_ways: list[tuple[str, Floats]] = [(lane.id, lane.centre_m)]
    while open_ways:
        last, points = open_ways.pop(0)
        after = [road.lanes[name] for name in road.lanes[last].next if name in road.lanes]
        after = [one for one in after if len(one.centre_m) > 1]
        if not after or polylines.arc_lengths(points)[-1] > reach_m:
            yield points
        else:
            open_ways += [(one.id, np.concatenate([points, one.centre_m])) for one in after]
            open_ways = open_ways[: 2 * _BRANCHES]


def _beside(points_m: Floats, pose: AgentFrame) -> Floats:
    """(P, 2) the part of a line ahead of the rider, as far to the side as it is now."""
    line = polylines.Measured(points_m)
    foot = polylines.project(points_m, pose.position_m)
    end = float(line.along_m[-1])
    along = np.arange(float(foot.along_m), max(end, float(foot.along_m) + 2.0), 1.0)
    where, heading = line.at(along)
    return where + float(foot.left_m) * frames.unit(heading + np.pi / 2)
