"""The descent of `art`, and the perturbed future: the opponent's path, bent into the AV's.

The descent is Adam; then the perturbation is shrunk until it is within the bounds. Source: Zhang et
al., On Adversarial Robustness of Trajectory Prediction for Autonomous Vehicles, CVPR 2022. There a
perturbation has one free vector a point at 2 Hz, is bounded in length, and is shrunk in steps of a
hundredth until speed, acceleration and jerk are those of real vehicles. Here its points are at 2 Hz
too, with smooth interpolation, since free points at 10 Hz are only jitter; and values close to the
bounds have a cost, so that shrinking is rarely needed.

The points of a perturbed future are accelerations at 2 Hz, integrated twice: a change persists, so
that a gradient at the contact moves the whole path up to it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import DT_S, Bools, Floats
from deepmf_sumo.scene.geometry import frames

KNOT_STEPS = 5
"""Steps between the points of a perturbation: 2 Hz."""
GONE_M = 1e3
"""Distance to an absent AV."""

_RATE = 0.1
_DECAYS = (0.9, 0.999)
_PATIENCE = 20
_GAIN = 1e-3  # a smaller improvement does not count
_SCALES = np.linspace(1.0, 0.0, 101)
_SPAN = 2  # accelerations are second differences over 0.2 s, as metrics take them
_NEAR = 0.9  # share of a bound above which values have a cost
_STIFFNESS = (1.0, 3.0, 3.0, 0.3)  # of a squared excess: reach, speed, acceleration, jerk
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class PerturbationBounds:
    """Of a perturbed trajectory: largest move of a point, speed, acceleration and jerk."""

    reach_m: float
    speed_mps: float
    accel_mps2: float
    jerk_mps3: float

    def widened(self, base_m: Floats) -> "PerturbationBounds":
        """The bounds, widened to the values of the unperturbed trajectory (W, 2)."""
        speed, accel, jerk = _kinematics(torch.from_numpy(base_m))
        return PerturbationBounds(
            reach_m=self.reach_m,
            speed_mps=max(self.speed_mps, _largest(speed)),
            accel_mps2=max(self.accel_mps2, _largest(accel)),
            jerk_mps3=max(self.jerk_mps3, _largest(jerk)),
        )

    def allow(self, base_m: Floats, offset_m: Floats) -> Bools:
        """(...) whether a trajectory (W, 2) moved by offsets (..., W, 2) is within the bounds."""
        excess = self._excess(torch.from_numpy(base_m), torch.from_numpy(offset_m), 1 + _ROUNDING)
        fine: Bools = torch.stack([each.amax(-1) <= 0 for each in excess]).all(0).numpy()
        return fine

    def cost(self, base_m: Tensor, offset_m: Tensor) -> Tensor:
        """(R) weighted mean squares of the excess of offsets (R, W, 2) over 90 % of the bounds."""
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


class Effort(NamedTuple):
    """How long perturbations are looked for.

    Attributes:
        restarts: R, initial points from which one is looked for.
        iterations: maximum number; a descent ends after 20 without an improvement.
        deadline: `time.perf_counter` to stop at; the first iteration is always made.
    """

    restarts: int
    iterations: int
    deadline: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtDescent:
    """Best perturbations: points (R, N, 2), offsets (R, W, 2), and the number of iterations."""

    points: Floats
    offset_m: Floats
    iterations: int


def descend(
    loss: Callable[[Tensor], Tensor],
    base_m: Floats,
    basis: Floats,
    begin: Floats,
    bounds: PerturbationBounds,
    effort: Effort,
) -> ArtDescent:
    """Minimise a loss over perturbations of one trajectory, from R initial points together.

    Args:
        loss: (R, W, 2) offsets from the trajectory -> (R).
        base_m: (W, 2) the trajectory at 10 Hz, in order of time.
        basis: (W, N) effect of each point of a perturbation; zero for steps that are fixed.
        begin: (R, N, 2) initial points of the perturbations.
        bounds: widened to the values of the trajectory.
        effort: iterations and deadline.
    """
    _, iterations, deadline = effort
    bounds = bounds.widened(base_m)
    # Single precision: far from the origin it would not resolve centimetres.
    base, spread = single(base_m - base_m[0]), single(basis)
    points = single(_within(begin, base_m, basis, bounds)).requires_grad_()
    adam = Adam(points, _RATE)
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
        points = single(inside).requires_grad_()
        done += 1
    found = best.double().numpy()
    return ArtDescent(
        points=found, offset_m=np.einsum("wn,rnc->rwc", basis, found), iterations=done
    )


class Adam:
    """Adam (Kingma, Ba 2015); importing torch's takes seconds."""

    def __init__(self, points: Tensor, rate: float) -> None:
        self._rate = rate
        self._mean, self._square = torch.zeros_like(points), torch.zeros_like(points)
        self._steps = 0

    def step(self, gradient: Tensor) -> Tensor:
        """The step to subtract."""
        self._steps += 1
        self._mean = torch.lerp(self._mean, gradient, 1 - _DECAYS[0])
        self._square = torch.lerp(self._square, gradient.square(), 1 - _DECAYS[1])
        mean = self._mean / (1 - _DECAYS[0] ** self._steps)
        square = self._square / (1 - _DECAYS[1] ** self._steps)
        return self._rate * mean / (square.sqrt() + 1e-8)


def _within(points: Floats, base_m: Floats, basis: Floats, bounds: PerturbationBounds) -> Floats:
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
        # One more zero, so that a trajectory that is too short has a maximum.
        found.append(torch.nn.functional.pad(_length(change), (0, 1)))
    return found[0], found[1], found[2]


