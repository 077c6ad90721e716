"""Bounded perturbation of a trajectory by gradient: Adam, then shrunk until within the bounds.

Source: Zhang et al., On Adversarial Robustness of Trajectory Prediction for Autonomous Vehicles,
CVPR 2022. There a perturbation has one free vector a point at 2 Hz, is bounded in length, and is
shrunk in steps of a hundredth until speed, acceleration and jerk are those of real vehicles. Here
its points are at 2 Hz too and what lies between them is smooth, since free points at 10 Hz are
nothing but jitter; and what nears the bounds costs, so that shrinking is seldom needed.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.datatypes import DT_S, Bools, Floats

KNOT_STEPS = 5
"""Steps between the points of a perturbation: 2 Hz."""

_RATE = 0.1
_DECAYS = (0.9, 0.999)
_PATIENCE = 20
_GAIN = 1e-3  # a smaller improvement is none
_SCALES = np.linspace(1.0, 0.0, 101)
_SPAN = 2  # accelerations are second differences over 0.2 s, as metrics take them
_NEAR = 0.9  # of a bound: what exceeds it costs
_STIFFNESS = (1.0, 3.0, 3.0, 0.3)  # of a squared excess: reach, speed, acceleration, jerk
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Of a perturbed trajectory: largest move of a point, speed, acceleration and jerk."""

    reach_m: float
    speed_mps: float
    accel_mps2: float
    jerk_mps3: float

    def widened(self, base_m: Floats) -> "Bounds":
        """At least what the unperturbed trajectory (W, 2) has by itself."""
        speed, accel, jerk = _kinematics(torch.from_numpy(base_m))
        return Bounds(
            reach_m=self.reach_m,
            speed_mps=max(self.speed_mps, _largest(speed)),
            accel_mps2=max(self.accel_mps2, _largest(accel)),
            jerk_mps3=max(self.jerk_mps3, _largest(jerk)),
        )

    def allow(self, base_m: Floats, offset_m: Floats) -> Bools:
        """(...) whether a trajectory (W, 2) moved by offsets (..., W, 2) is within."""
        excess = self._excess(torch.from_numpy(base_m), torch.from_numpy(offset_m), 1 + _ROUNDING)
        fine: Bools = torch.stack([each.amax(-1) <= 0 for each in excess]).all(0).numpy()
        return fine

    def cost(self, base_m: Tensor, offset_m: Tensor) -> Tensor:
        """(R) mean squares of what offsets (R, W, 2) lack to nine tenths of the bounds."""
        excess = self._excess(base_m, offset_m, _NEAR)
        terms = [
            weight * each.square().mean(-1) for weight, each in zip(_STIFFNESS, excess, strict=True)
        ]
        return torch.stack(terms).sum(0)

    def _excess(self, base: Tensor, offset: Tensor, share: float) -> list[Tensor]:
        """Four of (..., K): by how much reach, speed, acceleration, jerk exceed their share."""
        values = (_length(offset), *_kinematics(base + offset))
        limits = (self.reach_m, self.speed_mps, self.accel_mps2, self.jerk_mps3)
        return [
            torch.relu(value - share * limit) for value, limit in zip(values, limits, strict=True)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Descent:
    """Best perturbations: points (R, N, 2), offsets (R, W, 2), and the iterations made."""

    points: Floats
    offset_m: Floats
    iterations: int


def descend(
    loss: Callable[[Tensor], Tensor],
    base_m: Floats,
    basis: Floats,
    begin: Floats,
    bounds: Bounds,
    iterations: int,
    deadline: float,
) -> Descent:
    """Minimise a loss over perturbations of one trajectory, from R beginnings at once.

    Args:
        loss: (R, W, 2) offsets from the trajectory -> (R).
        base_m: (W, 2) the trajectory at 10 Hz, in order of time.
        basis: (W, N) what each point of a perturbation moves; zero where nothing may move.
        begin: (R, N, 2) points of the perturbations to begin with.
        bounds: widened to what the trajectory has by itself.
        iterations: at most so many; fewer where none of the last 20 gained anything.
        deadline: `time.perf_counter` to stop at; the first iteration is always made.
    """
    bounds = bounds.widened(base_m)
    # Single precision: far from the origin it would not resolve centimetres.
    base, spread = _single(base_m - base_m[0]), _single(basis)
    points = _single(_within(begin, base_m, basis, bounds)).requires_grad_()
    adam = _Adam(points)
    best, least = points.detach().clone(), torch.full((len(begin),), torch.inf)
    idle = done = 0
    while done < iterations and idle < _PATIENCE and (not done or time.perf_counter() < deadline):
        offset = torch.einsum("wn,rnc->rwc", spread, points)
        value = loss(offset) + bounds.cost(base, offset)
        better = value.detach() < least - _GAIN
        least = torch.where(better, value.detach(), least)
        best[better] = points.detach()[better]
        idle = 0 if better.any() else idle + 1
        # Of the points alone: a network's parameters keep no gradients.
        (gradient,) = torch.autograd.grad(value.sum(), points)
        stepped = points.detach() - adam.step(gradient)
        inside = _within(stepped.double().numpy(), base_m, basis, bounds)
        points = _single(inside).requires_grad_()
        done += 1
    found = best.double().numpy()
    return Descent(points=found, offset_m=np.einsum("wn,rnc->rwc", basis, found), iterations=done)


class _Adam:
    """Adam (Kingma, Ba 2015); that of torch takes seconds to be imported."""

    def __init__(self, points: Tensor) -> None:
        self._mean, self._square = torch.zeros_like(points), torch.zeros_like(points)
        self._steps = 0

    def step(self, gradient: Tensor) -> Tensor:
        """What to subtract."""
        self._steps += 1
        self._mean = torch.lerp(self._mean, gradient, 1 - _DECAYS[0])
        self._square = torch.lerp(self._square, gradient.square(), 1 - _DECAYS[1])
        mean = self._mean / (1 - _DECAYS[0] ** self._steps)
        square = self._square / (1 - _DECAYS[1] ** self._steps)
        return _RATE * mean / (square.sqrt() + 1e-8)


def _within(points: Floats, base_m: Floats, basis: Floats, bounds: Bounds) -> Floats:
    """The perturbations, each scaled by the largest hundredth that is within the bounds."""
    offset = np.einsum("wn,rnc->rwc", basis, points)
    out = np.flatnonzero(~bounds.allow(base_m, offset))
    if len(out) == 0:
        return points
    fine = bounds.allow(base_m, _SCALES[:, None, None, None] * offset[out])  # (S, out)
    scaled = points.copy()
    scaled[out] *= _SCALES[fine.argmax(axis=0)][:, None, None]
    return scaled


def _kinematics(position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(..., K) speeds, accelerations and jerks of trajectories (..., W, 2); K differs."""
    found = []
    change = position
    for _ in range(3):
        change = (change[..., _SPAN:, :] - change[..., :-_SPAN, :]) / (_SPAN * DT_S)
        # One zero more, so that a trajectory that is too short has a largest value.
        found.append(torch.nn.functional.pad(_length(change), (0, 1)))
    return found[0], found[1], found[2]


def _length(vector: Tensor) -> Tensor:
    """(...) lengths of vectors (..., 2), with a gradient at zero."""
    x, y = vector.unbind(-1)  # a sum over two is slow
    return (x * x + y * y).clamp_min(1e-12).sqrt()


def _largest(value: Tensor) -> float:
    return float(value.max())


def _single(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
