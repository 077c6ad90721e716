"""The planner under test, behind a guard that reports what goes wrong in it as its error."""

import math
import mmap
import os
from collections.abc import Iterator, MutableSequence
from contextlib import contextmanager, nullcontext
from typing import Final

import numpy as np

from deepmf_sumo import foreign, system
from deepmf_sumo.errors import DeepmfError, PlannerError
from deepmf_sumo.planners._stepped import SteppedEpisode
from deepmf_sumo.planners.base import ClosingPlanner, FixedPlanner, Planner
from deepmf_sumo.planners.remote.protocol import FASTEST_MPS, NUMBERS
from deepmf_sumo.scene import Case, Command, VehicleModel, View
from deepmf_sumo.scene.geometry.frames import TURNED_RAD

_OVERSHOOT_MPS: Final = 1.0
"""A planner that brakes to a stop by full steps ends up to this far below 0, which counts as 0."""
Flag = MutableSequence[int] | mmap.mmap
"""Of one element."""

_inside: Flag = mmap.mmap(-1, 1)
"""Whether a planner's code is running; copies of this process share the flag."""


def share(flag: Flag) -> None:
    """Keep the flag where another process sees it, which has no copy of this one's memory."""
    global _inside  # noqa: PLW0603
    _inside = flag


def at_work() -> bool:
    """Whether a copy of this process died in a planner's code; resets the flag."""
    found, _inside[0] = bool(_inside[0]), 0
    return found


def ended(how: str) -> PlannerError:
    """The error where code of the planner ended its process; ``how`` as `system.ending`."""
    return PlannerError(f"the planner ended its process ({how}; see log.txt).", kind="crashed")


class Guard:
    """A planner whose commands can be driven; any other command is a PlannerError.

    Errors of this package (e.g. "needs a recording") pass as they are.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        # poses fixed before the episode may jump, as recordings with gaps do
        self._may_jump = isinstance(planner, FixedPlanner)
        # its code is in the user's own thread, between steps, where it stays as it is
        self._here = not isinstance(planner, SteppedEpisode)

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of an episode."""
        with blamed(here=self._here):
            self._planner.reset(case, rng)

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM in SUMO."""
        with blamed(here=self._here):
            return self._planner.model

    def act(self, view: View) -> Command:
        """The command for a step, its numbers plain ones. Raises PlannerError."""
        with blamed(here=self._here):
            command = self._planner.act(view)
        check(command, view, may_jump=self._may_jump)
        # SUMO takes no numpy.float32, which a network computes, and no numpy.int64
        numbers = {name: float(getattr(command, name)) for name in NUMBERS[command.kind]}
        return Command(kind=command.kind, leader_id=command.leader_id, **numbers)

    def close(self) -> None:
        """End of the episode, however it ended."""
        if isinstance(self._planner, ClosingPlanner):
            with blamed():
                self._planner.close()


def check(command: object, view: View, *, may_jump: bool) -> None:
    """Raise PlannerError for what is not a command, is not finite, or cannot be driven."""
    at = f"at step {view.step}"
    if not isinstance(command, Command):
        raise PlannerError(f"the planner returned {command!r:.80} {at}, which is not a Command.")
    if command.kind not in NUMBERS:
        raise PlannerError(f"kind {at} is {command.kind!r:.80}; known: {', '.join(NUMBERS)}.")
    for name in NUMBERS[command.kind]:
        value = getattr(command, name)
        number = isinstance(value, int | float | np.integer | np.floating)
        if not number or not math.isfinite(value):
            raise PlannerError(f"{name} {at} is {value!r:.80}, not a finite number.")
    for name in {"speed_mps", "leader_mps"} & set(NUMBERS[command.kind]):
        if abs(getattr(command, name)) > FASTEST_MPS:
            raise PlannerError(
                f"{name} {at} is {getattr(command, name):g}, and no vehicle drives faster than"
                f" {FASTEST_MPS:g} m/s."
            )
    if command.kind == "speed" and command.speed_mps < -_OVERSHOOT_MPS:
        raise PlannerError(
            f"speed_mps {at} is {command.speed_mps:g}: along its route the AV cannot drive"
            " backwards; for that, command poses."
        )
    if command.kind == "pose" and abs(command.heading_rad) > TURNED_RAD:
        raise PlannerError(
            f"heading_rad {at} is {command.heading_rad:g}; it must be an angle between"
            f" -{TURNED_RAD:g} and {TURNED_RAD:g} rad."
        )
    if command.kind == "pose" and not may_jump:
        _check_distance(command, view, at)


def _check_distance(command: Command, view: View, at: str) -> None:
    x, y = view.history.position_m[view.history.row(view.av_id), -1]
    moved_m = math.hypot(command.x_m - x, command.y_m - y)
    if moved_m > FASTEST_MPS * view.dt_s:
        raise PlannerError(
            f"the pose ({command.x_m:g}, {command.y_m:g}) {at} is {moved_m:.6g} m from the AV,"
            f" farther than it gets in {view.dt_s:g} s at {FASTEST_MPS:g} m/s."
        )


@contextmanager
def blamed(*, here: bool = True) -> Iterator[None]:
    """Turn every exception of a planner, SystemExit included, into a PlannerError.

    ``here``: its code runs in this thread.
    """
    process = os.getpid()
    before, _inside[0] = _inside[0], 1
    try:
        with foreign.code() if here else nullcontext():
            yield
    except DeepmfError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and any(system.interrupts()):
            raise  # else the planner raised it itself
        reason = f"{type(error).__name__}: {_text(error)} (see log.txt)"
        raise PlannerError(reason, kind="crashed") from error
    finally:
        if os.getpid() != process:  # it forked, and this is the copy: there is one simulation
            os._exit(0)
        _inside[0] = before


def _text(error: BaseException) -> str:
    """What an error says; its class may be the planner's, too."""
    try:
        return str(error)
    except Exception:  # noqa: BLE001 - of the planner
        return "its text cannot be read"
