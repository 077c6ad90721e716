"""Black-box search over an opponent's controls: propose, simulate, evaluate the cost, repeat.

The three searches `brs`, `bga` and `bbo` differ only in their `Optimiser`.

The cost penalises attacks that miss, leave the road, touch others, or jerk. It follows AdvSim (Wang
et al., CVPR 2021), with the distance to the AV instead of the planner's cost. Limits of speed,
acceleration and curvature need no term: the bicycle model keeps them. AdvSim keeps the AV's own
path free, so that the scenario has a solution: ``av_path``. It is off by default, since an AV that
replays its log could then not be hit.

Controls are knots over time. A kinematic bicycle is fitted to the opponent's unattacked motion and
driven with other controls. The parameters are those of AdvSim: changes of acceleration and
curvature over time, added to those of the reference. Its curvature is a function of the distance
along its path, not of time: a vehicle that brakes before a bend takes the bend later.

Four single tracks are four models on purpose. `deepmf.tracking` follows a path with its centre and
trails the rear axle; here the rear axle is steered, and limits depend on the distance driven, so
that steps follow one another; `baselines._king_descent` integrates the same arcs all together,
differentiably, every 0.2 s; the network of `baselines.priors.bicycle` was trained with the centre
as its axle. What they share, axle and full lock, are those of `scene.road_users`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydantic import Field

from deepmf_sumo import plugins
from deepmf_sumo.attacks._episodes import (
    AgentMotion,
    BudgetMeter,
    LimitedSettings,
    OpponentChoice,
    Planned,
    Scouted,
    Trajectories,
    gaps_m,
    nearest_m,
    plan_of,
    scout,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.deepmf.networks.lanes import path_set, road_index
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import (
    DT_S,
    FUTURE_STEPS,
    Attack,
    Budget,
    Case,
    Floats,
    RoadMap,
    Rollout,
    Trial,
)
from deepmf_sumo.scene.geometry import frames, polylines, road
from deepmf_sumo.scene.road_users import MotionLimits


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


_NODE_M = 0.5
_APART_M = 1.0  # closer points of a recording show its noise rather than the path
_SMOOTH_NODES = 9
_SMOOTH_STEPS = 5
_TURN_IN_M = 5.0  # over which the initial heading fades into that of the path


class Weights(plugins.Settings):
    """Weights of the terms, added in metres of distance to the AV.

    Attributes:
        late: of a contact after 8 s; an earlier one counts in proportion.
        off_road: of an opponent that is always off the road, else in proportion to the share.
        third_party: of a contact of the opponent with another agent.
        jerk: of a mean square of 1 (m/s3)^2.
        av_path: of an opponent that meets the AV's unattacked motion.
    """

    late: float = 0.1
    off_road: float = 1.0
    third_party: float = 1.0
    jerk: float = 0.01
    av_path: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """Terms of one rollout, weighted; ``distance`` is 0 at a contact."""

    distance: float
    late: float
    off_road: float
    third_party: float
    jerk: float
    av_path: float

    @property
    def total(self) -> float:
        """The cost to minimise."""
        plain = self.distance + self.late + self.off_road + self.third_party + self.jerk
        return plain + self.av_path


def cost_of(rollout: Rollout, case: Case, weights: Weights, unattacked: Rollout) -> Cost:
    """The cost of a simulated attack, up to the end of the episode or the contact."""
    tracks, first = rollout.tracks, rollout.now + 1
    opponent = tracks.row(str(rollout.opponent_id))
    there = tracks.valid[opponent, first:]
    path = tracks.position_m[opponent, first:][there]
    hit = rollout.first("av_opponent")
    late = 1.0 if hit is None else (hit.step - rollout.now) / FUTURE_STEPS
    heights = tracks.z_m[opponent, first:][there]
    off_road = 1 - road.on_road(case.road, path, heights).mean() if len(path) else 0.0
    return Cost(
        distance=nearest_m(rollout),
        late=weights.late * late,
        off_road=weights.off_road * float(off_road),
        third_party=weights.third_party * (rollout.first("opponent_other") is not None),
        jerk=weights.jerk * _mean_square_jerk(path),
        av_path=weights.av_path and weights.av_path * _meets(rollout, unattacked),
    )


def _meets(rollout: Rollout, unattacked: Rollout) -> bool:
    """Whether the opponent meets the AV where that was without the attack."""
    return bool((gaps_m(rollout, unattacked) <= 0.0).any())


def _mean_square_jerk(path_m: Floats) -> float:
    """Mean square of the third difference of a path (T, 2), (m/s3)^2; 0 for fewer than four."""
    if len(path_m) < 4:
        return 0.0
    jerk = np.diff(path_m, n=3, axis=0) / DT_S**3
    return float((jerk**2).sum(-1).mean())


TRIALS_FORESIGHT = (
    "the opponent's un-attacked motion, where the search begins, and the AV's answer to every trial"
)
"""What the searches know of a scene before their attack, for comparisons of methods."""


class Optimiser(Protocol):
    """Minimises an unknown function of points in [-1, 1]^D."""

    def ask(self) -> Floats:
        """(B, D) points to try next, B >= 1."""
        ...

    def tell(self, costs: Floats) -> None:
        """Pass on the costs (B) of the points asked for last."""
        ...


class SearchSettings(LimitedSettings):
    """Settings of the searches over a bicycle's controls.

    Attributes:
        simulations: limit if the budget has none, the unattacked episode included.
        knots: of acceleration and of curvature, from now to the end of the case.
        accel_change_mps2: largest change of the opponent's unattacked acceleration.
        curvature_change_per_m: largest change of its curvature.
        lateral_change_mps2: largest change of its lateral acceleration.
        cost: weights of the cost's terms.
        stop_at_contact: end the search with the first contact. By default it continues for a better
            one (on the road, smoother, earlier) within the budget: the times in the paper are
            proportional to whole budgets, and attacks become more natural.
    """

    simulations: int = Field(default=100, ge=2)
    knots: int = Field(default=5, ge=2, le=41)
    accel_change_mps2: float = Field(default=4.0, gt=0.0)
    curvature_change_per_m: float = Field(default=0.1, gt=0.0)
    lateral_change_mps2: float = Field(default=2.0, gt=0.0)
    accel_mps2: float = Field(default=5.0, gt=0.0)
    brake_mps2: float = Field(default=7.0, gt=0.0)
    lateral_mps2: float = Field(default=4.0, gt=0.0)
    cost: Weights = Weights()
    stop_at_contact: bool = False

    @property
    def bounds(self) -> Bounds:
        """Of the bicycle's controls."""
        return Bounds(
            total=self.limits,
            accel_mps2=self.accel_change_mps2,
            curvature_per_m=self.curvature_change_per_m,
            lateral_mps2=self.lateral_change_mps2,
        )


