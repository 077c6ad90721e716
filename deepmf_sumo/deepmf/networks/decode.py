"""Goals to trajectories: choice of modes, completion, densities, scores of several networks.

Modes are chosen by k-medoids from hundreds of weighted dense goals, for K independent sets of N
goals together.

`gain` combines the goal scores of two networks as a product of experts (Hinton 2002, "Training
products of experts by minimizing contrastive divergence", section 1). Both predict one vehicle in
one view, so that their goals lie on the same paths; speed profiles and residuals may differ, so
that goals are compared by how far along a path they end.

Several members, networks that differ in the seed of their training, form a mixture in equal parts:
Lakshminarayanan et al. 2017, "Simple and scalable predictive uncertainty estimation using deep
ensembles", section 2.4.

Everything here is numpy: torch and ONNX Runtime both end in a `GoalSet`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.lanes import NODE_SPACING_M
from deepmf_sumo.errors import RunError
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Floats, Forecast, Futures, Ints
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.frames import AgentFrame

Singles = NDArray[np.float32]

KNOTS_S: Final = (1.0, 2.0, 4.0, 6.0, 8.0)
KNOT_STEPS: Final = tuple(round(second / DT_S) - 1 for second in KNOTS_S)
"""Index in the 80 steps of each knot; index 0 is 0.1 s."""
CAP_M: Final = 25.0
"""A larger distance to all modes costs no more than this one."""
_SWAPS = 4
"""Rounds in which each mode moves to the median of the goals that are nearest to it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GoalSet:
    """All goals of one vehicle in its frame: P paths, R speed profiles, under K given futures.

    Attributes:
        logits: (K, P, R), -inf on paths that do not exist.
        along_m: (P, R, 80) distances of the anchors.
        knots: (K, P, R, 5, 2) residual along and to the left at 1, 2, 4, 6, 8 s, metres.
        paths: (P, 121, 2).
        block: number of goals of a path, one after the other, of which at most one becomes a mode:
            dense goals, the only ones with more than 1, are too many to be compared with one
            another.
    """

    logits: Singles
    along_m: Singles
    knots: Singles
    paths: Singles
    block: int = 1

    def at_knots(self) -> tuple[Singles, Singles]:
        """Positions and path tangents (K, N, 5, 2) at 1, 2, 4, 6, 8 s; N = P * R goals."""
        return self._at(slice(None))

    def ends(self) -> Singles:
        """End points (K, N, 2) at 8 s."""
        return self._at(slice(-1, None))[0][:, :, 0]

    def _at(self, knots: slice) -> tuple[Singles, Singles]:
        along = self.along_m[..., list(KNOT_STEPS[knots])] + self.knots[..., knots, 0]
        path = np.arange(len(self.paths))[:, None, None]
        found = placed_on(self.paths, path, np.maximum(along, 0.0), self.knots[..., knots, 1])
        futures, _, _, count, _ = found[0].shape
        position, tangent = (each.reshape(futures, -1, count, 2) for each in found)
        return position, tangent


def select(
    probability: Singles,
    ends_m: Singles,
    modes: int,
    *,
    shortlist: int | None = None,
    block: int = 1,
) -> tuple[Ints, Singles]:
    """Chosen goals and their mass (K, M), most likely first.

    Args:
        probability: (K, P, R).
        ends_m: (K, N, 2) end points, N = P * R.
        modes: M, at most the number of blocks.
        shortlist: number of likeliest goals that may become modes; None: all.
        block: see `GoalSet`.

    Raises RunError where there are fewer goals than modes.

    A mode's mass is the probability of all goals that are nearer to it than to other modes.
    """
    likely, place = _blocks(probability, block)
    probability = probability.reshape(len(probability), -1)
    size = min(max(modes, shortlist or likely.shape[1]), likely.shape[1])
    if size < modes:
        raise RunError(
            f"{modes} modes of a forecast were asked for, but with these weights a vehicle here has"
            f" {size} goals; ask for fewer (candidates, reactions, modes)."
        )
    best = np.argsort(-likely, axis=1, kind="stable")[:, :size]
    weight, rows = np.take_along_axis(likely, best, 1), np.take_along_axis(place, best, 1)
    ends = np.take_along_axis(ends_m, rows[..., None], 1)
    distance = np.minimum(_distances(ends, ends), CAP_M)
    picked = _medoids(weight, distance, modes)
    chosen = np.take_along_axis(rows, picked, 1)
    share = mass(probability, ends_m, np.take_along_axis(ends, picked[..., None], 1))
    order = np.argsort(-share, axis=1, kind="stable")
    return np.take_along_axis(chosen, order, 1), np.take_along_axis(share, order, 1)


