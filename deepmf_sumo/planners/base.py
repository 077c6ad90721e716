"""Planners: what drives the AV."""

from typing import Protocol, runtime_checkable

import numpy as np

from deepmf_sumo.scene import Case, Command, Floats, VehicleModel, View


class Planner(Protocol):
    """Drives the AV, one command per step.

    A plug-in whose AV drives as a person did in a recording sets ``DRIVER = "human"`` in its module
    or class: people react differently from automated planners.
    """

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM in SUMO; None keeps the vehicle type of the network."""
        ...

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of an episode; ``rng`` begins with the case's seed."""
        ...

    def act(self, view: View) -> Command:
        """The command for the step that follows ``view``."""
        ...


@runtime_checkable
class FixedPlanner(Planner, Protocol):
    """A planner whose AV does not react to anything around it.

    If the traffic does not react either, episodes are assembled from these poses without SUMO and
    without calls of `act`, which is fifty times as fast.
    """

    def fixed_poses(self, steps: int) -> Floats:
        """(steps, 4) x, y, heading, speed (signed) after now: what `act` commands, as poses."""
        ...


@runtime_checkable
class ClosingPlanner(Planner, Protocol):
    """A planner with resources to release, e.g. a process."""

    def close(self) -> None:
        """End of an episode, whether it succeeded or failed; `reset` may follow."""
        ...