def _length(vector: Tensor) -> Tensor:
    """(...) lengths of vectors (..., 2), with a gradient at zero."""
    x, y = vector.unbind(-1)  # a sum over two is slow
    return (x * x + y * y).clamp_min(1e-12).sqrt()


def _largest(value: Tensor) -> float:
    return float(value.max())


def single(values: Floats) -> Tensor:
    """In single precision."""
    return torch.from_numpy(np.asarray(values, np.float32))


DEPTH_M = 0.4  # desired overlap of the boxes, so that tracking errors keep the contact
_EFFORT = 0.05  # metres of gap that an added acceleration of 1 m/s2 (mean square) is worth
_SOFT_M = 1.0  # width of the soft minimum over time
_BEFORE = 4  # steps before now for which the bounds hold
_FIRST = 10  # earliest step of a meeting
_MOVING_M = 0.05  # a step that is shorter gives no direction


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtTarget:
    """The AV's poses (K, 2), (K), whether it is present (K), and both footprints (2)."""

    position_m: Floats
    heading_rad: Floats
    there: Bools
    av_size_m: Floats
    own_size_m: Floats


def bend(
    reference_m: Floats,
    start: Start,
    target: ArtTarget,
    bounds: PerturbationBounds,
    effort: Effort,
    rng: np.random.Generator,
) -> ArtDescent:
    """Perturbations (R, K, 2) of a reference (K, 2) that bring it to the target.

    The first restart begins at the reference, the others at positions of the AV.
    """
    steps = len(reference_m)
    count = steps // KNOT_STEPS + 1
    behind = np.arange(_BEFORE, -1, -1)[:, None] * DT_S * start.speed_mps
    before = start.position_m - behind * frames.unit(start.course_rad)
    fixed = len(before)
    gap = _Gap(reference_m, start.heading_rad, target)

    def loss(offset: Tensor) -> Tensor:
        own = offset[:, fixed:]
        added = torch.diff(offset[:, fixed - 2 :], n=2, dim=1) / DT_S**2
        return torch.relu(gap.soft(own) + DEPTH_M) + _EFFORT * added.square().sum(-1).mean(-1)

    found = descend(
        loss,
        np.concatenate([before, reference_m]),
        np.concatenate([np.zeros((fixed, count)), _integrals(steps, count)]),
        _beginnings(reference_m, target, effort.restarts, count, rng),
        bounds,
        effort,
    )
    return ArtDescent(
        points=found.points, offset_m=found.offset_m[:, fixed:], iterations=found.iterations
    )


def _integrals(steps: int, count: int) -> Floats:
    """(steps, count) moves by accelerations at 0, 0.5, ... s, linear in between."""
    time = np.arange(steps + 1) / KNOT_STEPS
    accel = np.maximum(1 - np.abs(time[:, None] - np.arange(count)), 0.0)
    accel[time > count - 1, -1] = 1.0
    speed = np.cumsum((accel[1:] + accel[:-1]) / 2 * DT_S, axis=0)
    before = np.concatenate([np.zeros((1, count)), speed[:-1]])
    return np.cumsum((before + speed) / 2 * DT_S, axis=0)


def _beginnings(
    reference_m: Floats, target: ArtTarget, restarts: int, count: int, rng: np.random.Generator
) -> Floats:
    """(R, count, 2) accelerations: none, and of moves that meet the AV at some time.

    The times are drawn one from each of R - 1 equal parts of the time that the AV is there.
    """
    begin = np.zeros((restarts, count, 2))
    seen = np.flatnonzero(target.there)
    if len(seen) == 0:
        return begin
    points = np.arange(count) * KNOT_STEPS
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

    def __init__(self, reference_m: Floats, heading_rad: float, target: ArtTarget) -> None:
        # Single precision: far from the origin it would not resolve centimetres.
        origin = reference_m[0]
        self._reference = single(reference_m - origin)
        self._still = single(frames.unit(heading_rad))
        self._places = single(circles(target.own_size_m))
        self._radii = float(target.own_size_m[1] + target.av_size_m[1]) / 2
        ahead = frames.unit(target.heading_rad)[:, None]
        places = circles(target.av_size_m)[:, None]
        self._av = single(target.position_m[:, None] - origin + places * ahead)  # (K, 3, 2)
        self._gone = torch.from_numpy(~target.there)

    def soft(self, offset: Tensor) -> Tensor:
        """(R) soft minimum over time of the gap, of offsets (R, K, 2)."""
        position = self._reference + offset
        ahead = self._directions(position)
        own = position.unsqueeze(2) + self._places[:, None] * ahead.unsqueeze(2)  # (R, K, 3, 2)
        apart = (own.unsqueeze(3) - self._av.unsqueeze(1)).norm(dim=-1)  # (R, K, 3, 3)
        gap = (apart.flatten(2).amin(-1) - self._radii).masked_fill(self._gone, GONE_M)
        share = (-gap.detach() / _SOFT_M).softmax(-1)
        nearest: Tensor = (share * gap).sum(-1)
        return nearest

    def _directions(self, position: Tensor) -> Tensor:
        """(R, K, 2) unit vectors along the motion; the present heading where it stands."""
        step = torch.diff(position, dim=1)
        step = torch.cat([step[:, :1], step], 1) if step.shape[1] else torch.zeros_like(position)
        length = step.norm(dim=-1, keepdim=True)
        return torch.where(length > _MOVING_M, step / length.clamp_min(_MOVING_M), self._still)


def circles(size_m: Floats) -> Floats:
    """(3) centres of three circles along a box, from its own centre."""
    reach = max(float(size_m[0] - size_m[1]) / 2, 0.0)
    return np.array([-reach, 0.0, reach])
