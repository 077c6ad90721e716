"""One client among several: steps with the others, attacks, and leaves without harm.

SUMO waits at every step for all of its clients, and quits when one of them breaks off without
saying goodbye. So whatever happens here, the opponent is handed back and the connection closed.
"""

import difflib
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Final, Literal

from deepmf_sumo.datatypes import AgentId
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.simulation.live.connection import LiveApi, lost, of_sumo
from deepmf_sumo.simulation.live.session import Session

End = Literal["until", "attacks", "av_gone", "simulation_over", "script_left", "stopped"]

_ASK_EVERY: Final = 10
"""Steps between two looks at whether the script is still there."""
_TOLERANCE_S: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Stay:
    """How long to take part; times are the simulation's.

    Attributes:
        until_s: leave then. attacks: leave after so many. None: no limit.
        patience_s: an AV that has not appeared for so long is an error.
    """

    until_s: float | None = None
    attacks: int | None = None
    patience_s: float = 600.0


class Lockstep:
    """Steps a simulation together with its other clients.

    Args:
        api: an own connection.
        session: attacks.
        av_id: whom it attacks.
        stay: for how long.
        stopped: whether to leave now; asked after each step.

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
        in_order = True  # else an answer of SUMO is still to come, and it hears nothing before
        try:
            end = self._steps()
            self.ended_s = session.time_s
            session.hand_back()
            api.simulationStep()  # in which who was beside its lane comes back onto it
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
        """What to say of a connection that is gone."""
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
        """Whether the AV is only away: SUMO teleports those that it holds for stuck."""
        return self._av in self._api.simulation.getStartingTeleportIDList() or (
            self._av not in self._api.simulation.getArrivedIDList() and self._av in self._loaded()
        )

    def _loaded(self) -> tuple[AgentId, ...]:
        return tuple(self._api.vehicle.getLoadedIDList())

    def _look_for_av(self) -> None:
        waited = self._session.time_s - self._begin_s
        nobody_left = self._api.simulation.getMinExpectedNumber() == 0
        if waited < self._stay.patience_s and not nobody_left:
            return
        there = sorted(self._loaded())
        nearest = difflib.get_close_matches(self._av, there, n=3)
        hint = f" Nearest: {', '.join(nearest)}." if nearest else ""
        known = f" Now there: {', '.join(there[:8])}{', ...' if len(there) > 8 else ''}."
        raise SimulationError(
            f"Vehicle '{self._av}' has not appeared in {waited:.0f} s of the simulation"
            f"{' and all others have left' if nobody_left else ''}.{hint or known}"
        )


@contextmanager
def _without_sumos_complaints() -> Iterator[None]:
    """Whatever SUMO refuses while it is left does not matter any more."""
    try:
        yield
    except Exception as error:
        if not of_sumo(error):
            raise
