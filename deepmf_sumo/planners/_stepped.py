"""An episode that waits at each step for a command from outside, as an environment needs it."""

from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final

import numpy as np

from deepmf_sumo.errors import DeepmfError, UsageError
from deepmf_sumo.planners.base import Planner
from deepmf_sumo.scene import Case, Command, VehicleModel, View


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """The episode is over; ``result`` is what its function returned."""

    result: Any


class _LeftError(DeepmfError):
    """The episode was ended by the other thread."""


_LEAVE: Final = object()


class SteppedEpisode:
    """An episode in another thread, which waits at each step for the next command.

    Args:
        episode: simulates one with a planner, in a separate thread; returns its result.
        model: parameters of the AV's IDM in SUMO.
    """

    def __init__(self, episode: Callable[[Planner], Any], model: VehicleModel | None) -> None:
        self._model = model
        self._views: SimpleQueue[View | Ended | BaseException] = SimpleQueue()
        self._commands: SimpleQueue[Any] = SimpleQueue()
        self._started = False
        self._thread = Thread(target=self._run, args=(episode,), daemon=True)
        self._thread.start()

    def next(self, command: Command | None = None) -> View | Ended:
        """The view after a command (None: the first view), or that the episode has ended.

        Raises what the simulation raises.
        """
        if command is not None:
            self._commands.put(command)
        came = self._views.get()
        if isinstance(came, BaseException):
            self._thread.join()
            raise came
        if isinstance(came, Ended):
            self._thread.join()
        return came

    def leave(self) -> None:
        """End the episode, if it is running."""
        self._commands.put(_LEAVE)
        self._thread.join()

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of the episode. Raises UsageError for adversaries that simulate several."""
        if self._started:
            raise UsageError(
                "This adversary simulates an attack more than once before it decides, and an"
                " environment is stepped through once; use deepmf or none."
            )
        self._started = True

    def act(self, view: View) -> Command:
        """The other thread's command."""
        self._views.put(view)
        command = self._commands.get()
        if command is _LEAVE:
            raise _LeftError
        checked: Command = command
        return checked

    def _run(self, episode: Callable[[Planner], Any]) -> None:
        try:
            ended = Ended(result=episode(self))
        except BaseException as error:  # noqa: BLE001 - it is raised again in the other thread
            self._views.put(error)
        else:
            self._views.put(ended)
