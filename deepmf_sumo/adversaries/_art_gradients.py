"""Gradient descents of `art`: the perturbed future and the perturbed history.

**The history**: what the marginal predictor is given as the opponent's last second. The present
stays as it is, for the simulation cannot undo it: position, heading and velocity now, and with them
the frame, the paths and the lanes. What depends on the past is rebuilt in torch, so that gradients
reach it: the vehicle's own vectors, its acceleration and its yaw rate. The image, which shows the
box a second ago on a grid of metres, stays constant during the descent; what is predicted in the
end is predicted from the perturbed history, image and all.

**The descent**: Adam, then the perturbation is shrunk until it is within the bounds. Source: Zhang
et al., On Adversarial Robustness of Trajectory Prediction for Autonomous Vehicles, CVPR 2022. There
a perturbation has one free vector a point at 2 Hz, is bounded in length, and is shrunk in steps of
a hundredth until speed, acceleration and jerk are those of real vehicles. Here its points are at 2
Hz too and what lies between them is smooth, since free points at 10 Hz are nothing but jitter; and
what nears the bounds costs, so that shrinking is seldom needed.

**The future**: the opponent's unattacked path, bent into the AV's. The points of the perturbation
are accelerations at 2 Hz, integrated twice: what changes at one time carries on, so that a gradient
at the contact moves all of the way there.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, HISTORY_STEPS, AgentId, Bools, Floats, View
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.geometry import frames
from deepmf_sumo.geometry.slow import DIRECTION_MPS
from deepmf_sumo.predictors import anchors
from deepmf_sumo.predictors.decoding import as_batch
from deepmf_sumo.predictors.densetnt import DenseTNT, Goals
from deepmf_sumo.predictors.features import features
from deepmf_sumo.predictors.kinematics import pose_of

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


_NEAR_M = 3.0  # a goal that comes so much nearer to the AV counts e times as much
_GONE_M = 1e3  # distance to an AV that is not there
_EVERY = 4  # goals are compared with the AV every 0.4 s
_BACK = 5  # acceleration and yaw rate are those of the last half second


def perturb(
    view: View,
    agent_id: AgentId,
    net: DenseTNT,
    av_m: Floats,
    there: Bools,
    bounds: Bounds,
    restarts: int,
    iterations: int,
    deadline: float,
    rng: np.random.Generator,
) -> Descent:
    """Perturbations (R, 11, 2) of an agent's history that make goals near the AV likelier.

    ``av_m`` (K, 2) are the AV's positions from the next step on, ``there`` (K) where it is there.
    The first restart begins at the history, the others at random.
    """
    past = Past(view, agent_id, net)
    begin = rng.normal(scale=bounds.reach_m / 2, size=(restarts, past.basis.shape[1], 2))
    begin[0] = 0.0
    meeting = Meeting(view, agent_id, av_m, there)
    known = torch.from_numpy(np.flatnonzero(past.known))

    def loss(offset: Tensor) -> Tensor:
        whole = offset.new_zeros(len(offset), HISTORY_STEPS, 2).index_copy(1, known, offset)
        return meeting.loss(net(past.batch(whole)))

    found = descend(
        loss,
        view.history.position_m[view.history.row(agent_id), past.known],
        past.basis[past.known],
        begin,
        bounds,
        iterations,
        deadline,
    )
    offset = np.einsum("wn,rnc->rwc", past.basis, found.points)
    return Descent(points=found.points, offset_m=offset, iterations=found.iterations)


class Past:
    """An agent's history as a function of offsets (R, 11, 2), now last, in the scene's frame.

    Raises KeyError for an agent that is not in view.

    Attributes:
        known: (11) the last uninterrupted stretch of steps up to now; others do not move.
        basis: (11, 2) what moves with points half a second and a second ago; now stays.
    """

    def __init__(self, view: View, agent_id: AgentId, net: DenseTNT) -> None:
        tracks = view.history
        self._view, self._row = view, tracks.row(agent_id)
        self._arrays = as_batch(features(view, agent_id, net.preset)[0])
        self._heading = pose_of(view, agent_id).heading_rad
        valid = tracks.valid[self._row]
        self._back = int(np.flatnonzero(valid)[max(-_BACK - 1, -int(valid.sum()))])
        self.known: Bools = np.logical_and.accumulate(valid[::-1])[::-1].copy()
        self.basis: Floats = np.where(self.known[:, None], _spline(), 0.0)

    def batch(self, offset: Tensor) -> dict[str, Tensor]:
        """`features.Features` of R perturbed histories, differentiable in the offsets."""
        batch = {
            name: values.expand(len(offset), *values.shape[1:])
            for name, values in self._arrays.items()
        }
        cos, sin = np.cos(self._heading), np.sin(self._heading)
        local = offset @ offset.new_tensor([[cos, -sin], [sin, cos]])
        states = self._states(self._arrays["agents"][0, 0], local)
        batch["agents"] = torch.cat([states.unsqueeze(1), batch["agents"][:, 1:]], 1)
        batch["motion"] = self._motion(batch["motion"], states)
        return batch

    def view(self, offset_m: Floats) -> View:
        """The view with the history moved by offsets (11, 2)."""
        tracks, row = self._view.history, self._row
        own = np.zeros((HISTORY_STEPS, 7))
        own[:, 0:2], own[:, 4:6] = tracks.position_m[row], tracks.velocity_mps[row]
        own[:, 2:4] = frames.unit(tracks.heading_rad[row])
        moved = self._states(torch.from_numpy(own), torch.from_numpy(offset_m)[None])[0].numpy()
        position, velocity = tracks.position_m.copy(), tracks.velocity_mps.copy()
        heading = tracks.heading_rad.copy()
        position[row], velocity[row] = moved[:, 0:2], moved[:, 4:6]
        heading[row] = np.arctan2(moved[:, 3], moved[:, 2])
        history = replace(tracks, position_m=position, heading_rad=heading, velocity_mps=velocity)
        return replace(self._view, history=history)

    def _states(self, own: Tensor, offset: Tensor) -> Tensor:
        """(R, 11, 7) states (11, 7) of `features.Features` moved by offsets of the same frame."""
        rate = torch.zeros_like(offset)
        first = int(self.known.argmax())
        if first < HISTORY_STEPS - 2:
            inner = offset[:, first:]
            oldest = (inner[:, 1:2] - inner[:, :1]) / DT_S
            between = (inner[:, 2:] - inner[:, :-2]) / (2 * DT_S)
            # The velocity now stays.
            rate = torch.cat([rate[:, :first], oldest, between, rate[:, -1:]], 1)
        velocity = own[:, 4:6] + rate
        cos, sin = _turns(own[:, 4:6].expand_as(velocity), velocity)
        heading = [own[:, 2] * cos - own[:, 3] * sin, own[:, 3] * cos + own[:, 2] * sin]
        valid = own[:, 6:].expand(*offset.shape[:2], 1)
        moved = torch.cat([own[:, 0:2] + offset, torch.stack(heading, -1), velocity, valid], -1)
        return torch.where(torch.from_numpy(self.known)[:, None], moved, own)

    def _motion(self, motion: Tensor, states: Tensor) -> Tensor:
        """(R, 7) with the acceleration and the yaw rate of the states."""
        seconds = max((HISTORY_STEPS - 1 - self._back) * DT_S, DT_S)
        speed = states[..., 4:6].square().sum(-1).clamp_min(1e-12).sqrt()
        gain = (speed[:, -1] - speed[:, self._back]) / seconds
        now, back = states[:, -1, 2:4], states[:, self._back, 2:4]
        cross = back[:, 0] * now[:, 1] - back[:, 1] * now[:, 0]
        turn = torch.atan2(cross, (back * now).sum(-1))
        return torch.cat([motion[:, :1], torch.stack([gain, turn / seconds], -1), motion[:, 3:]], 1)


class Meeting:
    """How likely a predictor's goals are to come near the AV."""

    def __init__(self, view: View, agent_id: AgentId, av_m: Floats, there: Bools) -> None:
        pose = pose_of(view, agent_id)
        self._steps = np.arange(0, min(len(av_m), FUTURE_STEPS), _EVERY)
        local = frames.to_local(av_m[self._steps], pose.position_m, pose.heading_rad)
        self._av = torch.from_numpy(local.astype(np.float32))
        self._gone = torch.from_numpy(~there[self._steps])

    def loss(self, goals: Goals) -> Tensor:
        """(R) minus the log of sum over goals of P * exp(-nearest distance / 3 m)."""
        residual = goals.knots[:, 0].transpose(3, 4) @ anchors.knot_matrix()[:, self._steps]
        along = goals.along_m[..., self._steps] + residual[..., 0, :]
        position, _ = anchors.placed(goals.paths, along.clamp_min(0.0), residual[..., 1, :])
        apart = (position - self._av).norm(dim=-1)  # (R, P, profiles, times)
        nearest = apart.masked_fill(self._gone, _GONE_M).amin(-1)
        share = goals.logits[:, 0].flatten(1).log_softmax(-1)
        value: Tensor = -(share - nearest.flatten(1) / _NEAR_M).logsumexp(-1)
        return value


