"""ART on the opponent's future: its un-attacked way, bent into the AV's.

The points of the perturbation are accelerations at 2 Hz, integrated twice: what changes at one time
carries on, so that a gradient at the contact moves all of the way there.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.adversaries.gradients import art_descent
from deepmf_sumo.adversaries.gradients.art_descent import Bounds, Descent
from deepmf_sumo.datatypes import DT_S, Bools, Floats
from deepmf_sumo.geometry import angles
from deepmf_sumo.policies.factorization.tracking import Start

_DEPTH_M = 0.4  # boxes shall overlap by this, so that tracking errors do not undo the contact
_EFFORT = 0.05  # metres of gap that an added acceleration of 1 m/s2 (mean square) is worth
_SOFT_M = 1.0  # width of the soft minimum over time
_GONE_M = 1e3  # gap to an AV that is not there
_BEFORE = 4  # steps before now that the bounds look at
_FIRST = 10  # steps: nothing is met earlier
_MOVING_M = 0.05  # a step that is shorter gives no direction


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """The AV's poses (K, 2), (K), where it is there (K), and both footprints (2)."""

    position_m: Floats
    heading_rad: Floats
    there: Bools
    av_size_m: Floats
    own_size_m: Floats


def bend(
    reference_m: Floats,
    start: Start,
    target: Target,
    bounds: Bounds,
    restarts: int,
    iterations: int,
    deadline: float,
    rng: np.random.Generator,
) -> Descent:
    """Perturbations (R, K, 2) of a reference (K, 2) that bring it to the target.

    The first restart begins at the reference, the others where the AV is at some time.
    """
    steps = len(reference_m)
    count = steps // art_descent.KNOT_STEPS + 1
    behind = np.arange(_BEFORE, -1, -1)[:, None] * DT_S * start.speed_mps
    before = start.position_m - behind * angles.unit(start.course_rad)
    fixed = len(before)
    gap = _Gap(reference_m, start.heading_rad, target)

    def loss(offset: Tensor) -> Tensor:
        own = offset[:, fixed:]
        added = torch.diff(offset[:, fixed - 2 :], n=2, dim=1) / DT_S**2
        return torch.relu(gap.soft(own) + _DEPTH_M) + _EFFORT * added.square().sum(-1).mean(-1)

    found = art_descent.descend(
        loss,
        np.concatenate([before, reference_m]),
        np.concatenate([np.zeros((fixed, count)), _integrals(steps, count)]),
        _beginnings(reference_m, target, restarts, count, rng),
        bounds,
        iterations,
        deadline,
    )
    return Descent(
        points=found.points, offset_m=found.offset_m[:, fixed:], iterations=found.iterations
    )


def _integrals(steps: int, count: int) -> Floats:
    """(steps, count) moves by accelerations at 0, 0.5, ... s, linear in between."""
    time = np.arange(steps + 1) / art_descent.KNOT_STEPS
    accel = np.maximum(1 - np.abs(time[:, None] - np.arange(count)), 0.0)
    accel[time > count - 1, -1] = 1.0
    speed = np.cumsum((accel[1:] + accel[:-1]) / 2 * DT_S, axis=0)
    before = np.concatenate([np.zeros((1, count)), speed[:-1]])
    return np.cumsum((before + speed) / 2 * DT_S, axis=0)


def _beginnings(
    reference_m: Floats, target: Target, restarts: int, count: int, rng: np.random.Generator
) -> Floats:
    """(R, count, 2) accelerations: none, and of moves that meet the AV at some time.

    The times are drawn one from each of R - 1 equal parts of the time that the AV is there.
    """
    begin = np.zeros((restarts, count, 2))
    seen = np.flatnonzero(target.there)
    if len(seen) == 0:
        return begin
    points = np.arange(count) * art_descent.KNOT_STEPS
    for row in range(1, restarts):
        part = (row - 1 + rng.uniform()) / (restarts - 1)
        step = seen[int(part * len(seen))]
        steps = max(int(step) + 1, _FIRST)
        share = np.minimum(points / steps, 1.0)
        bend = 60 * share - 180 * share**2 + 120 * share**3  # of the quintic step from 0 to 1
        move = target.position_m[step] - reference_m[step]
        begin[row] = bend[:, None] * move / (steps * DT_S) ** 2
    return begin


class _Gap:
    """Differentiable gap of two boxes, each three circles as wide as the box."""

    def __init__(self, reference_m: Floats, heading_rad: float, target: Target) -> None:
        # Single precision: far from the origin it would not resolve centimetres.
        origin = reference_m[0]
        self._reference = _single(reference_m - origin)
        self._still = _single(angles.unit(heading_rad))
        self._places = _single(_circles(target.own_size_m))
        self._radii = float(target.own_size_m[1] + target.av_size_m[1]) / 2
        ahead = angles.unit(target.heading_rad)[:, None]
        places = _circles(target.av_size_m)[:, None]
        self._av = _single(target.position_m[:, None] - origin + places * ahead)  # (K, 3, 2)
        self._gone = torch.from_numpy(~target.there)

    def soft(self, offset: Tensor) -> Tensor:
        """(R) soft minimum over time of the gap, of offsets (R, K, 2)."""
        position = self._reference + offset
        ahead = self._directions(position)
        own = position.unsqueeze(2) + self._places[:, None] * ahead.unsqueeze(2)  # (R, K, 3, 2)
        apart = (own.unsqueeze(3) - self._av.unsqueeze(1)).norm(dim=-1)  # (R, K, 3, 3)
        gap = (apart.flatten(2).amin(-1) - self._radii).masked_fill(self._gone, _GONE_M)
        share = (-gap.detach() / _SOFT_M).softmax(-1)
        nearest: Tensor = (share * gap).sum(-1)
        return nearest

    def _directions(self, position: Tensor) -> Tensor:
        """(R, K, 2) unit vectors along the motion; the present heading where it stands."""
        step = torch.diff(position, dim=1)
        step = torch.cat([step[:, :1], step], 1) if step.shape[1] else torch.zeros_like(position)
        length = step.norm(dim=-1, keepdim=True)
        return torch.where(length > _MOVING_M, step / length.clamp_min(_MOVING_M), self._still)


def _circles(size_m: Floats) -> Floats:
    """(3) centres of three circles along a box, from its own centre."""
    reach = max(float(size_m[0] - size_m[1]) / 2, 0.0)
    return np.array([-reach, 0.0, reach])


def _single(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
