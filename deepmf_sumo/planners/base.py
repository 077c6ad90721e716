"""What a planner is: whatever drives the AV."""

from typing import Protocol, runtime_checkable

import numpy as np

from deepmf_sumo.datatypes import Case, Command, Floats, VehicleModel, View


class Planner(Protocol):
    """Drives the AV, one command a step.

    A plug-in whose AV drives as a person did, in a recording, says so by ``DRIVER = "human"`` in
    its module or class: people react otherwise than automated planners.
    """

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM in SUMO; None keeps the vehicle type of the network."""
        ...

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of an episode."""
        ...

    def act(self, view: View) -> Command:
        """The command for the step that follows ``view``."""
        ...


@runtime_checkable
class FixedPlanner(Planner, Protocol):
    """A planner whose AV does the same whatever happens around it.

    Where the traffic does not react either, episodes are put together from these poses without
    SUMO and without asking `act`, which is fifty times as fast.
    """

    def fixed_poses(self, steps: int) -> Floats:
        """(steps, 4) x, y, heading, speed (signed) after now: what `act` commands, as poses."""
        ...


@runtime_checkable
class ClosingPlanner(Planner, Protocol):
    """A planner that holds something beyond its memory, e.g. a process."""

    def close(self) -> None:
        """End of an episode, also of one that failed; `reset` may follow."""
        ...