def _spline() -> Floats:
    """(11, 2) what points 0.5 s and 1 s ago move: a cubic spline that ends now, with slope 0.

    In half seconds u before now: through 0, a, b at 0, 1, 2; free of curvature at 2.
    """
    back = np.arange(HISTORY_STEPS - 1, -1, -1) / KNOT_STEPS
    # Second derivatives at 0, 1, 2 for a and for b, from continuity of the slope.
    bend = np.linalg.solve(
        [[2.0, 1.0, 0.0], [1.0, 4.0, 1.0], [0.0, 0.0, 1.0]], [[6.0, 0.0], [-12.0, 6.0], [0.0, 0.0]]
    )
    value = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    low = np.minimum(back.astype(np.int64), 1)
    after = (back - low)[:, None]
    before = 1 - after
    curve = (before**3 - before) * bend[low] + (after**3 - after) * bend[low + 1]
    spline: Floats = before * value[low] + after * value[low + 1] + curve / 6
    return spline


def _turns(before: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine of the turns between velocities (..., 2); 1 and 0 where one is slow."""
    was = before.square().sum(-1).clamp_min(1e-12).sqrt()
    now = after.square().sum(-1).clamp_min(1e-12).sqrt()
    slow = (was < DIRECTION_MPS) | (now < DIRECTION_MPS)
    size = torch.where(slow, 1.0, was * now)
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    cos = torch.where(slow, 1.0, (before * after).sum(-1) / size)
    return cos, torch.where(slow, 0.0, cross / size)


_DEPTH_M = 0.4  # boxes shall overlap by this, so that tracking errors do not undo the contact
_EFFORT = 0.05  # metres of gap that an added acceleration of 1 m/s2 (mean square) is worth
_SOFT_M = 1.0  # width of the soft minimum over time
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
    count = steps // KNOT_STEPS + 1
    behind = np.arange(_BEFORE, -1, -1)[:, None] * DT_S * start.speed_mps
    before = start.position_m - behind * frames.unit(start.course_rad)
    fixed = len(before)
    gap = _Gap(reference_m, start.heading_rad, target)

    def loss(offset: Tensor) -> Tensor:
        own = offset[:, fixed:]
        added = torch.diff(offset[:, fixed - 2 :], n=2, dim=1) / DT_S**2
        return torch.relu(gap.soft(own) + _DEPTH_M) + _EFFORT * added.square().sum(-1).mean(-1)

    found = descend(
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
    time = np.arange(steps + 1) / KNOT_STEPS
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

    def __init__(self, reference_m: Floats, heading_rad: float, target: Target) -> None:
        # Single precision: far from the origin it would not resolve centimetres.
        origin = reference_m[0]
        self._reference = _single(reference_m - origin)
        self._still = _single(frames.unit(heading_rad))
        self._places = _single(_circles(target.own_size_m))
        self._radii = float(target.own_size_m[1] + target.av_size_m[1]) / 2
        ahead = frames.unit(target.heading_rad)[:, None]
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
