"""What a planner asks of the AV, in words that the simulation can carry out."""

from dataclasses import dataclass
from typing import Literal

from deepmf_sumo.datatypes.scene import AgentId


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleModel:
    """Parameters of SUMO's IDM for the AV (Treiber, Hennecke, Helbing 2000).

    Attributes:
        desired_mps: None takes the larger of the speed limit and the recorded maximum.
        emergency_mps2: hardest braking that the model may command.
    """

    accel_mps2: float
    decel_mps2: float
    emergency_mps2: float
    headway_s: float
    gap_m: float
    exponent: float
    desired_mps: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One step of the AV.

    Attributes:
        kind: ``pose`` places the AV; ``sumo`` lets SUMO's own model drive; ``leader`` asks SUMO's
            model for the speed behind the given leader and drives at it; ``speed`` drives along the
            route at ``speed_mps``.
        x_m, y_m, heading_rad, speed_mps: the pose after the step (``pose``); of ``speed`` the last
            alone.
        gap_m: bumper to leader, metres (``leader``).
        leader_mps: the leader's speed along the AV's path, signed (``leader``).
        leader_id: whom the planner reacts to, if it knows; only recorded.
    """

    kind: Literal["pose", "sumo", "leader", "speed"]
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    speed_mps: float = 0.0
    gap_m: float = 0.0
    leader_mps: float = 0.0
    leader_id: AgentId | None = None