def _blocks(probability: Singles, block: int) -> tuple[Singles, Ints]:
    """(K, M) mass of the blocks of goals (K, P, R), and the likeliest goal of each."""
    futures, paths, goals = probability.shape
    first = np.arange(paths)[:, None] * goals + np.arange(0, goals, block)
    if block == 1:
        return probability.reshape(futures, -1), np.broadcast_to(
            first.ravel(), (futures, first.size)
        )
    filled = np.pad(probability, ((0, 0), (0, 0), (0, -goals % block)))
    parts = filled.reshape(futures, -1, block)
    return parts.sum(-1), first.ravel() + parts.argmax(-1)


def _distances(one_m: Singles, other_m: Singles) -> Singles:
    """(..., N, M) distances between points (..., N, 2) and (..., M, 2)."""
    x = one_m[..., :, None, 0] - other_m[..., None, :, 0]
    y = one_m[..., :, None, 1] - other_m[..., None, :, 1]
    x *= x
    y *= y
    x += y
    return np.sqrt(x, out=x)


def _medoids(weight: Singles, distance: Singles, modes: int) -> Ints:
    """(K, M) modes that lower the expected distance to the nearest mode.

    They are chosen greedily, and then moved together.
    """
    every = np.arange(len(weight))
    least = np.full_like(weight, CAP_M)
    free = np.ones_like(weight)
    saved = np.empty_like(distance)
    picked = np.empty((len(weight), modes), np.int64)
    for number in range(modes):
        np.subtract(least[:, None], distance, out=saved)
        np.maximum(saved, 0.0, out=saved)
        gain = (saved @ weight[..., None])[..., 0]
        best = ((gain + np.float32(1e-9)) * free).argmax(1)
        free[every, best] = 0.0
        least = np.minimum(least, distance[every, best])
        picked[:, number] = best
    moving = every
    for _ in range(_SWAPS):
        moved = _medians(weight[moving], distance[moving], picked[moving])
        changed = (moved != picked[moving]).any(1)
        picked[moving] = moved
        moving = moving[changed]
        if not len(moving):
            break
    return picked


def _medians(weight: Singles, distance: Singles, chosen: Ints) -> Ints:
    """(K, M) for each mode the goal with the least distance to all goals nearest to the mode.

    If two modes chose one goal, it counts for the first; the second mode does not move.
    """
    away = distance[np.arange(len(chosen))[:, None], chosen]  # (K, M, N)
    nearest = _first_least(away)  # (K, N)
    mine = nearest[:, None] == np.arange(chosen.shape[1])[:, None]  # (K, M, N)
    cost = (mine * weight[:, None]) @ distance
    cost[~mine] = np.inf
    return np.where(mine.any(-1), cost.argmin(-1), chosen)


def _first_least(values: Singles) -> Ints:
    """(K, N) number of the least of (K, M, N): the first one where several are equal."""
    least, found = values[:, 0].copy(), np.zeros(values[:, 0].shape, np.int64)
    for number in range(1, values.shape[1]):  # numpy is slow at the least of a middle axis
        nearer = values[:, number] < least
        found[nearer] = number
        np.minimum(least, values[:, number], out=least)
    return found


