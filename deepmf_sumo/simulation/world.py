"""What the loop needs of a simulated world, whatever it was made of."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from deepmf_sumo.datatypes import (
    AgentId,
    Case,
    Command,
    Event,
    Floats,
    SignalState,
    TrafficCase,
    VehicleModel,
)
from deepmf_sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.simulation.sumo_api import Backend


class Stage(Protocol):
    """A world in which SUMO runs; from the current step on it is changed by `advance` alone."""

    events: list[Event]

    def history(self) -> list[Frame]:
        """The frames up to the current step, oldest first, at least `HISTORY_STEPS` of them."""
        ...

    def body(self, agent: AgentId) -> Body:
        """What an agent is. Asked when it first appears in a frame."""
        ...

    def signals(self) -> dict[str, SignalState]:
        """The lights as they are now, by lane id of the case's road."""
        ...

    def av_path(self) -> Floats | None:
        """(P, 2) centre line ahead of the AV from its front bumper on, or None off the lanes."""
        ...

    def advance(self, command: Command, opponent: AgentId | None, pose: Pose | None) -> Frame:
        """One step: the AV as commanded, the opponent at the pose (None: as if nobody drove it)."""
        ...

    def av_present(self) -> bool:
        """Whether the AV is still there."""
        ...

    def av_leaders(self) -> tuple[AgentId, ...] | None:
        """Whom the AV followed in the last step; None where nobody looked."""
        ...


@contextmanager
def opened(case: Case, model: VehicleModel | None, backend: Backend) -> Iterator[Stage]:
    """The stage of a case, standing at its current step."""
    opening: Callable[..., Any]
    if isinstance(case, TrafficCase):
        from deepmf_sumo.simulation.traffic_world import opening
    else:
        from deepmf_sumo.simulation.log_world import opening
    with opening(case, model, backend) as (api, stage):
        if backend != "gui":
            yield stage
            return
        from deepmf_sumo.simulation.gui import WatchedStage

        watched = WatchedStage(stage, api, case.av_id)
        yield watched
        watched.linger()
