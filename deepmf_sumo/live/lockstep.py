"""A client among several of a running SUMO: it steps with the others, and leaves without harm.

SUMO waits at each step for all of its clients, and quits if one of them disconnects without
closing. So whatever happens here, opponents are handed back and the connection is closed.
"""

import difflib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Final, Literal, Self

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.live.connection import LiveApi, lost, of_sumo
from deepmf_sumo.live.session import Session
from deepmf_sumo.scene import DT_S, AgentId

_ASK_EVERY: Final = 10
_TOLERANCE_S: Final = 1e-6

End = Literal["until", "attacks", "av_gone", "simulation_over", "script_left", "stopped"]


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

    def after(self, attacks: int) -> Self:
        """The same after a number of attacks."""
        if self.attacks is None:
            return self
        return replace(self, attacks=max(self.attacks - attacks, 0))


class Lockstep:
    """Steps a simulation together with its other clients.

    Args:
        api: a connection of its own.
        sessions: attacks, one session for each AV.
        stay: how long to take part.
        stopped: whether to leave now; called before the first step and after each.

    Attributes:
        ended_s: the simulation's time at the end.
    """

    def __init__(
        self,
        api: LiveApi,
        sessions: Sequence[Session],
        stay: Stay,
        stopped: Callable[[], bool],
    ) -> None:
        self._api, self._sessions = api, tuple(sessions)
        self._stay, self._stopped = stay, stopped
        for session in self._sessions:
            session.enough = self._enough
        self._since_asked = 0
        self._begin_s = self.ended_s = self._time_s
        end_s = float(api.simulation.getOption("end"))
        self._end_s = end_s if end_s >= 0 else math.inf

    @property
    def _time_s(self) -> float:
        return self._sessions[0].time_s

    def _enough(self) -> bool:
        """Whether no other attack may begin: that many are over or under way."""
        begun = [one.attacks + one.engaged for one in self._sessions]
        return self._stay.attacks is not None and sum(begun) >= self._stay.attacks

    def run(self) -> End:
        """Take part until one of the ends; the connection is closed then, whatever happens.

        Raises SimulationError where the connection is lost or the AV never appears.
        """
        api = self._api
        in_order = True  # else an answer of SUMO is pending, and it reads nothing before
        try:
            end = self._steps()
            self.ended_s = self._time_s
            for session in self._sessions:
                session.hand_back()
            api.simulationStep()  # in which a vehicle beside its lane comes back onto it
            for session in self._sessions:
                session.after_step()
            return end
        except KeyboardInterrupt:
            in_order = False
            self.ended_s = self._time_s
            raise
        except Exception as error:
            if not of_sumo(error):
                raise
            if not lost(error):
                raise SimulationError(
                    f"SUMO refused at {self._time_s:.1f} s of the simulation: {str(error).strip()}"
                ) from None
            self.ended_s = self._time_s
            if abs(self._time_s - self._end_s) <= 1.0:  # later SUMO goes on for its clients
                return "simulation_over"
            self._sessions[0].check_script()
            if self._sessions[0].script_left:
                return "script_left"
            raise SimulationError(self._lost(str(error).strip())) from None
        finally:
            if in_order:
                self._leave()

    def _leave(self) -> None:
        for session in self._sessions:
            with _without_sumos_complaints():
                session.close()
        with suppress(OSError), _without_sumos_complaints():
            self._api.close()

    def _lost(self, reason: str) -> str:
        """The message for a connection that is gone."""
        time_s = self._time_s
        if time_s == self._begin_s:
            return (
                f"SUMO ended before its first step ({reason}): every client needs a number of its "
                "own, live.order here and setOrder in a script, and SUMO one --num-clients for all."
            )
        return (
            f"The connection was lost at {time_s:.1f} s of the simulation ({reason}): SUMO has "
            "ended, or another of its clients broke off."
        )

    def _steps(self) -> End:
        if self._stopped():
            return "stopped"
        while True:
            self._step()
            end = self._ending()
            if end is not None:
                return end

    def _step(self) -> None:
        """One step, or a longer one where nothing can happen: each costs an exchange with SUMO."""
        now_s = float(self._api.simulation.getTime())
        for session in self._sessions:
            session.keep_time(now_s)
        frames = min(session.idle_frames() for session in self._sessions)
        if self._stay.until_s is not None:
            frames = min(frames, round((self._stay.until_s - self._time_s) / DT_S))
        self._since_asked += max(frames, 1)
        if frames > 1:
            self._api.simulationStep(self._time_s + frames * DT_S)
            for session in self._sessions:
                session.after_long_step(frames)
            return
        for session in self._sessions:
            session.before_step(now_s)
        self._api.simulationStep()
        for session in self._sessions:
            session.after_step()

    def _ending(self) -> End | None:
        sessions, stay = self._sessions, self._stay
        if self._stopped():
            return "stopped"
        if all(one.av_seen and not one.av_present and not self._elsewhere(one) for one in sessions):
            return "av_gone"
        if self._since_asked >= _ASK_EVERY:
            self._since_asked = 0
            sessions[0].check_script()
        if any(one.script_left for one in sessions):
            return "script_left"
        done = stay.attacks is not None and sum(one.attacks for one in sessions) >= stay.attacks
        if done and not any(one.driving for one in sessions):
            return "attacks"
        if stay.until_s is not None and self._time_s >= stay.until_s - _TOLERANCE_S:
            return "until"
        for one in sessions:
            if not one.av_seen:
                self._look_for_av(one.av_id)
        return None

    def _elsewhere(self, session: Session) -> bool:
        """Whether the AV will be back: SUMO teleports vehicles that it takes for stuck."""
        av, simulation = session.av_id, self._api.simulation
        return av in simulation.getStartingTeleportIDList() or (
            av not in simulation.getArrivedIDList() and av in self._loaded()
        )

    def _loaded(self) -> tuple[AgentId, ...]:
        return tuple(self._api.vehicle.getLoadedIDList())

    def _look_for_av(self, av: AgentId) -> None:
        waited = self._time_s - self._begin_s
        if math.isinf(self._stay.patience_s):
            return
        none_left = self._api.simulation.getMinExpectedNumber() == 0
        if waited < self._stay.patience_s and not none_left:
            return
        there = sorted(self._loaded())
        nearest = difflib.get_close_matches(av, there, n=3)
        hint = f" Nearest: {', '.join(nearest)}." if nearest else ""
        known = f" Now there: {', '.join(there[:8])}{', ...' if len(there) > 8 else ''}."
        known = known if there else " No vehicle is there now."
        raise SimulationError(
            f"Vehicle '{av}' has not appeared in {waited:.0f} s of the simulation"
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
