"""One episode in which nobody attacks: what a search knows before it begins."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import AgentId, Bools, Case, Floats, Rollout, View, frozen

Choose = Callable[[View, np.random.Generator], AgentId | None]
"""The vehicle to attack, from the View at the current step; None if there is none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """What one agent does in the K steps after now.

    Attributes:
        position_m: (K, 2) box centre. heading_rad, speed_mps: (K).
        valid: (K) False where the agent is not there (or the episode has ended).
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
    """What happens if nobody attacks.

    Attributes:
        view: at the current step, as policies get it.
        rollout: of the whole episode; its ``opponent_id`` is None.
        opponent_id: the vehicle to attack.
        reference: what the opponent does after now, K = the case's duration: the log's motion, or
            that of SUMO's traffic.
        av: what the AV does after now.
    """

    view: View
    rollout: Rollout
    opponent_id: AgentId
    reference: Motion
    av: Motion


class Scout:
    """The policy of the scouting episode: looks around, chooses, and attacks nobody.

    The chosen one is not reported as the opponent, for the episode would end at its first contact
    with the AV.
    """

    period_steps: int | None = None

    def __init__(self, choose: Choose) -> None:
        self._choose = choose
        self.view: View | None = None
        self.chosen: AgentId | None = None

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """Keep the view and choose."""
        self.view, self.chosen = view, self._choose(view, rng)
        return None

    def plan(self, view: View) -> None:
        """Nobody is driven."""


def scout(case: Case, simulate: Simulate, choose: Choose) -> Scouted | None:
    """Simulate once without an attack; None if there is nobody to attack.

    Counts as one simulation. ``choose`` gets the random numbers that policies get, so that an
    opponent that is drawn is the one that DeepMF draws.
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


def motion_of(rollout: Rollout, agent_id: AgentId, steps: int) -> Motion:
    """What an agent did in the ``steps`` after now; not valid after the end of the rollout."""
    tracks = rollout.tracks
    row, first = tracks.row(agent_id), rollout.now + 1
    after = slice(first, first + steps)
    missing = steps - tracks.valid[row, after].size
    return Motion(
        position_m=np.pad(tracks.position_m[row, after], [(0, missing), (0, 0)]),
        heading_rad=np.pad(tracks.heading_rad[row, after], (0, missing)),
        speed_mps=np.pad(tracks.speed_mps[row, after], (0, missing)),
        valid=np.pad(tracks.valid[row, after], (0, missing)),
    )
