"""Episodes of an adversary: the unattacked one, budgets, fixed plans, choice of the opponent."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import Field

from deepmf_sumo import plugins
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.deepmf.networks.opponent import Opponent
from deepmf_sumo.deepmf.opponent import SCORED, choose_opponent
from deepmf_sumo.deepmf.settings import LIMITS
from deepmf_sumo.deepmf.tracking import Tracked
from deepmf_sumo.scene import AgentId, Bools, Budget, Case, Floats, Plan, Rollout, View, frozen
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import distance_m
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.scene.road_users import MotionLimits

_FAR_M = 100.0
"""Distance to an AV or an opponent that had left before the first step."""

Choose = Callable[[View, np.random.Generator], AgentId | None]
"""Chooses the attacking vehicle from the View at the current step; None if there is none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AgentMotion:
    """Motion of one agent in the K steps after now.

    Attributes:
        position_m: (K, 2) box centre. heading_rad, speed_mps: (K).
        valid: (K) False where the agent is absent (or the episode has ended).
    """

    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    valid: Bools

    def __post_init__(self) -> None:
        for name in ("position_m", "heading_rad", "speed_mps"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "valid", frozen(self.valid, bool))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scouted:
    """The unattacked episode.

    Attributes:
        view: at the current step, as policies get it.
        rollout: of the whole episode; its ``opponent_id`` is None.
        opponent_id: the vehicle that will attack.
        reference: motion of the opponent after now, K = the case's duration: that of the log, or of
            SUMO's traffic.
        av: motion of the AV after now.
    """

    view: View
    rollout: Rollout
    opponent_id: AgentId
    reference: AgentMotion
    av: AgentMotion


class Scout:
    """The policy of the unattacked episode: chooses an opponent, but does not drive it.

    The choice is not reported as the opponent, since the episode would end at its first contact
    with the AV.
    """

    KEPT: tuple[str, ...] = ("view", "chosen")
    period_steps: int | None = None

    def __init__(self, choose: Choose) -> None:
        self._choose = choose
        self.view: View | None = None
        self.chosen: AgentId | None = None

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """Keep the view and choose."""
        self.view, self.chosen = view, self._choose(view, rng)
        return ()

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """Drive no vehicle."""
        return {}


def scout(case: Case, simulate: Simulate, choose: Choose) -> Scouted | None:
    """Simulate once without an attack; None if no vehicle can attack.

    Counts as one simulation. ``choose`` gets the random numbers that policies get, so that it draws
    the same opponent as DeepMF.
    """
    policy = Scout(choose)
    rollout = simulate(policy)
    if policy.view is None or policy.chosen is None:
        return None
    return Scouted(
        view=policy.view,
        rollout=rollout,
        opponent_id=policy.chosen,
        reference=motion_of(rollout, policy.chosen, case.duration_steps),
        av=motion_of(rollout, rollout.av_id, case.duration_steps),
    )


def motion_of(rollout: Rollout, agent_id: AgentId, steps: int) -> AgentMotion:
    """Motion of an agent in the ``steps`` after now; not valid after the end of the rollout."""
    tracks = rollout.tracks
    row, first = tracks.row(agent_id), rollout.now + 1
    after = slice(first, first + steps)
    missing = steps - tracks.valid[row, after].size
    return AgentMotion(
        position_m=np.pad(tracks.position_m[row, after], [(0, missing), (0, 0)]),
        heading_rad=np.pad(tracks.heading_rad[row, after], (0, missing)),
        speed_mps=np.pad(tracks.speed_mps[row, after], (0, missing)),
        valid=np.pad(tracks.valid[row, after], (0, missing)),
    )


def limited(budget: Budget, simulations: int, seconds: float | None = None) -> Budget:
    """The budget with an adversary's defaults.

    Args:
        budget: as given.
        simulations: limit if the budget has no limit at all.
        seconds: limit if the budget has none for the time; None: no limit.
    """
    unlimited = budget.simulations is None and budget.seconds is None
    return Budget(
        simulations=simulations if unlimited else budget.simulations,
        seconds=seconds if budget.seconds is None else budget.seconds,
    )


def deadline(budget: Budget) -> float:
    """End of the budget's seconds from now on, as `time.perf_counter`; inf without a limit."""
    return math.inf if budget.seconds is None else time.perf_counter() + budget.seconds


_ONE_ATTACK = 2  # simulations: the unattacked one, and the attack


