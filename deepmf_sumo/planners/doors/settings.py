"""What all doors can be told."""

from pydantic import Field

from deepmf_sumo.datatypes.scene import HISTORY_STEPS
from deepmf_sumo.plugins import Settings


class DoorSettings(Settings):
    """Limits of a planner outside the simulation, and what it is told.

    Attributes:
        start_budget_s: wall time from the start of an episode to the planner's first answer.
        step_budget_s: wall time for one command.
        history_steps: how many steps a view shows, now included.
        road: whether the map is told at the beginning.
    """

    start_budget_s: float = Field(default=30.0, gt=0.0)
    step_budget_s: float = Field(default=1.0, gt=0.0)
    history_steps: int = Field(default=HISTORY_STEPS, ge=1, le=HISTORY_STEPS)
    road: bool = True
