"""What a planner or a policy sees: the present and the last second, never the future."""

from dataclasses import dataclass

from deepmf_sumo.datatypes.arrays import Floats
from deepmf_sumo.datatypes.road import RoadMap, SignalState
from deepmf_sumo.datatypes.scene import AgentId, Tracks


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """The world at one step.

    Attributes:
        step: index on the scene's time axis; the last row of ``history`` is this step.
        history: (A, H) tracks with H = 11, as they really happened in the simulation; only agents
            that are valid at the current step.
        signals: lane id -> state as it is now.
        steps_left: steps until the case ends.
        av_path_m: (P, 2) centre line ahead of the AV. Given to planners alone: policies get None.
        av_recorded_steps: of the last 10 steps those in which the AV moved as recorded: a planner
            that has just taken over goes on otherwise than its history says.
    """

    step: int
    dt_s: float
    av_id: AgentId
    history: Tracks
    road: RoadMap
    signals: dict[str, SignalState]
    steps_left: int
    av_path_m: Floats | None = None
    av_recorded_steps: int = 0
