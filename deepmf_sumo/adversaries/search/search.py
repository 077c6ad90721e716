"""A black-box search for an attack: propose controls, simulate, judge, again.

What the three searches share; they differ in the `Optimiser` alone.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from pydantic import Field

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.adversaries.search.bicycle import Bicycle, Bounds
from deepmf_sumo.adversaries.search.cost import Weights, cost_of
from deepmf_sumo.adversaries.search.knots import Knots
from deepmf_sumo.adversaries.search.opponents import OpponentChoice, OpponentSettings
from deepmf_sumo.adversaries.search.planned import Planned
from deepmf_sumo.adversaries.search.scouting import Scouted, scout
from deepmf_sumo.adversaries.search.spending import Spending
from deepmf_sumo.datatypes import Attack, Budget, Case, Floats, Rollout, Trial
from deepmf_sumo.policies.factorization.tracking import Limits

TRIALS_FORESIGHT = (
    "the opponent's un-attacked motion, where the search begins, and the AV's answer to every trial"
)
"""What the searches learn of a scene before their attack, for those who compare methods."""


class Optimiser(Protocol):
    """Minimises an unknown function of points in [-1, 1]^D."""

    def ask(self) -> Floats:
        """(B, D) points to try next, B >= 1."""
        ...

    def tell(self, costs: Floats) -> None:
        """The costs (B) of the points that were asked for last."""
        ...


class SearchSettings(OpponentSettings):
    """Settings of the searches over a bicycle's controls.

    Attributes:
        simulations: budget where none is given, the scouting episode included.
        knots: of acceleration and of curvature, from now to the end of the case.
        accel_change_mps2: largest change of the acceleration that the opponent has un-attacked.
        curvature_change_per_m: largest change of the curvature,
        lateral_change_mps2: and of the lateral acceleration.
        accel_mps2, brake_mps2, lateral_mps2: limits of what the opponent drives.
        cost: weights of the cost's terms.
        stop_at_contact: end the search with the first contact. By default it goes on for a better
            one (on the road, smoother, earlier) while the budget lasts: the times in the paper are
            in proportion to whole budgets, and attacks become more natural.
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
            total=Limits(accel=self.accel_mps2, brake=self.brake_mps2, lateral=self.lateral_mps2),
            accel_mps2=self.accel_change_mps2,
            curvature_per_m=self.curvature_change_per_m,
            lateral_mps2=self.lateral_change_mps2,
        )


MakeOptimiser = Callable[[int, np.random.Generator], Optimiser]
"""An optimiser of so many dimensions."""


class Search:
    """An adversary that searches with an optimiser."""

    def __init__(self, settings: SearchSettings, weights: str, make: MakeOptimiser) -> None:
        self._settings = settings
        self._choice = OpponentChoice(settings.opponent, weights)
        self._make = make

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack of least cost that the budget finds, among those that hit if any does.

        ``generation_s`` is everything but loading weights: candidates, rollouts, the optimiser; see
        `Spending.generation_s`. At least one attack is tried, whatever the budget; with nobody to
        attack none is.
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
        best = _Best(case, settings.cost, knots.names)
        while True:
            points = optimiser.ask()
            driven = bicycle.drive(*knots.controls(points))
            costs = []
            for row, point in enumerate(points):
                costs.append(best.judge(spending.simulate(Planned(driven.plan(row))), point))
                if spending.over or (settings.stop_at_contact and best.hits):
                    return best
            optimiser.tell(np.array(costs))


class _Best:
    """Judges rollouts and keeps the best one.

    One that hits is better than any that does not, whatever it costs: a cost that a near miss on
    the road can beat would count hits that were found as none.
    """

    def __init__(self, case: Case, weights: Weights, names: tuple[str, ...]) -> None:
        self._case = case
        self._weights = weights
        self._names = names
        self._rank = (True, np.inf)
        self.trials: list[Trial] = []
        self.rollout: Rollout | None = None

    @property
    def hits(self) -> bool:
        """Whether the best one hits the AV."""
        misses, _ = self._rank
        return not misses

    def judge(self, rollout: Rollout, point: Floats) -> float:
        """The cost of a rollout under a point."""
        cost = cost_of(rollout, self._case, self._weights).total
        rank = (rollout.first("av_opponent") is None, cost)
        if rank < self._rank:
            self._rank, self.rollout = rank, rollout
        parameters = dict(zip(self._names, point.tolist(), strict=True))
        self.trials.append(Trial(parameters=parameters, objective=-cost))
        return cost
