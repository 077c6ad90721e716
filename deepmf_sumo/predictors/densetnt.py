"""DenseTNT (Gu et al. 2021) on the lane graph: score dense goals, complete the best ones.

A goal is a (path, speed profile) anchor: it carries a whole timed trajectory, so that completion is
a small residual in path coordinates, which joins the present pose and stays smooth. Shapes: B
scenes, K given futures (1 without condition), P paths, R = 24 profiles, H hidden, E elements.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from deepmf_sumo.predictors import anchors, condition
from deepmf_sumo.predictors.anchors import KNOT_STEPS, PROFILES, START_SPEEDS_MPS
from deepmf_sumo.predictors.condition import Condition
from deepmf_sumo.predictors.paths import NODE_SPACING_M
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.predictors.raster import unpack
from deepmf_sumo.predictors.vectornet import Attention, SubGraph, VectorNet
from deepmf_sumo.predictors.vgg import VGG16

_PATH_NODES = (0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 25, 30, 38, 47, 60, 80, 110)
_GOAL = 26


@dataclass(frozen=True, slots=True, kw_only=True)
class Goals:
    """All goals of a batch.

    Attributes:
        logits: (B, K, P, R), -inf on paths that do not exist.
        along_m: (B, P, R, 80) distances of the anchors.
        knots: (B, K, P, R, 5, 2) residual along and to the left at 1, 2, 4, 6, 8 s, metres.
        paths: (B, P, 121, 2).
    """

    logits: Tensor
    along_m: Tensor
    knots: Tensor
    paths: Tensor

    def at_knots(self) -> tuple[Tensor, Tensor]:
        """Positions and path tangents (B, K, P, R, 5, 2) at 1, 2, 4, 6, 8 s."""
        return self._at(list(range(len(KNOT_STEPS))))

    def ends(self) -> Tensor:
        """End points (B, K, N, 2) at 8 s; N = P * R goals."""
        return self._at([len(KNOT_STEPS) - 1])[0].flatten(4).flatten(2, 3)

    def _at(self, knots: list[int]) -> tuple[Tensor, Tensor]:
        steps = [KNOT_STEPS[knot] for knot in knots]
        along = self.along_m[:, None, :, :, steps] + self.knots[..., knots, 0]
        along = along.clamp_min(0.0).transpose(1, 2)  # (B, P, K, R, knots)
        left = self.knots[..., knots, 1].transpose(1, 2)
        position, tangent = anchors.placed(self.paths, along, left)
        return position.transpose(1, 2), tangent.transpose(1, 2)


class DenseTNT(nn.Module):
    """Scores and completes the dense goals of one vehicle; ``conditional`` takes given futures.

    Buffers ``profiles`` (13, 24, 80) and ``prior`` (13, 24) come from training data; ``widths``
    (5, 2) are the log scales of the Laplace kernels along and across at the knots.
    """

    profiles: Tensor
    prior: Tensor
    reach: Tensor

    def __init__(self, preset: Preset, *, conditional: bool = False) -> None:
        super().__init__()
        hidden = preset.hidden
        self.preset = preset
        self.conditional = conditional
        speeds = len(START_SPEEDS_MPS)
        self.register_buffer("profiles", torch.zeros(speeds, PROFILES, 80))
        self.register_buffer("prior", torch.full((speeds, PROFILES), -3.18))
        reach = [[1.0, 0.5], [2.0, 1.0], [4.0, 2.0], [6.0, 3.0], [8.0, 4.0]]
        self.register_buffer("reach", torch.tensor(reach))
        self.widths = nn.Parameter(torch.tensor(reach).mul(0.4).log())
        self.vectors = VectorNet(preset)
        self.image = VGG16(preset, conditional=conditional)
        self.motion = _mlp(6, hidden, hidden)
        self.path_line = _mlp(len(_PATH_NODES) * 5 + 14, hidden, hidden)
        self.path_agents = _mlp(8, hidden // 2, hidden)
        self.path_to_elements = Attention(hidden, preset.heads)
        self.path_to_paths = Attention(hidden, preset.heads)
        self.target_to_elements = Attention(hidden, preset.heads)
        self.goal = nn.Linear(_GOAL, hidden)
        self.profile = nn.Parameter(torch.zeros(PROFILES, hidden))
        self.goal_path = nn.Linear(hidden, hidden)
        self.goal_target = nn.Linear(3 * hidden, hidden)
        self.goal_hidden = nn.Sequential(
            nn.ReLU(), nn.Dropout(preset.dropout), nn.Linear(hidden, hidden), nn.ReLU()
        )
        self.score = nn.Linear(hidden, 1)
        self.complete = nn.Linear(hidden, 2 * len(KNOT_STEPS))
        if conditional:
            self.given_line = SubGraph(condition.TOKEN, hidden)
            self.target_to_given = Attention(hidden, preset.heads)
            self.film = nn.Linear(hidden, 2 * hidden)
            self.goal_met_path = nn.Linear(condition.PATH_RELATION, hidden)
            self.goal_met = nn.Linear(condition.GOAL_RELATION, hidden)
        nn.init.zeros_(self.complete.bias)
        nn.init.normal_(self.complete.weight, std=0.01)

    def forward(self, batch: dict[str, Tensor], given: Condition | None = None) -> Goals:
        """Goals of a batch of `features.Features`, under K given futures if there are any."""
        batch = _trimmed(batch)
        paths, info, speed = batch["paths"], batch["path_info"], batch["motion"][:, 0]
        along = anchors.profiles_at(self.profiles, speed)  # (B, R, 80)
        along = along.unsqueeze(1).expand(-1, paths.shape[1], -1, -1)
        elements, there = self.vectors(batch)  # (B, E, H)
        lines = self._lines(batch, elements, there)  # (B, P, H)
        goals = self.goal(_goal_features(batch, along, self.log_prior(speed)))
        goals = goals + self.goal_path(lines).unsqueeze(2) + self.profile  # (B, P, R, H)
        target = self._target(batch, elements, there, given)  # (B, K, 3H)
        goals = goals.unsqueeze(1) + self.goal_target(target)[:, :, None, None]
        if self.conditional and given is not None:
            met = condition.relations(paths, along[..., 4::5], given.position_m)
            gate = given.given[:, :, None, None]
            goals = goals + (self.goal_met_path(met[0]) * gate).unsqueeze(3)
            goals = goals + self.goal_met(met[1]) * gate.unsqueeze(4)
        hidden = self.goal_hidden(goals)  # (B, K, P, R, H)
        logits = self.score(hidden).squeeze(-1)
        logits = logits.masked_fill(info[:, None, :, None, 0] <= 0, float("-inf"))
        knots = self.complete(hidden).unflatten(-1, (len(KNOT_STEPS), 2))
        return Goals(logits=logits, along_m=along, knots=self.reach * knots.tanh(), paths=paths)

    def log_prior(self, speed_mps: Tensor) -> Tensor:
        """(B, R) log frequency of the profiles at the nearest tabulated start speeds."""
        table = self.prior.new_tensor(START_SPEEDS_MPS)
        nearest = (speed_mps.unsqueeze(-1) - table).abs().argmin(-1)
        return self.prior[nearest]

    def log_density(self, goals: Goals, position_m: Tensor, valid: Tensor) -> Tensor:
        """(B, K, P, R) log of probability times Laplace kernels at the knots, in log 1/m^2 each.

        ``position_m`` (B, K, 5, 2) are true positions, ``valid`` (B, K, 5) which of them count.
        """
        centre, tangent = goals.at_knots()
        off = position_m[:, :, None, None] - centre
        ahead = (off * tangent).sum(-1)
        left = tangent[..., 0] * off[..., 1] - tangent[..., 1] * off[..., 0]
        width = self.widths.exp().clamp_min(0.1)
        log_kernel = -ahead.abs() / width[:, 0] - left.abs() / width[:, 1]
        log_kernel = log_kernel - (4 * width[:, 0] * width[:, 1]).log()
        fit = (log_kernel * valid[:, :, None, None]).sum(-1)
        score = goals.logits.flatten(2).log_softmax(-1).view_as(goals.logits)
        return score + fit

    def _lines(self, batch: dict[str, Tensor], elements: Tensor, there: Tensor) -> Tensor:
        """(B, P, H) features of the paths: shape, what stands on them, surroundings, each other."""
        paths, info = batch["paths"], batch["path_info"]
        valid = info[..., 0] > 0
        bend = torch.nn.functional.pad(anchors.curvature(paths), (1, 1))
        tangent = torch.diff(paths, dim=2, append=2 * paths[:, :, -1:] - paths[:, :, -2:-1])
        nodes = list(_PATH_NODES)
        shape = torch.cat([paths / 60.0, tangent / NODE_SPACING_M, bend.unsqueeze(-1) * 10.0], -1)
        scale = info.new_tensor([1, 1, 0.3, 2, 0.01, 0.07, 0.02, 1, 1, 1, 1, 1, 0.3, 0.2])
        line = self.path_line(torch.cat([shape[:, :, nodes].flatten(2), info * scale], -1))
        others = batch["path_agents"]
        factor = others.new_tensor([1 / 30, 0.3, 1 / 15, 0.3, 1, 1, 0.2, 1])
        met = self.path_agents(others * factor).masked_fill(others[..., 7:8] <= 0, 0.0).amax(2)
        line = self.path_to_elements(line + met, elements, there)
        out: Tensor = self.path_to_paths(line, line, valid)
        return out

    def _target(
        self, batch: dict[str, Tensor], elements: Tensor, there: Tensor, given: Condition | None
    ) -> Tensor:
        """(B, K, 3H) the vehicle: its vectors and motion, the given future, the image."""
        scale = batch["motion"].new_tensor([1 / 15, 0.5, 2, 0.2, 0.5, 1])
        target = elements[:, :1] + self.motion(batch["motion"] * scale).unsqueeze(1)  # (B, 1, H)
        around = self.target_to_elements(target, elements, there)
        image = unpack(batch["raster"], self.preset)
        if not self.conditional:
            return torch.cat([target, around, self.image(image).unsqueeze(1)], -1)
        future = given or self._nothing_given(target)
        count = future.futures
        picture = self.image(image, future.image).unflatten(0, (-1, count))  # (B, K, H)
        line = self.given_line(future.tokens, torch.ones_like(future.tokens[..., 0]) > 0)
        gate = future.given.unsqueeze(-1)
        line = line.unflatten(0, (-1, count)) * gate  # (B, K, H)
        seen = torch.cat([elements.repeat_interleave(count, 0), line.flatten(0, 1)[:, None]], 1)
        mask = torch.cat([there.repeat_interleave(count, 0), gate.flatten(0, 1) > 0], 1)
        query = target.expand(-1, count, -1).reshape(-1, 1, target.shape[-1])
        aware = self.target_to_given(query, seen, mask).view(len(target), count, -1)
        scale, shift = (self.film(line) * gate).chunk(2, -1)
        return torch.cat([target * (1 + scale) + shift, around + aware, picture], -1)

    def _nothing_given(self, target: Tensor) -> Condition:
        """The condition that says nothing: one future per scene, switched off."""
        size = len(target)
        position = target.new_zeros(size, 1, 80, 2)
        heading = target.new_zeros(size, 1, 80)
        return condition.encode(position, heading, target.new_zeros(size, 1), self.preset)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))


def _trimmed(batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """The batch without path rows that no scene uses; valid paths come first."""
    used = max(int((batch["path_info"][..., 0] > 0).sum(1).max()), 1)
    cut = {name: batch[name][:, :used] for name in ("paths", "path_info", "path_agents")}
    return {**batch, **cut}


def _goal_features(batch: dict[str, Tensor], along: Tensor, log_prior: Tensor) -> Tensor:
    """(B, P, R, 26) distances and speeds each second, gaps, stop line, bend, prior."""
    paths, info = batch["paths"], batch["path_info"]
    seconds = along[..., 9::10]  # (B, P, R, 8) at 1..8 s
    speed = torch.diff(along, dim=-1)[..., 8::10] * 10.0
    stop = seconds[..., [3, 7]] - info[..., 6, None, None]
    over = (stop / 10.0).clamp(-2.0, 2.0) * (info[..., 8, None, None] + info[..., 9, None, None])
    node = (seconds / NODE_SPACING_M).long().clamp(0, paths.shape[2] - 3)
    bend = anchors.curvature(paths).gather(2, node.flatten(2)).view_as(node)
    sideways = (bend.abs() * speed**2).amax(-1, keepdim=True)
    length = (seconds[..., 7:] - info[..., 4, None, None]) / 20.0
    limit = info[..., 5, None, None]
    fast = ((speed.amax(-1, keepdim=True) - limit) / 10.0) * (limit > 0)
    start = batch["motion"][:, 0].view(-1, 1, 1, 1).expand_as(fast) / 15.0
    columns = [
        seconds / 50.0,
        speed / 15.0,
        _gaps(batch["path_agents"], seconds),
        over,
        (sideways / 4.0).clamp_max(3.0),
        length.clamp(-3.0, 3.0),
        fast.clamp(-3.0, 3.0),
        log_prior[:, None, :, None].expand_as(fast),
        start,
    ]
    return torch.cat(columns, -1)


def _gaps(others: Tensor, seconds: Tensor) -> Tensor:
    """(B, P, R, 3) gap to the vehicle ahead on the path at 2, 4, 8 s, if it keeps its speed."""
    ahead = (others[..., 1].abs() < 2.0) & (others[..., 0] > 0.5) & (others[..., 7] > 0)
    times = seconds.new_tensor([2.0, 4.0, 8.0])
    tail = others[..., 0:1] - 0.5 * others[..., 6:7] + others[..., 2:3] * times  # (B, P, 8, 3)
    tail = tail.masked_fill(~ahead.unsqueeze(-1), 1e3).amin(2)  # (B, P, 3)
    gap = tail.unsqueeze(2) - seconds[..., [1, 3, 7]]
    return (gap / 20.0).clamp(-1.0, 3.0)
