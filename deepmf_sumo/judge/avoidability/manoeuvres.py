"""Evasive manoeuvres: about a hundred that a car could have started without delay.

Each brakes with a constant deceleration (0 keeps the speed), or drives as the AV did, and swerves
with a constant lateral acceleration to one side up to a target offset, where it goes on beside its
path. The model is kinematic: the grip of the tyres is 8 m/s2 in total (a dry road), and the turning
circle of the rear axle has a radius of 5 m.
"""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.judge.avoidability.av_path import AvPath
from deepmf_sumo.scene import Bools, Floats

GRIP_MPS2: Final = 8.0
LATERAL_MPS2: Final = 6.0
BRAKING_MPS2: Final = (0.0, 2.0, 4.0, 6.0, GRIP_MPS2)
_SWERVES_MPS2 = (2.0, 4.0, LATERAL_MPS2)
_OFFSETS_M = (0.5, 1.0, 2.0, 3.5)
_RADIUS_M = 5.0
_SLOPE = 0.5  # largest angle between car and path, as a tangent
_BEND_M = 4.0
_SHARPEST = 1 / _RADIUS_M


class Manoeuvres(NamedTuple):
    """M manoeuvres: deceleration, lateral acceleration, target offset to the left; each (M).

    ``as_driven``: (M) along the path as the AV, instead of braking.
    """

    braking_mps2: Floats
    lateral_mps2: Floats
    offset_m: Floats
    as_driven: Bools


class ManoeuvrePaths(NamedTuple):
    """M manoeuvres over K steps, and whether their grip is enough in the path's bends.

    ``along_m``, ``left_m``: (M, K) on the path. ``centre_m`` (M, K, 2), ``heading_rad`` (M, K): of
    the box. ``holds``: (M).
    """

    along_m: Floats
    left_m: Floats
    centre_m: Floats
    heading_rad: Floats
    holds: Bools


def _grid() -> Manoeuvres:
    swerves = [
        (lateral, side * offset)
        for lateral in _SWERVES_MPS2
        for offset in _OFFSETS_M
        for side in (1.0, -1.0)
    ]
    rows = [
        (braking, lateral, offset, as_driven)
        for braking, as_driven in [(0.0, True), *((braking, False) for braking in BRAKING_MPS2)]
        for lateral, offset in [(0.0, 0.0), *swerves]
        if np.hypot(braking, lateral) <= GRIP_MPS2
    ]
    braking, lateral, offset, as_driven = (np.array(column) for column in zip(*rows, strict=True))
    return Manoeuvres(braking, lateral, offset, as_driven)


GRID: Final = _grid()
"""All manoeuvres within the grip of the tyres on a straight road."""


def drive(path: AvPath, av_along_m: Floats, dt_s: float) -> ManoeuvrePaths:
    """All of `GRID` from the first of the arc lengths (K), K > 1, at which the AV was."""
    along, speed = _along(av_along_m, dt_s)
    left, aside = _aside(speed, dt_s)
    on_path, heading = path.at(along)
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    return ManoeuvrePaths(
        along_m=along,
        left_m=left,
        centre_m=on_path + left[..., None] * normal,
        heading_rad=heading + np.arctan2(aside, np.maximum(speed, 1e-3)),
        holds=_holds(path, along, speed),
    )


def _along(av_along_m: Floats, dt_s: float) -> tuple[Floats, Floats]:
    """(M, K) arc lengths and speeds: as driven, or under constant braking until standstill."""
    speeds = np.maximum(np.gradient(av_along_m, dt_s), 0.0)
    braking = GRID.braking_mps2[:, None]
    stands_s = np.where(braking > 0, speeds[0] / np.where(braking > 0, braking, 1.0), np.inf)
    moving_s = np.minimum(np.arange(len(speeds)) * dt_s, stands_s)
    along = av_along_m[0] + speeds[0] * moving_s - braking * moving_s**2 / 2
    speed = np.maximum(speeds[0] - braking * moving_s, 0.0)
    driven = GRID.as_driven[:, None]
    return np.where(driven, av_along_m, along), np.where(driven, speeds, speed)


def _aside(speed_mps: Floats, dt_s: float) -> tuple[Floats, Floats]:
    """(M, K) offset to the left and its rate: swerve, then straighten to end at the offset.

    At low speed the steering angle limits the swerve; a car that stands does not move sideways.
    """
    wanted, hardest = np.abs(GRID.offset_m), GRID.lateral_mps2
    offset, rate = np.zeros_like(speed_mps), np.zeros_like(speed_mps)
    for step in range(speed_mps.shape[1] - 1):
        speed = speed_mps[:, step]
        lateral = np.minimum(hardest, speed**2 * _SHARPEST)
        rest = np.maximum(wanted - offset[:, step], 0.0)
        # the fastest sidewards motion, kept for a step, from which the remaining
        # distance is enough to straighten
        lost = lateral * dt_s
        allowed = np.sqrt(lost**2 + 2 * lateral * rest) - lost
        faster = np.minimum(rate[:, step] + lost, speed_mps[:, step + 1] * _SLOPE)
        rate[:, step + 1] = np.minimum(faster, allowed)
        offset[:, step + 1] = offset[:, step] + rate[:, step + 1] * dt_s
    side = np.sign(GRID.offset_m)[:, None]
    return side * offset, side * rate


def _holds(path: AvPath, along_m: Floats, speed_mps: Floats) -> Bools:
    """(M) whether braking, swerve and the path's bends together stay within the tyres' grip.

    Braking below the maximum is never excluded because of a bend only: the AV drove there as well.
    """
    bend = np.abs(path.at(along_m + _BEND_M / 2)[1] - path.at(along_m - _BEND_M / 2)[1]) / _BEND_M
    turning = np.minimum(bend * speed_mps**2, GRIP_MPS2)
    swerving, braking = GRID.lateral_mps2[:, None], GRID.braking_mps2[:, None]
    moving = speed_mps > 0
    needed = np.where(moving, np.hypot(turning + swerving, braking), 0.0)
    gentle = (GRID.lateral_mps2 == 0) & (GRID.braking_mps2 <= BRAKING_MPS2[-2])
    return gentle | (needed.max(axis=1) <= GRIP_MPS2 + 0.5)