def mass(probability: Singles, ends_m: Singles, modes_m: Singles) -> Singles:
    """(K, M) probability of the goals nearest to each mode."""
    sets, modes = modes_m.shape[:2]
    nearest = _first_least(_distances(modes_m, ends_m)) + modes * np.arange(sets)[:, None]
    share = np.bincount(nearest.ravel(), probability.ravel(), minlength=sets * modes)
    return share.reshape(sets, modes).astype(np.float32)


def forecasts(
    goals: GoalSet,
    pose: AgentFrame,
    modes: int,
    temperature: float,
    *,
    shortlist: int | None = None,
    chosen_at: int | None = None,
) -> list[Forecast]:
    """One forecast for each of the K given futures (one where there is none).

    Modes and their mass are taken at the temperature, because the best few ends depend on how
    likely the tails are. Modes are chosen by their positions at 8 s, or at the step ``chosen_at``
    (0 to 79).
    """
    logits = goals.logits.reshape(len(goals.logits), -1) / np.float32(temperature)
    probability = np.exp(log_softmax(logits))  # (K, N)
    ends = goals.ends() if chosen_at is None else _all_at(goals, chosen_at)  # (K, N, 2)
    whole = probability.reshape(goals.logits.shape)
    chosen, mass = select(whole, ends, modes, shortlist=shortlist, block=goals.block)
    futures = to_scene(pose, *complete(goals, chosen))
    shares = (mass / mass.sum(axis=1, keepdims=True)).astype(np.float64)
    return [
        Forecast(
            futures=Futures(agent_id=pose.agent_id, position_m=position, heading_rad=heading),
            probability=share,
            temperature=temperature,
        )
        for position, heading, share in zip(*futures, shares, strict=True)
    ]


def end_density(goals: GoalSet, pose: AgentFrame, ends_m: Floats, kernel_m: float) -> Floats:
    """(Q) log density of end points (Q, 2) of the scene's frame under the goals of future 0.

    A Gaussian of width ``kernel_m`` stands on each goal: for comparing networks.
    """
    local = pose.to_local(ends_m).astype(np.float32)
    score = log_softmax(goals.logits[0].ravel())
    square = _distances(local, goals.ends()[0]) ** 2
    log_kernel = -square / (2 * kernel_m**2) - math.log(2 * math.pi * kernel_m**2)
    return logsumexp(score + log_kernel).astype(np.float64)


def complete(goals: GoalSet, chosen: Ints) -> tuple[Singles, Singles]:
    """Positions (K, M, 80, 2) and headings (K, M, 80) of goals (K, M), in the pose's frame."""
    path, profile = np.divmod(chosen, goals.along_m.shape[1])
    future = np.arange(len(chosen))[:, None]
    knots = goals.knots[future, path, profile]  # (K, M, 5, 2)
    ahead, left = knots[..., 0] @ knot_matrix(), knots[..., 1] @ knot_matrix()
    along = np.maximum(goals.along_m[path, profile] + ahead, 0.0)
    if goals.block > 1:  # the goal is where the vehicle is at the end
        along = np.minimum(along, along[..., -1:])
    along = np.maximum.accumulate(along, axis=-1)  # (K, M, 80)
    position, tangent = placed_on(goals.paths, path[..., None], along, left)
    return position, _headings(position, tangent)


def _all_at(goals: GoalSet, step: int) -> Singles:
    """(K, N, 2) positions of all goals at a step."""
    futures, paths, profiles = goals.logits.shape
    every = np.broadcast_to(np.arange(paths * profiles), (futures, paths * profiles))
    return complete(goals, every)[0][:, :, step]


