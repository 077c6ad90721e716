"""What happened in one simulated episode, what was measured of it, and what a search found."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Literal

import numpy as np

from deepmf_sumo.scene._arrays import Bytes, Floats, Frozen
from deepmf_sumo.scene.plan import Plan, Turn
from deepmf_sumo.scene.scene import HISTORY_STEPS, AgentId, SignalState, Tracks

ContactKind = Literal["av_opponent", "av_other", "opponent_other", "supporter_other"]
Role = Literal["av", "opponent", "attacker", "supporter", "other"]
"""``attacker``: one that attacks together with the opponent, the decisive attacker;
``supporter``: it takes ways out from the AV and shall touch nobody."""


class Driver(IntEnum):
    """What drove an agent at a step."""

    NOBODY = 0
    PLANNER = 1
    POLICY = 2
    LOG = 3
    SUMO = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contact(Frozen):
    """Two boxes overlap that did not before, or were apart since.

    An overlap at the start, of a road user that appears, or in the step of a hand-over is none.

    Attributes:
        kind: by the roles of the two; ``opponent_other`` also of two that attack together;
            ``supporter_other``: of a supporter with anybody but AV and attackers.
        first_id: the AV, or the opponent if the AV is not involved, or the supporter if neither is.
        second_id: the other.
        striker_id: the vehicle that moved faster towards the other's box.
        pose_first, pose_second: (3) x, y, heading at the contact.
        relative_mps: length of the velocity difference at the last step before the contact.
        closing_mps: speed at which the centres approached.
        sector: impact sector on the first agent, eight of 45 degrees counted counter-clockwise;
            front = 0, left = 2, rear = 4, right = 6.
        delta_v_mps: change of the first agent's velocity in a plastic impact of masses
            proportional to the boxes' areas.
    """

    kind: ContactKind
    step: int
    first_id: AgentId
    second_id: AgentId
    striker_id: AgentId
    pose_first: Floats
    pose_second: Floats
    relative_mps: float
    closing_mps: float
    sector: int
    delta_v_mps: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """An occurrence that qualifies the result, e.g. ``lane_lost``, ``arrived``."""

    step: int
    agent_id: AgentId
    kind: str
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rollout(Frozen):
    """One episode.

    Attributes:
        tracks: (A, T) from the first history step to the last simulated one.
        driver: (A, T) Driver numbers.
        now: index of the current step, at which the simulation took over.
        attackers: the vehicles that attacked together, the decisive one first (of opponents in
            turn those of the decisive turn); empty if none could attack.
        ended: ``contact`` (AV and opponent), ``time``, ``av_gone``; of a turn `Turn.ended`.
        seconds: wall time by part (``simulation``, ``policy``, ``planner``).
        leaders: for each simulated step the vehicles that the AV's planner named, or that SUMO's
            model followed on its lanes; None if neither applies (poses, plain speeds).
        signals: for each simulated step the signals before it, by lane id.
        turns: the attack of each vehicle, where several attacked together or the case asks for
            opponents in turn; else empty.
    """

    tracks: Tracks
    driver: Bytes
    now: int
    dt_s: float
    av_id: AgentId
    attackers: tuple[AgentId, ...]
    contacts: tuple[Contact, ...]
    events: tuple[Event, ...]
    plans: tuple[Plan, ...]
    ended: str
    seconds: dict[str, float] = field(default_factory=dict)
    leaders: tuple[tuple[AgentId, ...] | None, ...] = ()
    signals: tuple[dict[str, SignalState], ...] = ()
    turns: tuple[Turn, ...] = ()

    @property
    def opponent_id(self) -> AgentId | None:
        """The decisive attacker, which metrics are of; None if no vehicle could attack."""
        return next(iter(self.attackers), None)

    @property
    def supporters(self) -> tuple[AgentId, ...]:
        """The road users that supported the attackers, in the order of their first plans."""
        plans = (plan for plan in self.plans if plan.supports in self.attackers)
        return tuple(dict.fromkeys(plan.agent_id for plan in plans))

    @property
    def roles(self) -> dict[AgentId, Role]:
        """Of AV, attackers and supporters; all other agents are ``other``."""
        found: dict[AgentId, Role] = dict.fromkeys(self.supporters, "supporter")
        found |= dict.fromkeys(self.attackers, "attacker")
        if self.opponent_id is not None:
            found[self.opponent_id] = "opponent"
        return {**found, self.av_id: "av"}

    def first(self, kind: str) -> Contact | None:
        """First contact of a kind."""
        return next((contact for contact in self.contacts if contact.kind == kind), None)

    def plans_of(self, agent: AgentId) -> tuple[Plan, ...]:
        """The plans that an agent followed."""
        return tuple(plan for plan in self.plans if plan.agent_id == agent)

    @property
    def outcome(self) -> str:
        """``av_opponent`` if the attack hit, else the earliest other contact, else ``none``."""
        if self.first("av_opponent"):
            return "av_opponent"
        others = sorted(self.contacts, key=lambda contact: contact.step)
        return others[0].kind if others else "none"

    def of_turn(self, turn: Turn) -> "Rollout":
        """One turn as a rollout of its own, with one attacker; steps keep their numbers.

        Its agents are those observed in the turn or in the second before it. Vehicles that attack
        together with this one are other road users.
        """
        attacker = turn.opponent_id
        ours = [one for one in self.plans if attacker in (one.agent_id, one.supports)]
        stop = turn.last_step + 1
        seen = self.tracks.valid[:, max(0, turn.first_step + 1 - HISTORY_STEPS) : stop].any(axis=1)
        rows = np.flatnonzero(seen).tolist()
        simulated = slice(turn.first_step - self.now, turn.last_step - self.now)
        steps = range(turn.first_step + 1, stop)
        return replace(
            self,
            tracks=self.tracks.window(0, stop).select(rows),
            driver=self.driver[rows, :stop],
            now=turn.first_step,
            attackers=(attacker,),
            contacts=tuple(one for one in self._contacts_of(attacker) if one.step in steps),
            events=tuple(event for event in self.events if event.step in steps),
            plans=tuple(one for one in ours if one.first_step in steps),
            ended=turn.ended,
            leaders=self.leaders[simulated],
            signals=self.signals[simulated],
            turns=(turn,),
        )

    def _contacts_of(self, attacker: AgentId) -> Iterator[Contact]:
        """The contacts as if this attacker were the only one."""
        for one in self.contacts:
            its_own = attacker in (one.first_id, one.second_id)
            if one.kind == "av_opponent" and not its_own:
                yield replace(one, kind="av_other")
            elif one.kind == "supporter_other":
                if self._supports(one.first_id, attacker):
                    yield one
            elif one.kind != "opponent_other" or its_own:
                yield one

    def _supports(self, agent: AgentId, attacker: AgentId) -> bool:
        return any(plan.supports == attacker for plan in self.plans_of(agent))


def decisive(turns: Sequence[Turn]) -> Turn | None:
    """The first turn with a contact, else the one with the smallest gap; None if there is none."""
    hits = [turn for turn in turns if turn.ended == "contact"]
    return next(iter(hits), None) or min(turns, key=lambda turn: turn.gap_m, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricValue:
    """``value`` is None, with a ``reason``, if the metric is not defined for the rollout."""

    name: str
    value: float | None
    unit: str
    better: Literal["lower", "higher", "neither"]
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """Limits of an adversary's search; the first one reached ends it; None is no limit."""

    simulations: int | None = None
    seconds: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One attack of a search.

    Attributes:
        values: by name, what the search varied, and what it found (``hit``, ``solvable``, ...: 1 or
            0). objective: higher is worse for the AV.
    """

    values: dict[str, float]
    objective: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attack:
    """The best rollout of a search, and all its trials.

    ``out_of_time``: the budget's seconds ended the search, so it depends on the machine's speed.
    """

    rollout: Rollout
    trials: tuple[Trial, ...] = ()
    simulations: int = 1
    generation_s: float = 0.0
    out_of_time: bool = False
