"""Attacks on one AV of a simulation that another program runs, step by step."""

import copy
import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.errors import RunError, UsageError
from deepmf_sumo.live.engagement import Engagement, LiveRoad, Scenery
from deepmf_sumo.live.observer import Sighting
from deepmf_sumo.live.triggers import AtTime, Trigger, TriggerView
from deepmf_sumo.scene import DT_S, HISTORY_STEPS, AgentId, Rollout
from deepmf_sumo.scene.policy import Policy

_ASK_EVERY: Final = 10
_WAKE_S: Final = 1.5
_SAME_S: Final = 1e-4
_MISSED_S: Final = 1.0
"""A script that is ahead by less has made steps of its own."""
_AGAIN_S: Final = 1.0
"""Until the next try to attack after one in which no vehicle could."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveAttack:
    """An attack that is over. ``begin_s``, ``end_s``: time of the simulation."""

    begin_s: float
    end_s: float
    rollout: Rollout


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch:
    """New attacks on an AV were turned on or off, at a time of the simulation.

    ``door``: ``HTTP``, ``signal`` or ``API``.
    """

    av: AgentId
    time_s: float
    on: bool
    door: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeJump:
    """SUMO's time went from one to another: its script has loaded a state."""

    from_s: float
    to_s: float


class Session:
    """Attacks on one AV; the caller calls `before_step` and `after_step` around each step.

    Args:
        scenery: the simulation, its AV, the rules and the pause between attacks.
        policy: chooses and drives the opponents.
        triggers: an attack begins when one of them fires.
        rng: for the policy.
        finished: called with each attack that is over.
        driven: whether the script that drives the AV is still connected. If it is not at the end
            of an attack, the attack counts in ``undriven`` alone: SUMO drove the AV in part of it.
        taken: vehicles that others drive now, which do not attack here.

    Attributes:
        attacks, undriven: numbers of attacks so far.
        last_failure: why the last try to attack failed.
        jumped: called with each jump of SUMO's time; may be replaced.
        switched: called with each change of `switch`; may be replaced.
        enough: whether no other attack may begin; may be replaced.

    Raises UsageError if 0.1 s is not a multiple of the simulation's step.
    """

    def __init__(
        self,
        scenery: Scenery,
        policy: Policy,
        triggers: Sequence[Trigger],
        rng: np.random.Generator,
        finished: Callable[[LiveAttack], None],
        driven: Callable[[], bool] = lambda: True,
        taken: Callable[[], Collection[AgentId]] = tuple,
    ) -> None:
        self.attacks = 0
        self.undriven = 0
        self.script_left = False
        self.av_seen = False
        self.av_present = False
        self.last_failure = ""
        self.switched: Callable[[Switch], None] = lambda _: None
        self.jumped: Callable[[TimeJump], None] = lambda _: None
        self._on = True
        self.enough: Callable[[], bool] = lambda: False
        self._scenery = scenery
        self._policy = policy
        self._call = AtTime(np.inf)
        self._wanted = tuple(triggers)
        self._triggers = (self._call, *map(copy.copy, triggers))
        self._rng = rng
        self._finished = finished
        self._driven = driven
        self._taken = taken
        self._counts = True
        self._parts = parts_of_a_step(float(scenery.api.simulation.getDeltaT()))
        self._part = 0
        self._teleported = False
        self._history: deque[Sighting] = deque(maxlen=HISTORY_STEPS)
        self._attack: Engagement | None = None
        self._leaving: list[Engagement] = []  # their attacks are over
        self._begin_s = 0.0
        self._ended_s: dict[AgentId, float] = {}
        self._next_s = -np.inf
        self._asleep = False
        self._frames = 0
        self._ran_ahead = False
        self._start_s = self.time_s = float(scenery.api.simulation.getTime())

    @property
    def av_id(self) -> AgentId:
        """The AV."""
        return self._scenery.av_id

    @property
    def surroundings(self) -> LiveRoad:
        """The road of the simulation."""
        return self._scenery.surroundings

    @property
    def attacking(self) -> AgentId | None:
        """The opponent, while an attack goes on; of several the first."""
        attack = self._attack
        return None if attack is None or attack.turns else attack.attackers[0]

    @property
    def engaged(self) -> bool:
        """Whether an attack goes on, or has just ended."""
        return self._attack is not None

    @property
    def driving(self) -> set[AgentId]:
        """The attackers, and those of earlier attacks on their way back to a lane."""
        return {agent for one in self._engaged() for agent in one.attackers}

    @property
    def paused(self) -> bool:
        """Whether new attacks are switched off."""
        return not self._on

    def switch(self, *, on: bool, door: str = "API") -> None:
        """Turn new attacks on or off; one that goes on ends as it would.

        ``door``: where it came in, for the record of the session.
        """
        if on == self._on:
            return
        self._on = on
        since = f"new attacks are off since {self.time_s:.1f} s ({door})"
        self.last_failure = "" if on else since
        self.switched(Switch(av=self.av_id, time_s=self.time_s, on=on, door=door))

    def attack(self) -> None:
        """Attack as soon as a vehicle can, whatever the triggers say."""
        self._call.not_before_s = -np.inf

    def before_step(self, now_s: float | None = None) -> None:
        """Put opponents at their poses at the end of the coming step.

        ``now_s``: SUMO's time, where `keep_time` has been told.

        Raises UsageError where the script has made steps of its own since `after_step`.
        """
        if now_s is None:
            self._check_time(self._sumo_time_s())
        self._scenery.observer.keep()
        for engagement in self._engaged():
            if self._part == 0:
                engagement.decide()
            engagement.place((self._part + 1) / self._parts)

    def _engaged(self) -> list[Engagement]:
        return [*self._leaving, *([] if self._attack is None else [self._attack])]

    def idle_frames(self) -> int:
        """Number of times 0.1 s that one step may last, since nothing can happen here before."""
        if not self._asleep or self._part:
            return 0
        until_s = self._due_s() - _WAKE_S - self.time_s
        ask = _ASK_EVERY - self._frames % _ASK_EVERY
        return ask if until_s > ask * DT_S else max(math.ceil(until_s / DT_S - 1e-6), 0)

    def after_long_step(self, frames: int) -> None:
        """Observe a step of at most `idle_frames` times 0.1 s."""
        self._frames += frames - 1
        self._part = self._parts - 1
        self.after_step()

    def after_step(self) -> None:
        """Observe the step, and begin or end an attack."""
        for engagement in self._engaged():
            engagement.settle()
        if self._attack is not None:
            moved = self._scenery.api.simulation.getStartingTeleportIDList()
            self._teleported |= self._scenery.av_id in moved
        self._part = (self._part + 1) % self._parts
        if self._part:
            return
        self._count_time()
        self._leaving = [one for one in self._leaving if one.leaving]
        self._publish()
        if self._may_sleep():
            self._sleep()
            return
        sighting = None if self._teleported else self._scenery.observer.look()
        self.av_present = sighting is not None
        if sighting is None:
            self._lose_sight()
            return
        self.av_seen = True
        self._history.append(sighting)
        if self._attack is not None:
            self._attack.look(sighting)
            if self._attack.turns:
                self._over()
        elif self._due():
            self._begin()

    def _due(self) -> bool:
        """Whether an attack may begin now."""
        seen = len(self._history) == HISTORY_STEPS
        may = not (self.paused or self.enough())
        return seen and may and self.time_s > self._next_s - 1e-6

    def hand_back(self) -> None:
        """End the current attack and begin no other; a step later the opponent is on its lane."""
        if self._attack is not None and not self._attack.turns:
            self._attack.stop("time")
            self._over()
        for engagement in self._engaged():
            engagement.let_go()
        self._leaving.clear()
        self._next_s = np.inf

    def close(self) -> None:
        """Hand back, and remove all that was added to the simulation."""
        try:
            self.hand_back()
        finally:  # the attack is published even if the connection is gone
            self._publish()
        self._scenery.observer.close()

    def _sumo_time_s(self) -> float:
        return float(self._scenery.api.simulation.getTime())

    def _count_time(self) -> None:
        self._frames += 1
        self.time_s = self._start_s + self._frames * DT_S

    @property
    def _expected_s(self) -> float:
        return self.time_s + self._part * DT_S / self._parts

    def _check_time(self, now_s: float) -> None:
        """As `keep_time`, where the script steps: a little ahead, or twice, is no loaded state."""
        ahead_s = now_s - self._expected_s
        again = self._ran_ahead and self._frames < _ASK_EVERY
        if _SAME_S < ahead_s < (np.inf if again else _MISSED_S):
            raise UsageError(
                f"The simulation is at {now_s:.12g} s and was stepped to {self._expected_s:.12g} s"
                " here; before_step and after_step belong around every single step."
            )
        self.keep_time(now_s)

    def keep_time(self, now_s: float) -> None:
        """Before each step: begin anew where SUMO is not at the time to which it was stepped.

        Then its script has loaded a state. An attack under way is over, and counts as undriven.
        """
        expected_s = self._expected_s
        if abs(now_s - expected_s) < _SAME_S:
            return
        self._ran_ahead = now_s > expected_s
        self._begin_anew(now_s, ahead=self._ran_ahead)
        self.jumped(TimeJump(from_s=expected_s, to_s=now_s))

    def _begin_anew(self, now_s: float, *, ahead: bool) -> None:
        """Forget what was seen; what is later than a time that comes again has not been."""
        for engagement in self._engaged():
            if ahead:
                engagement.let_go()
            else:
                engagement.forget()
        self.undriven += self._attack is not None and not self._attack.turns
        self._attack, self._leaving = None, []
        self._teleported = self._asleep = False
        self._history.clear()
        observer = self._scenery.observer
        if ahead:
            observer.close()
        else:
            observer.forget()
        self._start_s = self.time_s = now_s
        self._frames = self._part = 0
        if not ahead:
            self._triggers = (self._call, *map(copy.copy, self._wanted))
            self._ended_s.clear()
            self._next_s = np.inf if self._next_s == np.inf else -np.inf

    def _may_sleep(self) -> bool:
        """Whether no attack can begin before a second of history could be observed."""
        self._asleep = not self._engaged() and self.time_s < self._due_s() - _WAKE_S
        return self._asleep

    def _due_s(self) -> float:
        """Time before which no attack begins."""
        return max(self._next_s, min(one.not_before_s for one in self._triggers))

    def _sleep(self) -> None:
        """Check only whether the AV is present, now and then."""
        observer = self._scenery.observer
        if self._history:
            self._history.clear()
            observer.close()
        if self._frames % _ASK_EVERY == 0:
            self.av_present = observer.position(self._scenery.av_id) is not None
            self.av_seen |= self.av_present

    def _lose_sight(self) -> None:
        self._teleported = False
        self._history.clear()
        if self._attack is not None:
            self._attack.stop("av_gone")
            self._over()

    def check_script(self) -> None:
        """Check whether the script has left; that costs up to some milliseconds."""
        self.script_left = self.script_left or not self._driven()

    def _over(self) -> None:
        """The attack has ended just now."""
        self._next_s = self.time_s + self._scenery.pause_s
        self.check_script()
        self._counts = not self.script_left

    def _begin(self) -> None:
        scenery, latest = self._scenery, self._history[-1]
        moment = TriggerView(scenery.api, scenery.av_id, self.time_s, scenery.observer, latest)
        fired = next((one for one in self._triggers if one.fires(moment)), None)
        if fired is None:
            return
        self._next_s = self.time_s + _AGAIN_S
        if len(latest.all()) < 2:
            self.last_failure = "nobody is near the AV"
            return
        try:
            attack = Engagement(
                scenery,
                tuple(self._history),
                self._policy,
                self._rng,
                self._tired(),
                {*self._taken(), *self.driving},
            )
        except RunError as error:
            self.last_failure = str(error)
            return
        if not attack.attackers:
            self.last_failure = "no vehicle around the AV can attack"
            return
        fired.used()
        self._attack, self._begin_s = attack, self.time_s

    def _tired(self) -> list[AgentId]:
        """Vehicles that attacked lately."""
        since = self.time_s - self._scenery.rules.again_after_s
        return [agent for agent, end_s in self._ended_s.items() if end_s > since]

    def _publish(self) -> None:
        """Report an attack that is over; its opponent may still be on its way back to a lane."""
        attack = self._attack
        if attack is None or not attack.turns:
            return
        self._attack = None
        if attack.leaving:
            self._leaving.append(attack)
        rollout = attack.rollout()
        last_step = max(one.last_step for one in attack.turns)
        if last_step <= rollout.now:
            return  # it was stopped before its first step
        if not self._counts:
            self.undriven += 1
            return
        self.attacks += 1
        end_s = self._begin_s + (last_step - rollout.now) * DT_S
        self._ended_s |= dict.fromkeys(attack.attackers, end_s)
        self._finished(LiveAttack(begin_s=self._begin_s, end_s=end_s, rollout=rollout))


def parts_of_a_step(step_s: float) -> int:
    """Number of the simulation's steps in 0.1 s. Raises UsageError if 0.1 s is not a multiple."""
    parts = round(DT_S / step_s) if step_s > 0 else 0
    if parts < 1 or abs(parts * step_s - DT_S) > 1e-9:
        raise UsageError(
            f"The simulation steps by {step_s:g} s, and an attack needs 0.1 s or a whole part of "
            "it; start SUMO with --step-length 0.1 (or 0.05, 0.02, 0.01), `serve` with it behind "
            "a --. A client of `serve` may also have a multiple of 0.1 s."
        )
    return parts
