"""Black-box search over an opponent's controls: propose, simulate, evaluate the cost, repeat.

The three searches `brs`, `bga` and `bbo` differ only in their `Optimiser`.

The cost penalises attacks that miss, leave the road, touch others, or jerk. It follows AdvSim (Wang
et al., CVPR 2021), with the distance to the AV instead of the planner's cost. Limits of speed,
acceleration and curvature need no term: the bicycle model keeps them. AdvSim keeps the AV's own
path free, so that the scenario has a solution: ``av_path``. It is off by default, since an AV that
replays its log could then not be hit.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydantic import Field

from deepmf_sumo import plugins
from deepmf_sumo.attacks._episodes import (
    LimitedSettings,
    OpponentChoice,
    Planned,
    Scouted,
    Spending,
    gaps_m,
    nearest_m,
    plan_of,
    scout,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.baselines._controls import Bicycle, Bounds, Knots
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Attack, Budget, Case, Floats, Rollout, Trial
from deepmf_sumo.scene.geometry import road


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
        see `Spending.generation_s`. At least one attack is tried, whatever the budget, unless no
        vehicle can attack.
        """
        choose = self._choice.of(case)
        spending = Spending(simulate, budget, self._settings.simulations)
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
        self, case: Case, scouted: Scouted, spending: Spending, rng: np.random.Generator
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
