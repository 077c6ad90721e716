"""A session with a simulation that another program runs, in lockstep with it.

It is one client among several: it steps with the others, attacks, and leaves without harm. SUMO
waits at each step for all of its clients, and quits if one of them disconnects without closing. So
whatever happens here, the opponent is handed back and the connection closed.
"""

import difflib
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from deepmf_sumo.datatypes import DT_S, HISTORY_STEPS, AgentId, Rollout
from deepmf_sumo.errors import RunError, SimulationError, UsageError
from deepmf_sumo.live.connection import LiveApi, lost, of_sumo
from deepmf_sumo.live.engagement import Engagement, Scenery, Surroundings
from deepmf_sumo.live.observer import Sighting
from deepmf_sumo.live.triggers import AtTime, Moment, Trigger
from deepmf_sumo.policies.base import Policy

_ASK_EVERY: Final = 10
_WAKE_S: Final = 1.5
_AGAIN_S: Final = 1.0
"""Until the next try to attack after one in which no vehicle could."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveAttack:
    """An attack that is over. ``begin_s``, ``end_s``: time of the simulation."""

    number: int
    begin_s: float
    end_s: float
    rollout: Rollout


class Session:
    """Attacks on one AV; the caller calls `before_step` and `after_step` around each step.

    Args:
        scenery: the simulation, its AV and the rules.
        policy: chooses and drives the opponents.
        triggers: an attack begins when one of them fires.
        pause_s: after an attack before the next.
        rng: for the policy.
        finished: called with each attack that is over.
        driven: whether the script that drives the AV is still connected. If it is not at the end
            of an attack, the attack counts in ``undriven`` alone: SUMO drove the AV in part of it.

    Attributes:
        attacks, undriven: numbers of attacks so far.
        last_failure: why the last try to attack failed.
        paused: set it, and no attack begins; one that goes on ends as it would.

    Raises UsageError if 0.1 s is not a multiple of the simulation's step.
    """

    def __init__(
        self,
        scenery: Scenery,
        policy: Policy,
        triggers: Sequence[Trigger],
        pause_s: float,
        rng: np.random.Generator,
        finished: Callable[[LiveAttack], None],
        driven: Callable[[], bool] = lambda: True,
    ) -> None:
        self.attacks = 0
        self.undriven = 0
        self.script_left = False
        self.av_seen = False
        self.av_present = False
        self.last_failure = ""
        self.paused = False
        self._scenery = scenery
        self._policy = policy
        self._call = AtTime(np.inf)
        self._triggers = (self._call, *triggers)
        self._pause_s = pause_s
        self._rng = rng
        self._finished = finished
        self._driven = driven
        self._counts = True
        self._parts = parts_of_a_step(float(scenery.api.simulation.getDeltaT()))
        self._part = 0
        self._teleported = False
        self._history: deque[Sighting] = deque(maxlen=HISTORY_STEPS)
        self._attack: Engagement | None = None
        self._begin_s = 0.0
        self._ended_s: dict[AgentId, float] = {}
        self._next_s = -np.inf
        self._frames = 0
        self._start_s = self.time_s = float(scenery.api.simulation.getTime())

    @property
    def surroundings(self) -> Surroundings:
        """The road of the simulation."""
        return self._scenery.surroundings

    @property
    def attacking(self) -> AgentId | None:
        """The opponent, while an attack goes on."""
        attack = self._attack
        return attack.opponent_id if attack is not None and attack.turn is None else None

    def attack(self) -> None:
        """Attack as soon as a vehicle can, whatever the triggers say."""
        self._call.not_before_s = -np.inf

    def before_step(self) -> None:
        """Put the opponent at its pose at the end of the coming step."""
        attack = self._attack
        if attack is None or attack.turn is not None:
            return
        if self._part == 0:
            attack.decide()
        attack.place((self._part + 1) / self._parts)

    def after_step(self) -> None:
        """Observe the step, and begin or end an attack."""
        if self._attack is not None:
            self._attack.settle()
            moved = self._scenery.api.simulation.getStartingTeleportIDList()
            self._teleported |= self._scenery.av_id in moved
        self._part = (self._part + 1) % self._parts
        if self._part:
            return
        self._count_time()
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
            if self._attack.turn is not None:
                self._over()
        elif self._due():
            self._begin()

    def _due(self) -> bool:
        """Whether an attack may begin now."""
        seen = len(self._history) == HISTORY_STEPS
        return seen and not self.paused and self.time_s > self._next_s - 1e-6

    def hand_back(self) -> None:
        """End the current attack and begin no other; a step later the opponent is on its lane."""
        if self._attack is not None and self._attack.turn is None:
            self._attack.stop("time")
            self._over()
        self._next_s = np.inf

    def close(self) -> None:
        """Hand back, and remove all that was added to the simulation."""
        try:
            self.hand_back()
        finally:  # the attack is published even if the connection is gone
            self._publish()
        self._scenery.observer.close()

    def _count_time(self) -> None:
        """Count, and check with SUMO now and then: asking costs as much as a tenth of a step."""
        self._frames += 1
        self.time_s = self._start_s + self._frames * DT_S
        if self._frames % _ASK_EVERY:
            return
        now = float(self._scenery.api.simulation.getTime())
        if abs(now - self.time_s) > 1e-6:
            raise UsageError(
                f"The simulation is at {now:g} s and was stepped to {self.time_s:g} s here; "
                "before_step and after_step belong around every single step."
            )

    def _may_sleep(self) -> bool:
        """Whether no attack can begin before a second of history could be observed."""
        due_s = max(self._next_s, min(one.not_before_s for one in self._triggers))
        return self._attack is None and self.time_s < due_s - _WAKE_S

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
        self._next_s = self.time_s + self._pause_s
        self.check_script()
        self._counts = not self.script_left

    def _begin(self) -> None:
        scenery, latest = self._scenery, self._history[-1]
        moment = Moment(scenery.api, scenery.av_id, self.time_s, scenery.observer, latest)
        fired = next((one for one in self._triggers if one.fires(moment)), None)
        if fired is None:
            return
        self._next_s = self.time_s + _AGAIN_S
        if len(latest.vehicles) < 2:
            self.last_failure = "no vehicle is near the AV"
            return
        try:
            attack = Engagement(
                scenery, tuple(self._history), self._policy, self._rng, self._tired()
            )
        except RunError as error:
            self.last_failure = str(error)
            return
        if attack.opponent_id is None:
            self.last_failure = "no vehicle around the AV can attack"
            return
        fired.used()
        self._attack, self._begin_s = attack, self.time_s

    def _tired(self) -> list[AgentId]:
        """Vehicles that attacked lately."""
        since = self.time_s - self._scenery.rules.again_after_s
        return [agent for agent, end_s in self._ended_s.items() if end_s > since]

    def _publish(self) -> None:
        """Report an attack that is over, now that SUMO drives its opponent again."""
        attack = self._attack
        if attack is None or attack.turn is None:
            return
        self._attack = None
        if not self._counts:
            self.undriven += 1
            return
        self.attacks += 1
        rollout = attack.rollout()
        end_s = self._begin_s + (attack.turn.last_step - rollout.now) * DT_S
        self._ended_s[attack.turn.opponent_id] = end_s
        self._finished(
            LiveAttack(number=self.attacks, begin_s=self._begin_s, end_s=end_s, rollout=rollout)
        )


def parts_of_a_step(step_s: float) -> int:
    """Number of the simulation's steps in 0.1 s. Raises UsageError if 0.1 s is not a multiple."""
    parts = round(DT_S / step_s)
    if parts < 1 or abs(parts * step_s - DT_S) > 1e-9:
        raise UsageError(
            f"The simulation steps by {step_s:g} s, and an attack needs 0.1 s or a whole part of "
            "it; start SUMO with --step-length 0.1 (or 0.05, 0.02, 0.01)."
        )
    return parts


