"""The simulation's side of a program that drives the AV."""

import numpy as np

from deepmf_sumo.datatypes import Case, Command, VehicleModel, View
from deepmf_sumo.planners.doors import answers, asking
from deepmf_sumo.planners.doors.process import Process
from deepmf_sumo.planners.doors.settings import DoorSettings


class ProgramPlanner:
    """Starts the program for every episode, and ends it afterwards with all that it started.

    Args:
        name: of the program in messages.
        command: what to start.
        settings: limits.
    """

    def __init__(self, name: str, command: list[str], settings: DoorSettings) -> None:
        self._name = name
        self._command = command
        self._settings = settings
        self._process: Process | None = None
        self._episode = ""
        self._model: VehicleModel | None = None

    @property
    def model(self) -> VehicleModel | None:
        """What the program asked for when it was ready."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start the program. Its seed is the case's: ``rng`` also serves the adversary."""
        self.close()
        self._episode = asking.episode_of(case)
        self._process = Process(self._name, self._command)
        line = asking.reset_message(case, road=self._settings.road)
        answer = self._process.ask(line, self._settings.start_budget_s, "the reset")
        self._model = answers.read_ready(self._name, answer)

    def act(self, view: View) -> Command:
        """The program's command. Raises PlannerError."""
        assert self._process is not None
        line = asking.view_message(self._episode, view, self._settings.history_steps)
        answer = self._process.ask(line, self._settings.step_budget_s, f"step {view.step}")
        return answers.read_command(self._name, answer, view.step)

    def close(self) -> None:
        """End the program, and all that it started."""
        if self._process is not None:
            self._process.close()
            self._process = None
