"""What the episode's loop needs of a simulated world, whatever it was made of."""

from collections.abc import Mapping
from typing import Protocol

from deepmf_sumo.scene import AgentId, Command, Event, Floats, SignalState
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.sumo.simulation.ownership import NextOwner


class DrivenAv(Protocol):
    """The AV of a world."""

    @property
    def present(self) -> bool:
        """Whether it is still simulated."""
        ...

    @property
    def leaders(self) -> tuple[AgentId, ...] | None:
        """The vehicles that it followed in the last step; None if that is not known."""
        ...

    def path(self) -> Floats | None:
        """(P, 2) centre line from the front bumper on, for planners; None without one."""
        ...


class BeginningWorld(Protocol):
    """A world at the current step of a case, before anything moves it."""

    def history(self) -> list[Frame]:
        """The frames up to the current step, oldest first, at least `HISTORY_STEPS` of them."""
        ...

    def body(self, agent: AgentId) -> Body:
        """Kind and size of an agent that has appeared in a frame."""
        ...

    def signals(self) -> dict[str, SignalState]:
        """The current states of the lights, by lane id of the case's road."""
        ...

    @property
    def next_owner(self) -> NextOwner:
        """What drives opponents where no plan does."""
        ...


class World(BeginningWorld, Protocol):
    """A simulated world; only `step` changes it."""

    @property
    def av(self) -> DrivenAv:
        """The AV in it."""
        ...

    @property
    def events(self) -> list[Event]:
        """What qualifies the result; grows with the steps."""
        ...

    def step(self, command: Command, poses: Mapping[AgentId, Pose | None]) -> Frame:
        """One step: the AV as commanded, opponents at their poses (None: as without a policy)."""
        ...