def placed_on(
    paths: Singles, path: Ints, along_m: Singles, left_m: Singles
) -> tuple[Singles, Singles]:
    """Points and unit tangents (..., 2) at coordinates (...) on the path (...) of (P, 121, 2).

    As `anchors.placed_on`: straight on past the last node, and tangents change linearly between
    nodes.
    """
    step = np.diff(paths, axis=1)
    after = np.concatenate([step[:, 1:], step[:, -1:]], 1)
    place = along_m * np.float32(1.0 / NODE_SPACING_M)
    base = np.clip(np.floor(place), 0.0, step.shape[1] - 1)
    share = place - base
    row = (base.astype(np.int64) + path * step.shape[1]).ravel()
    turned = np.clip(share - np.float32(0.5), 0.0, 0.5)
    point, tangent = [], []
    for axis in (0, 1):  # x and y apart, which is twice as fast
        start, here, then = (
            each[..., axis].ravel()[row].reshape(share.shape)
            for each in (paths[:, :-1], step, after)
        )
        point.append(start + share * here)
        tangent.append(here + turned * (then - here))
    size = np.sqrt(np.maximum(tangent[0] ** 2 + tangent[1] ** 2, np.float32(1e-12)))
    cos, sin = tangent[0] / size, tangent[1] / size
    position = np.stack([point[0] - left_m * sin, point[1] + left_m * cos], -1)
    return position, np.stack([cos, sin], -1)


def _headings(position: Singles, tangent: Singles) -> Singles:
    """(..., 80) headings: of the motion where it is faster than 1 m/s, else of the path."""
    step = np.diff(position, axis=-2, prepend=np.float32(0.0))
    moves = np.hypot(step[..., 0], step[..., 1]) > np.float32(DT_S)
    direction = np.where(moves[..., None], step, tangent)
    return np.arctan2(direction[..., 1], direction[..., 0])


@cache
def knot_matrix() -> Singles:
    """(5, 80) maps values at the knots to all steps: Hermite, from 0 with slope 0 at time 0."""
    times = np.array((0.0, *KNOTS_S))
    steps = np.arange(1, FUTURE_STEPS + 1) * DT_S
    count = len(times)
    slope = np.zeros((count, count))
    for row in range(1, count):
        before, after = row - 1, min(row + 1, count - 1)
        span = times[after] - times[before]
        slope[row, after] += 1 / span
        slope[row, before] -= 1 / span
    value = np.eye(count)
    segment = np.clip(np.searchsorted(times, steps) - 1, 0, count - 2)
    width = times[segment + 1] - times[segment]
    u = ((steps - times[segment]) / width)[:, None]
    width = width[:, None]
    rows = (
        (2 * u**3 - 3 * u**2 + 1) * value[segment]
        + (u**3 - 2 * u**2 + u) * width * slope[segment]
        + (3 * u**2 - 2 * u**3) * value[segment + 1]
        + (u**3 - u**2) * width * slope[segment + 1]
    )
    return np.ascontiguousarray(rows[:, 1:].T.astype(np.float32))


def to_scene(pose: AgentFrame, position: Singles, heading: Singles) -> tuple[Floats, Floats]:
    """Positions (..., 2) and headings (...) of the pose's frame in the scene's."""
    return (
        frames.to_scene(position.astype(np.float64), pose.position_m, pose.heading_rad),
        frames.wrap(heading.astype(np.float64) + pose.heading_rad),
    )


def to_pose(pose: AgentFrame, futures: Futures) -> tuple[Singles, Singles]:
    """Positions (K, F, 2) and headings (K, F) of futures in the pose's frame."""
    local, turned = pose.to_local(futures.position_m), pose.turn_rad(futures.heading_rad)
    return local.astype(np.float32), turned.astype(np.float32)


_REACH_M: Final = 3.0
"""Scale of the Laplace kernel over distance along a path."""


def gain(alone: GoalSet, others: Sequence[GoalSet]) -> Singles:
    """(P, R) log of each goal's probability under others over that under a network, nats.

    Args:
        alone: goals of the first network without condition (1, P, R).
        others: of each member of the second network (1, P, R'), a mixture in equal parts.
    """
    end_m = _end(alone)
    known = logsumexp(np.stack([_mass_near(each, end_m) for each in others], -1))
    with np.errstate(invalid="ignore"):  # of paths that do not exist, which gain nothing
        found = known - np.float32(math.log(len(others))) - _mass_near(alone, end_m)
    return np.where(np.isneginf(alone.logits[0]), np.float32(0.0), found)


