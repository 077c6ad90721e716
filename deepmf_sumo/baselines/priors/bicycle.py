"""Accelerations and path curvatures -> poses that a car can drive: a kinematic bicycle.

Controls are given every 0.5 s and joined linearly, so that accelerations have no jumps; speed and
yaw rate are bounded, so that no control leaves what tyres can do.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

STEP_S: Final = 0.1
SUBSTEPS: Final = 5
"""Simulated steps between two controls: 0.5 s."""
CONTROLS: Final = 16
ACCEL_MPS2: Final = 4.0
BRAKE_MPS2: Final = 7.0
LATERAL_MPS2: Final = 4.5
CURVATURE_PER_M: Final = 0.18
"""At walking speed: a turning circle of 11 m."""


class BicycleState(NamedTuple):
    """Of agents (...): position (..., 2), heading, speed, acceleration, curvature."""

    position: Tensor
    heading: Tensor
    speed: Tensor
    acceleration: Tensor
    curvature: Tensor


class Leg(NamedTuple):
    """The five steps that follow a control: positions (..., 5, 2), headings and speeds (..., 5)."""

    position: Tensor
    heading: Tensor
    speed: Tensor


def start(motion: Tensor) -> BicycleState:
    """Agents at the origin, heading along +x; motion (..., 3): speed, acceleration, yaw rate."""
    speed, acceleration, yaw_rate = motion.unbind(-1)
    limit = curvature_limit(speed)
    return BicycleState(
        position=torch.zeros_like(motion[..., :2]),
        heading=torch.zeros_like(speed),
        speed=speed,
        acceleration=acceleration.clamp(-BRAKE_MPS2, ACCEL_MPS2),
        curvature=(yaw_rate / speed.clamp_min(2.0)).clamp(-limit, limit),
    )


def curvature_limit(speed: Tensor) -> Tensor:
    """Largest curvature at a speed: the turning circle's, and what the lateral limit leaves."""
    return 1.0 / (1.0 / CURVATURE_PER_M + speed**2 / LATERAL_MPS2)


def controlled(raw: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
    """Acceleration and curvature from two free numbers (..., 2); zero gives zero."""
    gas, steer = raw.unbind(-1)
    gain = torch.tanh(gas)
    acceleration = torch.where(gain > 0, ACCEL_MPS2 * gain, BRAKE_MPS2 * gain)
    return acceleration, torch.tanh(steer) * curvature_limit(speed)


def advance(
    state: BicycleState, acceleration: Tensor, curvature: Tensor
) -> tuple[BicycleState, Leg]:
    """0.5 s on, from the state's controls to the new ones."""
    share = torch.linspace(0.5, SUBSTEPS - 0.5, SUBSTEPS, device=state.speed.device) / SUBSTEPS
    along = _between(state.acceleration, acceleration, share)
    speed = (state.speed.unsqueeze(-1) + (along * STEP_S).cumsum(-1)).clamp_min(0.0)
    before = torch.cat([state.speed.unsqueeze(-1), speed[..., :-1]], -1)
    driven = (before + speed) / 2 * STEP_S
    bend = _between(state.curvature, curvature, share)
    limit = curvature_limit(speed)
    turned = (bend.clamp(-limit, limit) * driven).cumsum(-1)
    heading = state.heading.unsqueeze(-1) + turned
    middle = state.heading.unsqueeze(-1) + turned - bend.clamp(-limit, limit) * driven / 2
    moved = torch.stack([middle.cos(), middle.sin()], -1) * driven.unsqueeze(-1)
    position = state.position.unsqueeze(-2) + moved.cumsum(-2)
    end = BicycleState(
        position[..., -1, :], heading[..., -1], speed[..., -1], acceleration, curvature
    )
    return end, Leg(position, heading, speed)


def _between(first: Tensor, last: Tensor, share: Tensor) -> Tensor:
    """(..., 5) values from the first to the last."""
    return first.unsqueeze(-1) + (last - first).unsqueeze(-1) * share