End = Literal["until", "attacks", "av_gone", "simulation_over", "script_left", "stopped"]

_TOLERANCE_S: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Stay:
    """How long to take part; times are the simulation's.

    Attributes:
        until_s: leave then. attacks: leave after this number. None: no limit.
        patience_s: an AV that has not appeared in this time is an error.
    """

    until_s: float | None = None
    attacks: int | None = None
    patience_s: float = 600.0


class Lockstep:
    """Steps a simulation together with its other clients.

    Args:
        api: a connection of its own.
        session: attacks.
        av_id: the vehicle that it attacks.
        stay: how long to take part.
        stopped: whether to leave now; called before the first step and after each.

    Attributes:
        ended_s: the simulation's time at the end.
    """

    def __init__(
        self,
        api: LiveApi,
        session: Session,
        av_id: AgentId,
        stay: Stay,
        stopped: Callable[[], bool],
    ) -> None:
        self._api, self._session, self._av = api, session, av_id
        self._stay, self._stopped = stay, stopped
        self._looks = 0
        self._begin_s = self.ended_s = session.time_s
        end_s = float(api.simulation.getOption("end"))
        self._end_s = end_s if end_s >= 0 else math.inf

    def run(self) -> End:
        """Take part until one of the ends; the connection is closed then, whatever happens.

        Raises SimulationError where the connection is lost or the AV never appears.
        """
        session, api = self._session, self._api
        in_order = True  # else an answer of SUMO is pending, and it reads nothing before
        try:
            end = self._steps()
            self.ended_s = session.time_s
            session.hand_back()
            api.simulationStep()  # in which a vehicle beside its lane comes back onto it
            session.after_step()
            return end
        except KeyboardInterrupt:
            in_order = False
            raise
        except Exception as error:
            if not of_sumo(error):
                raise
            if not lost(error):
                raise SimulationError(
                    f"SUMO refused at {session.time_s:.1f} s of the simulation: "
                    f"{str(error).strip()}"
                ) from None
            self.ended_s = session.time_s
            if abs(session.time_s - self._end_s) <= 1.0:  # later SUMO goes on for its clients
                return "simulation_over"
            raise SimulationError(self._lost(str(error).strip())) from None
        finally:
            if in_order:
                self._leave()

    def _leave(self) -> None:
        with _without_sumos_complaints():
            self._session.close()
        with suppress(OSError), _without_sumos_complaints():
            self._api.close()

    def _lost(self, reason: str) -> str:
        """The message for a connection that is gone."""
        time_s = self._session.time_s
        if time_s == self._begin_s:
            return (
                f"SUMO ended before its first step ({reason}): every client needs a number of its "
                "own, --order here and setOrder in a script, and SUMO one --num-clients for all."
            )
        return (
            f"The connection was lost at {time_s:.1f} s of the simulation ({reason}): SUMO has "
            "ended, or another of its clients broke off."
        )

    def _steps(self) -> End:
        if self._stopped():
            return "stopped"
        while True:
            self._session.before_step()
            self._api.simulationStep()
            self._session.after_step()
            end = self._ending()
            if end is not None:
                return end

    def _ending(self) -> End | None:
        session, stay = self._session, self._stay
        if self._stopped():
            return "stopped"
        if session.av_seen and not session.av_present and not self._elsewhere():
            return "av_gone"
        self._looks += 1
        if self._looks % _ASK_EVERY == 0:
            session.check_script()
        if session.script_left:
            return "script_left"
        if stay.attacks is not None and session.attacks >= stay.attacks:
            return "attacks"
        if stay.until_s is not None and session.time_s >= stay.until_s - _TOLERANCE_S:
            return "until"
        if not session.av_seen:
            self._look_for_av()
        return None

    def _elsewhere(self) -> bool:
        """Whether the AV will be back: SUMO teleports vehicles that it takes for stuck."""
        return self._av in self._api.simulation.getStartingTeleportIDList() or (
            self._av not in self._api.simulation.getArrivedIDList() and self._av in self._loaded()
        )

    def _loaded(self) -> tuple[AgentId, ...]:
        return tuple(self._api.vehicle.getLoadedIDList())

    def _look_for_av(self) -> None:
        waited = self._session.time_s - self._begin_s
        none_left = self._api.simulation.getMinExpectedNumber() == 0
        if waited < self._stay.patience_s and not none_left:
            return
        there = sorted(self._loaded())
        nearest = difflib.get_close_matches(self._av, there, n=3)
        hint = f" Nearest: {', '.join(nearest)}." if nearest else ""
        known = f" Now there: {', '.join(there[:8])}{', ...' if len(there) > 8 else ''}."
        known = known if there else " No vehicle is there now."
        raise SimulationError(
            f"Vehicle '{self._av}' has not appeared in {waited:.0f} s of the simulation"
            f"{' and all others have left' if none_left else ''}.{hint or known}"
        )


@contextmanager
def _without_sumos_complaints() -> Iterator[None]:
    """Ignore what SUMO refuses while this client leaves."""
    try:
        yield
    except Exception as error:
        if not of_sumo(error):
            raise