class BudgetMeter:
    """Counts simulations, and wall time since it was created.

    Attributes:
        simulations: started so far. out_of_time: the time limit ended something.

    Args:
        simulate: one episode.
        budget: the limits.
        simulations: limit if the budget has no limit at all.
    """

    def __init__(self, simulate: Simulate, budget: Budget, simulations: int) -> None:
        self._simulate = simulate
        self._budget = limited(budget, simulations)
        self._begin = time.perf_counter()
        self._decided_s: float | None = None
        self.simulations = 0
        self.out_of_time = False

    def simulate(self, policy: Policy | None) -> Rollout:
        """One episode, counted."""
        most = self._budget.simulations
        if self.simulations == 1 and most is not None and most <= _ONE_ATTACK:
            self._decided_s = self.seconds
        self.simulations += 1
        return self._simulate(policy)

    def unattacked(self) -> Rollout:
        """One episode without an attack, counted; for cases in which no vehicle can attack."""
        self._decided_s = self.seconds
        self.simulations += 1
        return self._simulate(None)

    @property
    def over(self) -> bool:
        """Whether the budget allows no further simulation."""
        most = self._budget.simulations
        if most is not None and self.simulations >= most:
            return True
        self.check_time()
        return self.out_of_time

    def check_time(self) -> None:
        """Set ``out_of_time`` if the time limit is reached."""
        if self._budget.seconds is not None and self.seconds >= self._budget.seconds:
            self.out_of_time = True

    @property
    def generation_s(self) -> float:
        """Wall time until the attack was decided.

        Includes every simulation whose result influenced the attack: it was aimed at, scored,
        compared, or decided whether to continue. `unattacked` has no influence, nor has the only
        attack that a budget of two simulations allows.
        """
        return self.seconds if self._decided_s is None else self._decided_s

    @property
    def seconds(self) -> float:
        """Wall time since the start."""
        return time.perf_counter() - self._begin


class Trajectories(NamedTuple):
    """M trajectories of one vehicle: (M, K, 2) box centres, (M, K) headings, (M, K) speeds."""

    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats


def plan_of(view: View, agent_id: AgentId, driven: Trajectories | Tracked, row: int) -> Plan:
    """One of the trajectories as a plan from the next step on."""
    return Plan(
        agent_id=agent_id,
        first_step=view.step + 1,
        position_m=driven.position_m[row],
        heading_rad=driven.heading_rad[row],
        speed_mps=driven.speed_mps[row],
    )


class Planned:
    """The opponent drives a plan and does not react to the AV."""

    period_steps: int | None = None

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """Report the plan's agent."""
        return (self._plan.agent_id,)

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """The plan."""
        return {self._plan.agent_id: self._plan}


class OpponentSettings(plugins.Settings):
    """Settings of all adversaries that choose a vehicle.

    Attributes:
        opponent: ``argmax`` or ``sample`` (softmax) of the scores of the opponent network;
            ``partner``: argmax of its head trained on labelled partners; ``labelled``: the partner
            that the recording names; else the id of a vehicle.
    """

    opponent: str = Field(default="argmax", min_length=1)


class LimitedSettings(OpponentSettings):
    """Settings of adversaries that choose a vehicle and drive it within limits, DeepMF's.

    Attributes:
        accel_mps2, brake_mps2, lateral_mps2: largest accelerations of the opponent.
    """

    accel_mps2: float = Field(default=LIMITS.accel, gt=0.0)
    brake_mps2: float = Field(default=LIMITS.brake, gt=0.0)
    lateral_mps2: float = Field(default=LIMITS.lateral, gt=0.0)

    @property
    def limits(self) -> MotionLimits:
        """Limits of what the opponent drives."""
        return MotionLimits(accel=self.accel_mps2, brake=self.brake_mps2, lateral=self.lateral_mps2)


class OpponentChoice:
    """Chooses opponents; the network is loaded for the first case that needs it, and kept.

    Args:
        how: the setting ``opponent``.
        weights: name or folder, as `deepmf.networks.weights.load` takes it.
    """

    def __init__(self, how: str, weights: str) -> None:
        self._how = how
        self._weights = weights
        self._predictor: Opponent | None = None

    def load(self) -> None:
        """Load the network if it is needed, which takes a while."""
        if self._predictor is None and self._how in SCORED:
            # Imports torch, which a check of a spec's settings must not do.
            from deepmf_sumo.deepmf.networks.weights import cached_predictors

            self._predictor = cached_predictors(self._weights).opponent

    def of(self, case: Case) -> Choose:
        """The choice in a case."""
        self.load()

        def choose(view: View, rng: np.random.Generator) -> AgentId | None:
            return choose_opponent(view, self._how, self._predictor, case.partner_id, rng)[0]

        return choose


def nearest_m(rollout: Rollout) -> float:
    """Smallest distance between the boxes of AV and opponent after now, metres; 0 at a contact.

    100 m if one of them had left before the first step.
    """
    if rollout.first("av_opponent") is not None:
        return 0.0
    gaps = gaps_m(rollout, rollout)
    return float(gaps.min()) if len(gaps) else _FAR_M


def gaps_m(rollout: Rollout, other: Rollout) -> Floats:
    """Distances of the opponent from the AV of ``other``, at the steps after now that have both."""
    last = min(rollout.tracks.steps, other.tracks.steps)
    names = (rollout, str(rollout.opponent_id)), (other, other.av_id)
    sides = [(one.tracks, one.tracks.row(name), slice(one.now + 1, last)) for one, name in names]
    both = np.logical_and(*(tracks.valid[row, after] for tracks, row, after in sides))
    poses = [
        (tracks.position_m[row, after][both], tracks.heading_rad[row, after][both],
         tracks.size_m[row, :2])
        for tracks, row, after in sides
    ]  # fmt: skip
    heights = (tracks.z_m[row, after][both] for tracks, row, after in sides)
    return distance_m(boxes.gap(*poses[0], *poses[1]), *heights)
