"""What a search has spent of its budget."""

import time

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Budget, Rollout
from deepmf_sumo.policies.base import Policy

_ONE_ATTACK = 2  # simulations: scouting, and the attack


class Spending:
    """Counts simulations and wall time from its making on.

    Attributes:
        simulations: begun so far. out_of_time: the budget's seconds ended something.

    Args:
        simulate: one episode.
        budget: what may be spent.
        simulations: what may be spent where the budget says nothing at all.
    """

    def __init__(self, simulate: Simulate, budget: Budget, simulations: int) -> None:
        self._simulate = simulate
        unlimited = budget.simulations is None and budget.seconds is None
        self._most = simulations if unlimited else budget.simulations
        self._most_s = budget.seconds
        self._begin = time.perf_counter()
        self._decided_s: float | None = None
        self.simulations = 0
        self.out_of_time = False

    def simulate(self, policy: Policy | None) -> Rollout:
        """One episode, counted."""
        if self.simulations == 1 and self._most is not None and self._most <= _ONE_ATTACK:
            self._decided_s = self.seconds
        self.simulations += 1
        return self._simulate(policy)

    def unattacked(self) -> Rollout:
        """The episode of a case with nobody to attack, counted: nothing depends on it."""
        self._decided_s = self.seconds
        self.simulations += 1
        return self._simulate(None)

    @property
    def over(self) -> bool:
        """Whether no simulation may be begun any more."""
        if self._most is not None and self.simulations >= self._most:
            return True
        self.look_at_the_clock()
        return self.out_of_time

    def look_at_the_clock(self) -> None:
        """Note in ``out_of_time`` whether the seconds are spent."""
        if self._most_s is not None and self.seconds >= self._most_s:
            self.out_of_time = True

    @property
    def generation_s(self) -> float:
        """Wall time until the attack was known.

        Every episode that something depends on is part of it: what is aimed at, scored, compared,
        or looked at for whether to go on. Nothing depends on `unattacked`, nor on the only attack
        that a budget of two simulations allows.
        """
        return self.seconds if self._decided_s is None else self._decided_s

    @property
    def seconds(self) -> float:
        """Wall time since the beginning."""
        return time.perf_counter() - self._begin
