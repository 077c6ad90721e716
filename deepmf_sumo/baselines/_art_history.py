"""The perturbed history of `art`: the opponent's last second, as the marginal predictor gets it.

The present state is fixed, since the simulation cannot change it: position, heading and velocity,
and with them the frame, the paths and the lanes. Features of the past are rebuilt in torch, so that
gradients reach them: the vehicle's own vectors, its acceleration and its yaw rate. The image, which
shows the box a second ago on a grid of metres, is constant during the descent; the final prediction
uses the perturbed history, image included.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.baselines._art_descent import (
    GONE_M,
    KNOT_STEPS,
    ArtDescent,
    Effort,
    PerturbationBounds,
    descend,
)
from deepmf_sumo.deepmf.networks import anchors
from deepmf_sumo.deepmf.networks.decode import knot_matrix
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT, Goals, as_batch
from deepmf_sumo.deepmf.networks.encode import features, half_second_ago
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, HISTORY_STEPS, AgentId, Bools, Floats, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.frames import pose_of
from deepmf_sumo.scene.geometry.slow import DIRECTION_MPS

_NEAR_M = 3.0  # a goal that comes closer to the AV by this counts e times as much
_EVERY = 4  # goals are compared with the AV every 0.4 s


def perturb(
    net: DenseTNT,
    past: "PerturbedPast",
    meeting: "GoalMeeting",
    bounds: PerturbationBounds,
    effort: Effort,
    rng: np.random.Generator,
) -> ArtDescent:
    """Perturbations (R, 11, 2) of an agent's history that make goals near the AV likelier.

    The first restart begins with the recorded history, the others at random.
    """
    begin = rng.normal(scale=bounds.reach_m / 2, size=(effort.restarts, past.basis.shape[1], 2))
    begin[0] = 0.0
    known = torch.from_numpy(np.flatnonzero(past.known))

    def loss(offset: Tensor) -> Tensor:
        whole = offset.new_zeros(len(offset), HISTORY_STEPS, 2).index_copy(1, known, offset)
        return meeting.loss(net(past.batch(whole)))

    found = descend(
        loss,
        past.recorded_m[past.known],
        past.basis[past.known],
        begin,
        bounds,
        effort,
    )
    offset = np.einsum("wn,rnc->rwc", past.basis, found.points)
    return ArtDescent(points=found.points, offset_m=offset, iterations=found.iterations)


class PerturbedPast:
    """An agent's history as a function of offsets (R, 11, 2), now last, in the scene's frame.

    Raises KeyError for an agent that is not in view.

    Attributes:
        known: (11) the last uninterrupted stretch of steps up to now; other steps are fixed.
        recorded_m: (11, 2) positions.
        basis: (11, 2) effect of the points half a second and a second ago; now is fixed.
    """

    def __init__(self, view: View, agent_id: AgentId, net: DenseTNT) -> None:
        tracks = view.history
        self._view, self._row = view, tracks.row(agent_id)
        self._arrays = as_batch(features(view, agent_id, net.preset)[0])
        self._heading = pose_of(view, agent_id).heading_rad
        self.recorded_m = tracks.position_m[self._row]
        valid = tracks.valid[self._row]
        self._back = int(half_second_ago(valid[None])[0])
        self.known: Bools = np.logical_and.accumulate(valid[::-1])[::-1].copy()
        self.basis: Floats = np.where(self.known[:, None], _spline(), 0.0)

    def batch(self, offset: Tensor) -> dict[str, Tensor]:
        """`encode.Features` of R perturbed histories, differentiable in the offsets."""
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
        """(R, 11, 7) states (11, 7) of `encode.Features` moved by offsets of the same frame."""
        rate = torch.zeros_like(offset)
        first = int(self.known.argmax())
        if first < HISTORY_STEPS - 2:
            inner = offset[:, first:]
            oldest = (inner[:, 1:2] - inner[:, :1]) / DT_S
            between = (inner[:, 2:] - inner[:, :-2]) / (2 * DT_S)
            # The present velocity is fixed.
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


class GoalMeeting:
    """How likely a predictor's goals are to come near the AV.

    ``av_m`` (K, 2) are the AV's positions from the next step on, ``there`` (K) where it is present.
    """

    def __init__(self, view: View, agent_id: AgentId, av_m: Floats, there: Bools) -> None:
        pose = pose_of(view, agent_id)
        self._steps = np.arange(0, min(len(av_m), FUTURE_STEPS), _EVERY)
        local = frames.to_local(av_m[self._steps], pose.position_m, pose.heading_rad)
        self._av = torch.from_numpy(local.astype(np.float32))
        self._gone = torch.from_numpy(~there[self._steps])

    def loss(self, goals: Goals) -> Tensor:
        """(R) minus the log of sum over goals of P * exp(-nearest distance / 3 m)."""
        spread = torch.from_numpy(knot_matrix()).to(goals.knots)[:, self._steps]
        residual = goals.knots[:, 0].transpose(3, 4) @ spread
        along = goals.along_m[..., self._steps] + residual[..., 0, :]
        position, _ = anchors.placed(goals.paths, along.clamp_min(0.0), residual[..., 1, :])
        apart = (position - self._av).norm(dim=-1)  # (R, P, profiles, times)
        nearest = apart.masked_fill(self._gone, GONE_M).amin(-1)
        share = goals.logits[:, 0].flatten(1).log_softmax(-1)
        value: Tensor = -(share - nearest.flatten(1) / _NEAR_M).logsumexp(-1)
        return value


def _spline() -> Floats:
    """(11, 2) effect of points 0.5 s and 1 s ago: a cubic spline that ends now, with slope 0.

    In half seconds u before now: through 0, a, b at 0, 1, 2; without curvature at 2.
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
    """Cosine and sine of the turns between velocities (..., 2); 1 and 0 if one is slow."""
    was = before.square().sum(-1).clamp_min(1e-12).sqrt()
    now = after.square().sum(-1).clamp_min(1e-12).sqrt()
    slow = (was < DIRECTION_MPS) | (now < DIRECTION_MPS)
    size = torch.where(slow, 1.0, was * now)
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    cos = torch.where(slow, 1.0, (before * after).sum(-1) / size)
    return cos, torch.where(slow, 0.0, cross / size)
