"""What the episode's loop needs of a simulated world, whatever it was made of."""

from typing import Protocol

from deepmf_sumo.datatypes import AgentId, Command, Event, SignalState
from deepmf_sumo.simulation.av import Av
from deepmf_sumo.simulation.frame import Body, Frame, Pose


class World(Protocol):
    """A world in which SUMO runs, at the current step of a case; only `step` changes it.

    Attributes:
        av: the AV in SUMO: its path, its leaders, and whether it is still present.
        events: what qualifies the result; grows with the steps.
    """

    av: Av
    events: list[Event]

    def history(self) -> list[Frame]:
        """The frames up to the current step, oldest first, at least `HISTORY_STEPS` of them."""
        ...

    def body(self, agent: AgentId) -> Body:
        """Kind and size of an agent that has appeared in a frame."""
        ...

    def signals(self) -> dict[str, SignalState]:
        """The current states of the lights, by lane id of the case's road."""
        ...

    def step(self, command: Command, opponent: AgentId | None, pose: Pose | None) -> Frame:
        """One step: the AV as commanded, the opponent at the pose (None: as without a policy)."""
        ...
