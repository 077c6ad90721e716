"""Car following: the Intelligent Driver Model (Treiber, Hennecke, Helbing, Phys. Rev. E 62, 2000).

A driver accelerates by ``a (1 - (v / v0)^delta - (s* / s)^2)``, at speed v, with the gap s to the
leader and the gap ``s*`` that it desires. SUMO drives the AV and recorded vehicles by it
(``carFollowModel="IDM"``). What imagines a driver without SUMO takes parameters and desired gap
from here: the reactions of `deepmf.networks.condition`, the stand-in of `baselines.king`, and
planners of studies.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any, Final


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleModel:
    """Parameters of SUMO's IDM for the AV.

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


TREIBER: Final = VehicleModel(
    accel_mps2=1.5, decel_mps2=2.0, emergency_mps2=8.0, headway_s=1.5, gap_m=2.0, exponent=4.0
)
"""In the range of the paper's cars; braking capped at 8 m/s2."""


def desired_gap_m(
    model: VehicleModel, speed_mps: Any, leader_mps: Any, positive: Callable[[Any], Any]
) -> Any:
    """The gap ``s*`` that a driver desires behind a leader, in metres.

    Args:
        model: the driver.
        speed_mps: its speed, of any shape; a number, an array or a tensor.
        leader_mps: the leader's, of the same shape.
        positive: of such a value, with 0 in the place of negative ones.
    """
    brisk = 2 * sqrt(model.accel_mps2 * model.decel_mps2)
    keep = speed_mps * model.headway_s + speed_mps * (speed_mps - leader_mps) / brisk
    return model.gap_m + positive(keep)
