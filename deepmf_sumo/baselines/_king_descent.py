"""The descent of `king`: gradients of a bicycle's controls, through a stand-in for the AV's IDM.

The bicycle is the kinematic one, with the rear axle as its reference; the AV keeps to the path of
its earlier rollout and follows, by the IDM, what is in its corridor. Both are differentiable.
"""

import time
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.baselines._art_descent import DEPTH_M, GONE_M, Adam, circles, single
from deepmf_sumo.scene import DT_S, Bools, Floats
from deepmf_sumo.scene.car_following import TREIBER, desired_gap_m
from deepmf_sumo.scene.road_users import ROAD_USERS

EVERY = 2
"""Steps between the points at which motions are compared, and between two controls: 5 Hz."""
_TAKEN_S = EVERY * DT_S
_SOFT_M = 1.0  # width of the soft minimum over time
_ROOM_M = 1.0  # that other road users should have
_CORRIDOR_M = 0.3  # width of the edge of the AV's corridor


@dataclass(frozen=True, slots=True, kw_only=True)
class CostTerms:
    """Weights of the cost beside the gap to the AV, in metres of it."""

    off_road: float
    others: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OpponentBounds:
    """Of the controls: largest changes, and total accelerations of the opponent."""

    accel_change_mps2: float
    curvature_change_per_m: float
    accel_mps2: float
    brake_mps2: float
    lateral_mps2: float
    fastest_mps: float = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class KingOpponent:
    """Where it is now, (2) box centre, and its controls without the attack.

    Attributes:
        accel_mps2, curvature_per_m: (N) every 0.2 s from now.
        size_m: (2) length and width.
    """

    position_m: Floats
    heading_rad: float
    speed_mps: float
    size_m: Floats
    accel_mps2: Floats
    curvature_per_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Around:
    """What the opponent meets at N times, every 0.2 s from the next one on.

    Attributes:
        av_m, av_mps, av_there: (N, 2), (N), (N) the AV's earlier rollout.
        av_start_m, av_start_mps: (2) and speed now. av_size_m: (2).
        others_m: (B, N, 2), far away where they are absent. others_reach_m: (B) half a width.
        road_m, road_reach_m: (M, 2) points on lanes, (M) half the width there.
    """

    av_start_m: Floats
    av_start_mps: float
    av_m: Floats
    av_mps: Floats
    av_there: Bools
    av_size_m: Floats
    others_m: Floats
    others_reach_m: Floats
    road_m: Floats
    road_reach_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class KingDescent:
    """Controls that were found: positions (N, 2) every 0.2 s, least gap, iterations made."""

    position_m: Floats
    gap_m: float
    iterations: int
    out_of_time: bool


def descend(
    opponent: KingOpponent, around: Around, bounds: OpponentBounds, terms: CostTerms, rate: float,
    iterations: int, until: float,
) -> KingDescent:  # fmt: skip
    """The first controls under which the stand-in is hit, else those that come closest.

    ``until``: `time.perf_counter` to stop at; the first iteration is always made.
    """
    problem = _Problem(opponent, around, bounds, terms)
    controls = torch.zeros(2, len(opponent.accel_mps2), requires_grad=True)
    adam = Adam(controls, rate)
    best, least, done, late = problem.place(controls)[0], np.inf, 0, False
    while done < iterations and not late:
        position, heading = problem.place(controls)
        cost, gap = problem.cost(position, heading)
        done += 1
        if gap < least:
            best, least = position, gap
        if gap < -DEPTH_M / 2:
            break
        (slope,) = torch.autograd.grad(cost, controls)
        controls = (controls.detach() - adam.step(slope)).clamp(-1.0, 1.0).requires_grad_()
        late = time.perf_counter() >= until
    found = best.detach().double().numpy() + opponent.position_m
    return KingDescent(position_m=found, gap_m=least, iterations=done, out_of_time=late)