MakeOptimiser = Callable[[int, np.random.Generator], Optimiser]
"""Creates an optimiser for a number of dimensions."""


class Search:
    """An adversary that searches with an optimiser."""

    several = True

    def __init__(self, settings: SearchSettings, weights: str, make: MakeOptimiser) -> None:
        self._settings = settings
        self._choice = OpponentChoice(settings.opponent, weights)
        self._make = make

    def load(self) -> None:
        """Load the network that chooses opponents."""
        self._choice.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack with the smallest cost within the budget, among those that hit if any does.

        ``generation_s`` includes candidates, rollouts and the optimiser, but not loading weights;
        see `BudgetMeter.generation_s`. At least one attack is tried, whatever the budget, unless no
        vehicle can attack.
        """
        choose = self._choice.of(case)
        spending = BudgetMeter(simulate, budget, self._settings.simulations)
        scouted = scout(case, spending.simulate, choose)
        if scouted is None:
            rollout, trials = spending.unattacked(), []
        else:
            best = self._search(case, scouted, spending, rng)
            assert best.rollout is not None
            rollout, trials = best.rollout, best.trials
        return Attack(
            rollout=rollout,
            trials=tuple(trials),
            simulations=spending.simulations,
            generation_s=spending.generation_s,
            out_of_time=spending.out_of_time,
        )

    def _search(
        self, case: Case, scouted: Scouted, spending: BudgetMeter, rng: np.random.Generator
    ) -> "_Best":
        settings = self._settings
        bicycle = Bicycle(scouted, settings.bounds)
        knots = Knots(settings.knots, bicycle.steps)
        optimiser = self._make(knots.dimensions, rng)
        best = _Best(case, settings.cost, knots.names, scouted.rollout)
        of = scouted.view, scouted.opponent_id
        while True:
            points = optimiser.ask()
            driven = bicycle.drive(*knots.controls(points))
            costs = []
            for row, point in enumerate(points):
                costs.append(
                    best.judge(spending.simulate(Planned(plan_of(*of, driven, row))), point)
                )
                if spending.over or (settings.stop_at_contact and best.hits):
                    return best
            optimiser.tell(np.array(costs))


class _Best:
    """Evaluates rollouts and keeps the best one.

    A hit is better than any miss, whatever its cost: otherwise a near miss on the road could
    replace a hit that was found.
    """

    def __init__(
        self, case: Case, weights: Weights, names: tuple[str, ...], unattacked: Rollout
    ) -> None:
        self._case = case
        self._unattacked = unattacked
        self._weights = weights
        self._names = names
        self._rank = (True, np.inf)
        self.trials: list[Trial] = []
        self.rollout: Rollout | None = None

    @property
    def hits(self) -> bool:
        """Whether the best rollout hits the AV."""
        misses, _ = self._rank
        return not misses

    def judge(self, rollout: Rollout, point: Floats) -> float:
        """The cost of a rollout under a point."""
        cost = cost_of(rollout, self._case, self._weights, self._unattacked).total
        rank = (rollout.first("av_opponent") is None, cost)
        if rank < self._rank:
            self._rank, self.rollout = rank, rollout
        parameters = dict(zip(self._names, point.tolist(), strict=True))
        self.trials.append(Trial(values=parameters, objective=-cost))
        return cost
