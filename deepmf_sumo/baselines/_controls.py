"""Controls of an opponent as knots, and the bicycle model that drives them.

The kinematic bicycle is fitted to the opponent's unattacked motion and driven with other controls.
The parameters are those of AdvSim (Wang et al., CVPR 2021): changes of acceleration and curvature
over time, added to those of the reference. The reference's curvature is a function of the distance
along its path, not of time: a vehicle that brakes before a bend takes the bend later.

Four single tracks are four models on purpose. `deepmf.tracking` follows a path with its centre and
trails the rear axle; here the rear axle is steered, and limits depend on the distance driven, so
that steps follow one another; `baselines._king_descent` integrates the same arcs all together,
differentiably, every 0.2 s; the network of `baselines.priors.bicycle` was trained with the centre
as its axle. What they share, axle and full lock, are those of `scene.road_users`.
"""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.attacks._episodes import AgentMotion, Scouted, Trajectories
from deepmf_sumo.deepmf.networks.lanes import path_set, road_index
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import DT_S, Floats, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.road_users import MotionLimits

_NODE_M = 0.5
_APART_M = 1.0  # closer points of a recording show its noise rather than the path
_SMOOTH_NODES = 9
_SMOOTH_STEPS = 5
_TURN_IN_M = 5.0  # over which the initial heading fades into that of the path


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Bounds of the controls.

    Attributes:
        total: of the acceleration and of speed times turn rate.
        accel_mps2: largest change of the acceleration, up or down.
        curvature_per_m: largest change of the curvature.
        lateral_mps2: largest change of the lateral acceleration, which limits that of the curvature
            at high speed.
        fastest_mps: largest speed.
    """

    total: MotionLimits
    accel_mps2: float
    curvature_per_m: float
    lateral_mps2: float
    fastest_mps: float = 30.0


class Bicycle:
    """The opponent as a bicycle that drives the reference and continues it.

    It starts from the present state. After the end of the reference it continues at the last speed,
    along the lane of the last pose, else straight on. The same holds for the path of a faster
    vehicle beyond the reference's end, and for that of a stationary vehicle.
    """

    def __init__(self, scouted: Scouted, bounds: Bounds) -> None:
        self._start = Start.of(scouted.view, scouted.opponent_id)
        self._rear_m = self._start.rear_m
        self._sharpest_per_m = np.tan(self._start.motion.slip_rad) / self._rear_m
        self._bounds = bounds
        self._accel = _accelerations(scouted.reference, self._start.speed_mps)
        self._turned = self._turns(scouted.reference, scouted.view.road)

    @property
    def steps(self) -> int:
        """Steps of a trajectory, K."""
        return len(self._accel)

    def drive(self, accel: Floats, steer: Floats) -> Trajectories:
        """Trajectories under changes of the controls.

        Args:
            accel: (B, K) and
            steer: (B, K) in [-1, 1], in units of the bounds; left is positive.
        """
        bounds, start = self._bounds, self._start
        rows, steps = accel.shape
        wanted = self._accel + bounds.accel_mps2 * accel
        wanted = np.clip(wanted, -bounds.total.brake, bounds.total.accel) * DT_S
        speed, along = np.full(rows, start.speed_mps), np.zeros(rows)
        heading = np.full(rows, start.heading_rad)
        centre = np.full(rows, complex(*start.position_m))
        rear = centre - self._rear_m * np.exp(1j * heading)
        places, headings = np.empty((rows, steps), complex), np.empty((rows, steps))
        speeds = np.empty((rows, steps))
        for step in range(steps):
            after = np.clip(speed + wanted[:, step], 0.0, bounds.fastest_mps)
            way = (speed + after) / 2 * DT_S
            turn = self._turn(along, way, np.maximum(speed, after), steer[:, step])
            rear = rear + way * np.exp(1j * (heading + turn / 2))
            heading, along, speed = heading + turn, along + way, after
            places[:, step] = rear + self._rear_m * np.exp(1j * heading)
            headings[:, step], speeds[:, step] = heading, speed
        return Trajectories(
            position_m=np.stack([places.real, places.imag], -1),
            heading_rad=frames.wrap(headings),
            speed_mps=speeds,
        )

    def _turn(self, along: Floats, way: Floats, fastest: Floats, steer: Floats) -> Floats:
        """(B) change of heading over a step, within the limits."""
        bounds, square = self._bounds, np.maximum(fastest**2, 1e-6)
        change = np.minimum(bounds.curvature_per_m, bounds.lateral_mps2 / square)
        turn = self._turned_by(along + way) - self._turned_by(along) + steer * change * way
        sharpest = np.minimum(self._sharpest_per_m, bounds.total.lateral / square)
        clipped: Floats = np.clip(turn, -sharpest * way, sharpest * way)
        return clipped

    def _turned_by(self, along: Floats) -> Floats:
        """(B) heading of the reference's path at arc lengths; constant past its end."""
        place = np.minimum(along / _NODE_M, len(self._turned) - 1.001)
        node = place.astype(int)
        share = place - node
        turned: Floats = (1 - share) * self._turned[node] + share * self._turned[node + 1]
        return turned

    def _turns(self, reference: AgentMotion, road: RoadMap) -> Floats:
        """(N) heading of the rear axle's path every 0.5 m, from the heading now on."""
        start = self._start
        rear = start.position_m - self._rear_m * frames.unit(start.heading_rad)
        there = reference.valid
        heading = reference.heading_rad[there]
        driven = reference.position_m[there] - self._rear_m * frames.unit(heading)
        path = _spaced(np.concatenate([rear[None], driven]))
        end = heading[-1] if len(path) > 1 else start.heading_rad
        path = np.concatenate([path, _onwards(road, path[-1], float(end), start.speed_mps)])
        length = polylines.arc_lengths(path)[-1]
        _, course = polylines.points_at(path, np.arange(0.0, length, _NODE_M))
        course = _smoothed(np.unwrap(course), _SMOOTH_NODES)
        off = float(frames.difference(start.heading_rad, course[0]))
        turned: Floats = course + off * np.exp(-np.arange(len(course)) * _NODE_M / _TURN_IN_M)
        return turned