class _Problem:
    """Costs of controls.

    The opponent's present centre is the origin: far from it single precision does not resolve
    centimetres.
    """

    def __init__(
        self, opponent: KingOpponent, around: Around, bounds: OpponentBounds, terms: CostTerms
    ) -> None:
        self._opponent, self._bounds, self._terms = opponent, bounds, terms
        origin = opponent.position_m
        self._accel = single(opponent.accel_mps2)
        self._curvature = single(opponent.curvature_per_m)
        self._circles = single(circles(opponent.size_m))
        self._av = _Follower(around, origin, opponent.size_m)
        self._av_circles = single(circles(around.av_size_m))
        self._radii = float(opponent.size_m[1] + around.av_size_m[1]) / 2
        self._gone = torch.from_numpy(~around.av_there)
        self._others = single(around.others_m - origin)
        self._reach = single(around.others_reach_m) + float(opponent.size_m[1]) / 2
        self._road = single(around.road_m - origin)
        self._road_reach = single(around.road_reach_m)

    def place(self, controls: Tensor) -> tuple[Tensor, Tensor]:
        """Box centres (N, 2) and headings (N) under controls (2, N) in [-1, 1]."""
        one, bounds = self._opponent, self._bounds
        accel = self._accel + bounds.accel_change_mps2 * controls[0]
        accel = accel.clamp(-bounds.brake_mps2, bounds.accel_mps2)
        speed = (one.speed_mps + accel.cumsum(0) * _TAKEN_S).clamp(0.0, bounds.fastest_mps)
        way = (torch.cat([speed.new_tensor([one.speed_mps]), speed[:-1]]) + speed) / 2 * _TAKEN_S
        curvature = self._curvature + bounds.curvature_change_per_m * controls[1]
        sharpest = bounds.lateral_mps2 / speed.detach().square().clamp_min(1.0)
        curvature = torch.minimum(torch.maximum(curvature, -sharpest), sharpest)
        turn = curvature * way
        heading = one.heading_rad + turn.cumsum(0)
        rear = ROAD_USERS["car"].motion.rear_axle * float(one.size_m[0])
        moved = (_unit(heading - turn / 2) * way.unsqueeze(-1)).cumsum(0)
        begin = _unit(torch.tensor(one.heading_rad, dtype=torch.float32)) * rear
        return moved - begin + rear * _unit(heading), heading

    def cost(self, position: Tensor, heading: Tensor) -> tuple[Tensor, float]:
        """What is minimised, and the least gap to the AV, negative in contact; metres."""
        av, course = self._av.answers(position)
        mine = position.unsqueeze(1) + self._circles[:, None] * _unit(heading).unsqueeze(1)
        theirs = av.unsqueeze(1) + self._av_circles[:, None] * _unit(course).unsqueeze(1)
        apart = (mine.unsqueeze(2) - theirs.unsqueeze(1)).norm(dim=-1).flatten(1).amin(-1)
        gap = (apart - self._radii).masked_fill(self._gone, GONE_M)
        cost = -_SOFT_M * (-gap / _SOFT_M).logsumexp(-1)
        if len(self._others):
            room = (position - self._others).norm(dim=-1) - self._reach.unsqueeze(1)
            cost = cost + self._terms.others * torch.relu(_ROOM_M - room).amax(0).mean()
        if len(self._road):
            beyond = torch.cdist(position[None], self._road[None])[0] - self._road_reach
            cost = cost + self._terms.off_road * torch.relu(beyond.amin(-1)).mean()
        return cost, float(gap.detach().min())


class _Follower:
    """The stand-in for the AV: on the path of its earlier rollout, behind what is ahead there."""

    def __init__(self, around: Around, origin_m: Floats, other_size_m: Floats) -> None:
        points = np.concatenate([around.av_start_m[None], around.av_m[around.av_there]])
        moved = np.diff(points, axis=0)
        kept = np.hypot(*moved.T) > 1e-3
        points = np.concatenate([points[:1], points[1:][kept]]) - origin_m
        if len(points) < 2:  # it stands
            points = np.concatenate([points, points + np.array([1e-2, 0.0])])
        tangent = np.diff(points, axis=0)
        length = np.hypot(*tangent.T)
        # Straight on, for what the stand-in drives beyond the rollout's end.
        ahead = tangent[-1] / length[-1] * 100.0
        self._points = single(np.concatenate([points, points[-1:] + ahead]))
        self._along = single(np.concatenate([[0.0], np.cumsum(length), [length.sum() + 100.0]]))
        ways = torch.diff(self._points, dim=0)
        self._tangent = ways / ways.norm(dim=-1, keepdim=True)
        self._speed = single(np.concatenate([[around.av_start_mps], around.av_mps]))
        self._half = float(around.av_size_m[1] + other_size_m[1]) / 2
        self._lengths = float(around.av_size_m[0] + other_size_m[0]) / 2

    def answers(self, other: Tensor) -> tuple[Tensor, Tensor]:
        """Centres (N, 2) and headings (N) of the AV that an opponent at (N, 2) meets."""
        along, inside, speed = self._on_path(other)
        most, hardest = TREIBER.accel_mps2, TREIBER.emergency_mps2
        place, pace = self._along.new_zeros(()), self._speed[0]
        places = []
        for step in range(len(other)):
            gap = along[step] - place - self._lengths
            wanted = desired_gap_m(TREIBER, pace, speed[step], torch.relu)
            there = inside[step] * torch.sigmoid((gap + self._lengths) / 0.5)
            braking = most * (wanted / gap.clamp_min(0.5)).square()
            free = ((self._speed[step + 1] - pace) / _TAKEN_S).clamp(-hardest, most)
            accel = (free - there * braking.clamp_max(20.0)).clamp_min(-hardest)
            after = torch.relu(pace + accel * _TAKEN_S)
            place = place + (pace + after) / 2 * _TAKEN_S
            pace = after
            places.append(place)
        return self._at(torch.stack(places))

    def _on_path(self, other: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(N) where the opponent is along the path, how far inside the corridor, its speed."""
        apart = torch.cdist(other.detach()[None], self._points[None, :-1])[0]
        segment = apart.argmin(-1)
        offset, tangent = other - self._points[segment], self._tangent[segment]
        along = self._along[segment] + (offset * tangent).sum(-1)
        left = offset[:, 1] * tangent[:, 0] - offset[:, 0] * tangent[:, 1]
        inside = torch.sigmoid((self._half - left.abs()) / _CORRIDOR_M)
        moved = torch.diff(other, dim=0) / _TAKEN_S
        velocity = torch.cat([moved[:1], moved]) if len(moved) else torch.zeros_like(other)
        return along, inside, (velocity * tangent).sum(-1)

    def _at(self, along: Tensor) -> tuple[Tensor, Tensor]:
        """Points (N, 2) and directions (N) of the path."""
        segment = torch.searchsorted(self._along, along.detach().contiguous(), right=True) - 1
        segment = segment.clamp(0, len(self._tangent) - 1)
        tangent = self._tangent[segment]
        point = self._points[segment] + (along - self._along[segment]).unsqueeze(-1) * tangent
        return point, torch.atan2(tangent[:, 1], tangent[:, 0])


def _unit(angle: Tensor) -> Tensor:
    return torch.stack([angle.cos(), angle.sin()], -1)
