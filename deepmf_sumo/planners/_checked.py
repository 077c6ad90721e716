"""The planner under test, behind a guard: what goes wrong in it is said to be its own error."""

import math
import mmap
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Case, Command, VehicleModel, View
from deepmf_sumo.errors import DeepmfError, PlannerError
from deepmf_sumo.planners.base import ClosingPlanner, FixedPlanner, Planner
from deepmf_sumo.planners.remote.protocol import FASTEST_MPS

_USED: Final = {
    "pose": ("x_m", "y_m", "heading_rad", "speed_mps"),
    "speed": ("speed_mps",),
    "leader": ("gap_m", "leader_mps"),
    "sumo": (),
}
"""Numbers of a command, by its kind."""


_inside: Final = mmap.mmap(-1, 1)
"""Whether a planner's code is running, in this process or in a copy of it, which shares this."""


def at_work() -> bool:
    """Whether a copy of this process that has died did so in a planner's code; forgets it."""
    found, _inside[0] = bool(_inside[0]), 0
    return found


class Guard:
    """A planner whose commands can be carried out, or a PlannerError.

    Errors of this package (e.g. "needs a recording") pass as they are.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        # what was fixed before the episode may jump, as recordings with gaps do
        self._may_jump = isinstance(planner, FixedPlanner)

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of an episode."""
        with blamed():
            self._planner.reset(case, rng)

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM in SUMO."""
        with blamed():
            return self._planner.model

    def act(self, view: View) -> Command:
        """The command for a step. Raises PlannerError."""
        with blamed():
            command = self._planner.act(view)
        check(command, view, may_jump=self._may_jump)
        return command

    def close(self) -> None:
        """End of the episode, however it ended."""
        if isinstance(self._planner, ClosingPlanner):
            with blamed():
                self._planner.close()


def check(command: object, view: View, *, may_jump: bool) -> None:
    """Raise PlannerError where a command is none, is not finite, or asks for the impossible."""
    at = f"at step {view.step}"
    if not isinstance(command, Command):
        raise PlannerError(f"the planner's answer {at} is no Command: {command!r:.80}.")
    if command.kind not in _USED:
        raise PlannerError(f"kind {at} is {command.kind!r:.80}; known: {', '.join(_USED)}.")
    for name in _USED[command.kind]:
        value = getattr(command, name)
        if not isinstance(value, int | float | np.number) or not math.isfinite(value):
            raise PlannerError(f"{name} {at} is {value!r:.80}, not a finite number.")
    for name in {"speed_mps", "leader_mps"} & set(_USED[command.kind]):
        if abs(getattr(command, name)) > FASTEST_MPS:
            raise PlannerError(
                f"{name} {at} is {getattr(command, name):g}, and no vehicle drives faster than"
                f" {FASTEST_MPS:g} m/s."
            )
    if command.kind == "pose" and not may_jump:
        _check_way(command, view, at)


def _check_way(command: Command, view: View, at: str) -> None:
    x, y = view.history.position_m[view.history.row(view.av_id), -1]
    way = math.hypot(command.x_m - x, command.y_m - y)
    if way > FASTEST_MPS * view.dt_s:
        raise PlannerError(
            f"the pose ({command.x_m:g}, {command.y_m:g}) {at} is {way:.1f} m from the AV, farther"
            f" than it gets in {view.dt_s:g} s at {FASTEST_MPS:g} m/s."
        )


@contextmanager
def blamed() -> Iterator[None]:
    """Whatever a planner raises, ``sys.exit`` included, is an error of the planner."""
    process = os.getpid()
    before, _inside[0] = _inside[0], 1
    try:
        yield
    except DeepmfError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and not _unheard(signal.SIGINT):
            raise
        reason = f"{type(error).__name__}: {error} (see log.txt)"
        raise PlannerError(reason) from error
    finally:
        if os.getpid() != process:  # it forked, and this is the copy: there is one simulation
            os._exit(0)
        _inside[0] = before


def _unheard(number: signal.Signals) -> bool:
    """Whether nobody outside can have sent a signal, as in workers, which hear no Ctrl-C."""
    return signal.getsignal(number) is signal.SIG_IGN