def _accelerations(reference: AgentMotion, speed_mps: float) -> Floats:
    """(K) accelerations of the reference, from the present speed on; 0 after its end."""
    steps = np.arange(len(reference.valid) + 1)
    known = np.concatenate([[True], reference.valid])
    speeds = np.concatenate([[speed_mps], reference.speed_mps])
    smooth = _smoothed(np.interp(steps, steps[known], speeds[known]), _SMOOTH_STEPS)
    accel: Floats = np.diff(smooth) / DT_S
    return accel


def _smoothed(values: Floats, width: int) -> Floats:
    """Moving average that keeps the first value: the window shrinks towards both ends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    here = np.arange(len(values))
    reach = np.minimum(np.minimum(here, len(values) - 1 - here), width // 2)
    mean: Floats = (total[here + reach + 1] - total[here - reach]) / (2 * reach + 1)
    return mean


def _spaced(points_m: Floats) -> Floats:
    """(P, 2) points at least a metre apart."""
    kept = [0]
    for row in range(1, len(points_m)):
        if np.hypot(*(points_m[row] - points_m[kept[-1]])) >= _APART_M:
            kept.append(row)
    spaced: Floats = points_m[kept]
    return spaced


def _onwards(road: RoadMap, place_m: Floats, heading_rad: float, speed_mps: float) -> Floats:
    """(P, 2) continuation of a path from a pose: along the likeliest lane, else straight."""
    paths = path_set(road_index(road), place_m, heading_rad, speed_mps, {})
    first = paths.points_m[int(paths.valid.argmax()), 1:]
    return frames.to_scene(first, place_m, heading_rad)


class Knots:
    """Changes of acceleration and steering at equal intervals of time, smooth in between.

    Between two knots a change follows half a cosine, so that it never exceeds them.

    Args:
        count: knots of each control, at 0 s, ..., at the last step.
        steps: K, of the trajectory.
    """

    def __init__(self, count: int, steps: int) -> None:
        self.names = tuple(
            f"{control}_{knot}" for control in ("accel", "steer") for knot in range(count)
        )
        place = np.linspace(0.0, count - 1.0, steps)
        knot = np.minimum(place.astype(int), count - 2)
        share = (1 - np.cos(np.pi * (place - knot))) / 2
        self._weight = np.zeros((count, steps))
        self._weight[knot, np.arange(steps)] = 1 - share
        self._weight[knot + 1, np.arange(steps)] = share

    @property
    def dimensions(self) -> int:
        """D: two controls at each knot."""
        return len(self.names)

    def controls(self, points: Floats) -> tuple[Floats, Floats]:
        """Changes of acceleration and steering, (B, K) each, of points (B, D) in [-1, 1]."""
        halves = np.asarray(points, float).reshape(len(points), 2, -1) @ self._weight
        return halves[:, 0], halves[:, 1]