def _end(goals: GoalSet) -> Singles:
    """(P, R) distances along the paths at 8 s, metres."""
    return goals.along_m[..., -1] + goals.knots[0, :, :, -1, 0]


def _mass_near(goals: GoalSet, end_m: Singles) -> Singles:
    """(P, Q) log mass of goals near ends (P, Q) on the same paths, up to a constant."""
    off = np.abs(end_m[:, :, None] - _end(goals)[:, None]) / np.float32(_REACH_M)  # (P, Q, R)
    score = log_softmax(goals.logits[0].ravel()).reshape(goals.logits.shape[1:])
    return logsumexp(score[:, None] - off)


def pooled(members: Sequence[GoalSet]) -> GoalSet:
    """The goals of all members as goals of one network; those of a single member unchanged.

    The logits become log probabilities within each member, so that every member has the same mass.
    Members are joined along the axis of paths; they need the same number of profiles.
    """
    if len(members) == 1:
        return members[0]
    return GoalSet(
        logits=np.concatenate([_of_equal_mass(one.logits) for one in members], 1),
        along_m=np.concatenate([one.along_m for one in members]),
        knots=np.concatenate([one.knots for one in members], 1),
        paths=np.concatenate([one.paths for one in members]),
        block=members[0].block,
    )


def log_density(
    kernels_m: Sequence[Singles],
    members: Sequence[GoalSet],
    temperature: float,
    position_m: Singles,
    valid: Singles,
) -> Singles:
    """(K) log density of true positions (K, 5, 2) at the knots, see `_kernels`.

    The temperature applies to the pooled goals; each member's goals have that member's kernels
    (5, 2). ``valid`` (5) knots count.
    """
    warm = [_of_equal_mass(one.logits[0]) / np.float32(temperature) for one in members]
    mass = log_softmax(np.array([logsumexp(logits.ravel()) for logits in warm]))
    parts = [
        logsumexp(log_softmax(logits.ravel()) + _kernels(one, width, position_m, valid))
        for one, logits, width in zip(members, warm, kernels_m, strict=True)
    ]
    return logsumexp(np.stack(parts, -1) + mass)


def _kernels(goals: GoalSet, width_m: Singles, position_m: Singles, valid: Singles) -> Singles:
    """(K, N) log of the Laplace kernels of all goals at the knots, in log 1/m^2 each.

    As in `densetnt.DenseTNT.log_density`: widths (5, 2) along and across, positions (K, 5, 2).
    """
    # Each axis by itself: numpy is slow at sums over an axis of length two.
    centre, tangent = goals.at_knots()
    (goal_x, goal_y), (cos, sin) = (np.moveaxis(each[0], -1, 0) for each in (centre, tangent))
    x, y = position_m[:, None, :, 0], position_m[:, None, :, 1]  # (K, 1, 5)
    ahead = cos * x
    ahead += sin * y
    ahead -= cos * goal_x + sin * goal_y
    left = cos * y
    left -= sin * x
    left -= cos * goal_y - sin * goal_x
    scale = valid / width_m.T  # (2, 5)
    fit = np.abs(ahead, out=ahead) @ -scale[0] + np.abs(left, out=left) @ -scale[1]
    area = np.log(4 * width_m[:, 0] * width_m[:, 1])
    return fit - (area * valid).sum(dtype=np.float32)


def _of_equal_mass(logits: Singles) -> Singles:
    """Logits (..., P, R) of a member as log probabilities over all its goals."""
    return log_softmax(logits.reshape(*logits.shape[:-2], -1)).reshape(logits.shape)


def logsumexp(values: Singles) -> Singles:
    """(...) of (..., N); -inf where all are."""
    most = values.max(axis=-1, keepdims=True)
    most = np.where(np.isfinite(most), most, np.float32(0.0))
    with np.errstate(divide="ignore"):
        return np.log(np.exp(values - most).sum(axis=-1)) + most[..., 0]


def log_softmax(values: Singles) -> Singles:
    """(..., N) of (..., N), which has a finite value in each row."""
    return values - logsumexp(values)[..., None]
