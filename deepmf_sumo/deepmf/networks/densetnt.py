"""DenseTNT (Gu et al. 2021) on the lane graph: score dense goals, complete the best ones.

VectorNet (Gao et al. 2020) encodes the surroundings: polylines of vectors become one feature each,
and attend to one another. With the head ``paths`` a goal is a (path, speed profile) anchor. With
the head ``dense`` it is a place of `anchors.Grid` on one of the likeliest paths; goals attend to
the elements as published. Both carry a whole timed trajectory, so that completion is a residual in
path coordinates, which joins the present pose and stays smooth. Shapes: B scenes, K given futures
(1 without condition), P paths, R goals a path, H hidden, E elements.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from deepmf_sumo.deepmf.networks import anchors, condition
from deepmf_sumo.deepmf.networks.anchors import (
    BRAKING,
    START_SPEEDS_MPS,
    GoalShape,
    Grid,
    goal_features,
)
from deepmf_sumo.deepmf.networks.condition import (
    EVERY,
    Condition,
    Following,
    GoalRelation,
    OnPaths,
    PathRelation,
    Road,
    Token,
)
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, KNOTS_S, GoalSet, Singles
from deepmf_sumo.deepmf.networks.encode import (
    DIRECTION,
    POSITION,
    POSITION_SCALE_M,
    SPEED_SCALE_MPS,
    VELOCITY,
    AgentInfo,
    AgentState,
    Features,
    LaneInfo,
    OwnMotion,
    PathAgent,
    span,
)
from deepmf_sumo.deepmf.networks.lanes import NODE_SPACING_M, PathInfo
from deepmf_sumo.deepmf.networks.vgg import VGG16, unpack

AGENT_VECTOR: Final = 18
LANE_VECTOR: Final = 16
"""Columns of `_agent_vectors` and of `_lane_vectors`."""
_UNSEEN = -1e4
"""Score of missing elements: their share is zero, and defined even if all are missing."""
_LEAST_KERNEL_M = 0.1
_REACH: Final = ((1.0, 0.5), (2.0, 1.0), (4.0, 2.0), (6.0, 3.0), (8.0, 4.0))
_DENSE_REACH: Final = ((2.0, 1.0), (5.0, 1.5), (12.0, 2.0), (8.0, 2.0), (0.0, 0.0))
"""Largest residuals along and to the left at the knots, m; a dense goal fixes the end."""
_PLACE: Final = 5
"""Columns of `_places`."""
_PATH_NODES = (0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 25, 30, 38, 47, 60, 80, 110)


class SubGraph(nn.Module):
    """Three layers of (linear, norm, ReLU, maximum, concatenate), then the maximum."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            nn.Sequential(nn.Linear(width, hidden // 2), nn.LayerNorm(hidden // 2), nn.ReLU())
            for width in (inputs, hidden, hidden)
        )

    def forward(self, vectors: Tensor, there: Tensor) -> Tensor:
        """(N, V, inputs) and mask (N, V) -> (N, hidden); zero for polylines without vectors."""
        gone = ~there.unsqueeze(-1)
        pooled = vectors
        for layer in self.layers:
            vectors = layer(vectors).masked_fill(gone, 0.0)  # ReLU: zero is below all others
            pooled = vectors.amax(1, keepdim=True).expand_as(vectors)
            vectors = torch.cat([vectors, pooled], -1)
        return vectors.amax(1)


class Attention(nn.Module):
    """Queries attend to elements (multi-head), with a residual and layer norm."""

    def __init__(self, hidden: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(hidden, hidden)
        self.keys = nn.Linear(hidden, 2 * hidden)
        self.out = nn.Linear(hidden, hidden)
        self.norm = nn.LayerNorm(hidden)

    def forward(self, queries: Tensor, elements: Tensor, there: Tensor) -> Tensor:
        """(B, Q, H) on elements (B, E, H) with mask (B, E), True where there -> (B, Q, H)."""
        query = self._heads(self.query(queries))
        key, value = map(self._heads, self.keys(elements).chunk(2, -1))
        scores = (query @ key.transpose(2, 3)).masked_fill(~there[:, None, None], _UNSEEN)
        return self._mixed(queries, self._share(scores) @ value)

    def with_own(
        self, query: Tensor, elements: Tensor, there: Tensor, own: Tensor, own_there: Tensor
    ) -> Tensor:
        """One query (B, 1, H) in K situations: each adds an element of its own to the shared ones.

        ``own`` (B, K, H) with mask (B, K) -> (B, K, H): as attending to (B*K, E + 1, H), but the
        keys of the shared elements are made once.
        """
        asked = self._heads(self.query(query))  # (B, heads, 1, D)
        key, value = map(self._heads, self.keys(elements).chunk(2, -1))
        own_key, own_value = map(self._heads, self.keys(own).chunk(2, -1))  # (B, heads, K, D)
        shared = (asked @ key.transpose(2, 3)).masked_fill(~there[:, None, None], _UNSEEN)
        alone = (asked @ own_key.transpose(2, 3)).masked_fill(~own_there[:, None, None], _UNSEEN)
        shared = shared.expand(-1, -1, own.shape[1], -1)  # (B, heads, K, E)
        share = self._share(torch.cat([shared, alone.transpose(2, 3)], -1))
        return self._mixed(query, share[..., :-1] @ value + share[..., -1:] * own_value)

    def _heads(self, vectors: Tensor) -> Tensor:
        """(B, N, H) -> (B, heads, N, D)."""
        return vectors.reshape(*vectors.shape[:2], self.heads, -1).transpose(1, 2)

    def _share(self, scores: Tensor) -> Tensor:
        return (scores / (self.query.out_features // self.heads) ** 0.5).softmax(-1)

    def _mixed(self, queries: Tensor, seen: Tensor) -> Tensor:
        """Queries (B, Q or 1, H) and what their heads saw (B, heads, Q, D) -> (B, Q, H)."""
        return self.norm(queries + self.out(seen.transpose(1, 2).flatten(2)))


class VectorNet(nn.Module):
    """Agents and lane pieces around a pose -> one feature each, aware of the others."""

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.agents = SubGraph(AGENT_VECTOR, preset.hidden)
        self.lanes = SubGraph(LANE_VECTOR, preset.hidden)
        self.everything = Attention(preset.hidden, preset.heads)

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """`encode.Features` -> features (B, A+L, H), agents first, and the mask (B, A+L)."""
        vectors, there = _agent_vectors(batch["agents"], batch["agent_info"])
        agents = self.agents(vectors.flatten(0, 1), there.flatten(0, 1))  # (B*A, H)
        pieces, lane_there = _lane_vectors(batch["lanes"], batch["lane_info"])
        lanes = self.lanes(pieces.flatten(0, 1), lane_there.flatten(0, 1))  # (B*L, H)
        size = len(batch["agents"])
        elements = torch.cat([agents.view(size, -1, agents.shape[-1]),
                              lanes.view(size, -1, lanes.shape[-1])], 1)  # fmt: skip
        mask = (
            torch.cat(
                [
                    batch["agent_info"][..., AgentInfo.THERE],
                    batch["lane_info"][..., LaneInfo.THERE],
                ],
                1,
            )
            > 0
        )
        return self.everything(elements, elements, mask), mask


def _agent_vectors(agents: Tensor, info: Tensor) -> tuple[Tensor, Tensor]:
    """(B, A, 11, 7) and (B, A, 8) -> ten vectors an agent (B, A, 10, 18) and their mask."""
    start, end = agents[..., :-1, :], agents[..., 1:, :]
    there = (start[..., AgentState.SEEN] > 0) & (end[..., AgentState.SEEN] > 0)
    when = torch.linspace(-1.0, -0.1, 10, device=agents.device).expand(there.shape)
    kinds = info[..., span(AgentInfo.LENGTH, AgentInfo.AV)]
    kinds = kinds * info.new_tensor([0.2, 0.5, 1, 1, 1, 1, 1])
    vectors = torch.cat(
        [
            start[..., POSITION] / POSITION_SCALE_M,
            end[..., POSITION] / POSITION_SCALE_M,
            end[..., DIRECTION],
            end[..., VELOCITY] / SPEED_SCALE_MPS,
            end[..., POSITION] - start[..., POSITION],
            when.unsqueeze(-1),
            kinds.unsqueeze(-2).expand(*there.shape, -1),
        ],
        -1,
    )
    return vectors, there


def _lane_vectors(lanes: Tensor, info: Tensor) -> tuple[Tensor, Tensor]:
    """(B, L, 10, 2) and (B, L, 10) -> nine vectors a piece (B, L, 9, 16) and their mask."""
    start, end = lanes[..., :-1, :], lanes[..., 1:, :]
    there = (info[..., LaneInfo.THERE, None] > 0).expand(start.shape[:-1])
    share = torch.linspace(0.0, 1.0, 9, device=lanes.device).expand(there.shape)
    kinds = info[..., span(LaneInfo.FREEWAY, LaneInfo.UNKNOWN)]
    kinds = kinds * info.new_tensor([1, 1, 1, 1, 1 / SPEED_SCALE_MPS, 1, 1, 1, 1])
    vectors = torch.cat(
        [
            start / POSITION_SCALE_M,
            end / POSITION_SCALE_M,
            (end - start) / 2.0,
            share.unsqueeze(-1),
            kinds.unsqueeze(-2).expand(*there.shape, -1),
        ],
        -1,
    )
    return vectors, there


@dataclass(frozen=True, slots=True, kw_only=True)
class Goals:
    """All goals of a batch.

    Attributes:
        logits: (B, K, P, R), -inf on paths that do not exist.
        along_m: (B, P, R, 80) distances of the anchors.
        knots: (B, K, P, R, 5, 2) residual along and to the left at 1, 2, 4, 6, 8 s, metres.
        paths: (B, P, 121, 2).
        lanes: (B, P) scores of the paths; None unless the head is dense.
        counts: (B) number of goals of a path that are within the vehicle's reach, likewise.
    """

    logits: Tensor
    along_m: Tensor
    knots: Tensor
    paths: Tensor
    lanes: Tensor | None = None
    counts: Tensor | None = None

    def at_knots(self) -> tuple[Tensor, Tensor]:
        """Positions and path tangents (B, K, P, R, 5, 2) at 1, 2, 4, 6, 8 s."""
        along = self.along_m[:, None, :, :, list(KNOT_STEPS)] + self.knots[..., 0]
        along = along.clamp_min(0.0).transpose(1, 2)  # (B, P, K, R, knots)
        left = self.knots[..., 1].transpose(1, 2)
        position, tangent = anchors.placed(self.paths, along, left)
        return position.transpose(1, 2), tangent.transpose(1, 2)

    def sets(self) -> list[GoalSet]:
        """The goals of each vehicle of the batch, for `decode`.

        Dense goals are cut to the vehicle's own reach: others of the batch must not matter.
        """
        parts = (self.logits, self.along_m, self.knots, self.paths)
        each = zip(*(part.cpu().numpy() for part in parts), strict=True)
        size = self.logits.shape[-1]
        counts = [size] * len(self.logits) if self.counts is None else self.counts.tolist()
        return [
            GoalSet(
                logits=logits[..., :count],
                along_m=along_m[:, :count],
                knots=knots[:, :, :count],
                paths=paths,
                block=1 if self.counts is None else anchors.block(count),
            )
            for (logits, along_m, knots, paths), count in zip(each, counts, strict=True)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoding:
    """A batch before any future is given; ``goals`` (B, P, R, H) are without the target's part.

    Attributes:
        paths: (B, P, 121, 2). exists: (B, P). along_m: (B, P, R, 80).
        elements, there: (B, E, H), (B, E) of VectorNet.
        target, around: (B, 1, H) the vehicle, and the elements it attends to.
        road: input of the car-following model.
        image: (B, C, S', S') of the blocks of VGG16 that all given futures share.
        grid, lanes: the dense goals, and scores of the paths (B, P).
    """

    paths: Tensor
    exists: Tensor
    along_m: Tensor
    elements: Tensor
    there: Tensor
    goals: Tensor
    target: Tensor
    around: Tensor
    road: Road
    image: Tensor | None
    grid: Grid | None = None
    lanes: Tensor | None = None


class DenseTNT(nn.Module):
    """Scores and completes the dense goals of one vehicle; ``conditional`` takes given futures.

    Buffers ``profiles`` (13, R, 80) and ``prior`` (13, R) come from training data; a
    conditional network also has those of `anchors.BRAKING`, as the last six; the head ``dense``
    has neither. ``widths`` (5, 2) are the log scales of the Laplace kernels along and across at the
    knots.
    """

    profiles: Tensor
    prior: Tensor
    reach: Tensor

    def __init__(self, preset: Preset, *, conditional: bool = False) -> None:
        super().__init__()
        hidden = preset.hidden
        self.preset = preset
        self.conditional = conditional
        self.dense = preset.head == "dense"
        reach = _DENSE_REACH if self.dense else _REACH
        self.register_buffer("reach", torch.tensor(reach))
        self.widths = nn.Parameter(torch.tensor(_REACH).mul(0.4).log())
        self.vectors = VectorNet(preset) if preset.vectors else None
        self.image = VGG16(preset, conditional=conditional) if preset.raster else None
        self.motion = _mlp(len(OwnMotion), hidden, hidden)
        self.path_line = _mlp(len(_PATH_NODES) * 5 + len(PathInfo), hidden, hidden)
        self.path_agents = _mlp(len(PathAgent), hidden // 2, hidden)
        self.path_to_elements = Attention(hidden, preset.heads)
        self.path_to_paths = Attention(hidden, preset.heads)
        self.target_to_elements = Attention(hidden, preset.heads)
        if self.dense:
            self.lane = _mlp(hidden, hidden, 1)
            self.goal = nn.Linear(len(GoalShape) + _PLACE, hidden)
            self.goal_to_elements = Attention(hidden, preset.heads)
        else:
            profiles = preset.profiles + (len(BRAKING) if conditional else 0)
            self.register_buffer("profiles", torch.zeros(len(START_SPEEDS_MPS), profiles, 80))
            self.register_buffer("prior", torch.zeros(len(START_SPEEDS_MPS), profiles))
            self.goal = nn.Linear(len(GoalShape), hidden)
            self.profile = nn.Parameter(torch.zeros(profiles, hidden))
        self.goal_path = nn.Linear(hidden, hidden)
        self.goal_target = nn.Linear(3 * hidden, hidden)
        self.goal_hidden = nn.Sequential(
            nn.ReLU(inplace=True),
            nn.Dropout(preset.dropout),
            nn.Linear(hidden, hidden),
            nn.ReLU(inplace=True),
        )
        self.score = nn.Linear(hidden, 1)
        self.complete = nn.Linear(hidden, 2 * len(KNOT_STEPS))
        if conditional:
            self.given_line = SubGraph(len(Token), hidden)
            self.target_to_given = Attention(hidden, preset.heads)
            self.film = nn.Linear(hidden, 2 * hidden)
            self.goal_met_path = nn.Linear(len(PathRelation), hidden)
            self.goal_met = nn.Linear(len(GoalRelation), hidden)
            if preset.reactive:
                self.goal_follow = nn.Linear(len(Following), hidden, bias=False)
        nn.init.zeros_(self.complete.bias)
        nn.init.normal_(self.complete.weight, std=0.01)

    def forward(
        self,
        batch: dict[str, Tensor],
        given: Condition | None = None,
        grid: Grid | None = None,
    ) -> Goals:
        """Goals of a batch of `encode.Features`, under K given futures if there are any.

        ``grid``: only these dense goals, on all paths that the batch uses.
        """
        return self.decode(self.encode(trimmed(batch), grid), given)

    @property
    def kernel_m(self) -> Singles:
        """See `predict.TrajectoryNetwork`."""
        width: Singles = self._kernels().detach().cpu().numpy()
        return width

    def _kernels(self) -> Tensor:
        """(5, 2) widths of the kernels. A dense goal stands for a square metre around its end."""
        width = self.widths.exp().clamp_min(_LEAST_KERNEL_M)
        if self.dense:
            width = torch.cat([width[:-1], torch.full_like(width[-1:], anchors.SPACING_M / 2)])
        return width

    @torch.inference_mode()
    def scene_of(self, arrays: Features) -> Encoding:
        """See `predict.TrajectoryNetwork`."""
        return self.encode(trimmed(as_batch(arrays, self.widths.device)))

    @torch.inference_mode()
    def goals_of(
        self,
        encoding: Encoding,
        position_m: Singles | None = None,
        heading_rad: Singles | None = None,
    ) -> GoalSet:
        """See `predict.TrajectoryNetwork`."""
        given = None
        if position_m is not None and heading_rad is not None:
            device = self.widths.device
            parts = (torch.from_numpy(one)[None] for one in (position_m, heading_rad))
            position, heading = (each.to(device) for each in parts)
            there = torch.ones(1, len(position_m), device=device)
            given = Condition.of(position, heading, there, self.preset)
        return self.decode(encoding, given).sets()[0]

    def encode(self, batch: dict[str, Tensor], grid: Grid | None = None) -> Encoding:
        """The encoding of a batch of `encode.Features`, which no given future changes."""
        elements, there = self._elements(batch)  # (B, E, H)
        lines = self._lines(batch, elements, there)  # (B, P, H)
        lanes = None
        if self.dense:
            exists = batch["path_info"][..., PathInfo.THERE] > 0
            lanes = self.lane(lines).squeeze(-1).masked_fill(~exists, float("-inf"))
            if grid is None:
                batch, lines, lanes = _likeliest(batch, lines, lanes)
                grid = anchors.every(
                    batch["paths"], lanes.isfinite(), batch["motion"][:, OwnMotion.SPEED]
                )
        target = elements[:, :1] + self.motion(self._motion(batch["motion"])).unsqueeze(1)
        along, goals = self._goals(batch, lines, grid, elements, there)
        image = self.image.shared(unpack(batch["raster"], self.preset)) if self.image else None
        return Encoding(
            paths=batch["paths"],
            exists=batch["path_info"][..., PathInfo.THERE] > 0,
            along_m=along,
            elements=elements,
            there=there,
            goals=goals,
            target=target,
            around=self.target_to_elements(target, elements, there),
            road=Road.of(batch),
            image=image,
            grid=grid,
            lanes=lanes,
        )

    def _goals(
        self,
        batch: dict[str, Tensor],
        lines: Tensor,
        grid: Grid | None,
        elements: Tensor,
        there: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Distances (B, P, R, 80) and features (B, P, R, H) of the goals."""
        paths, speed = batch["paths"], batch["motion"][:, OwnMotion.SPEED]
        line = self.goal_path(lines).unsqueeze(2)
        if grid is None:
            prior = self.log_prior(speed)
            along = anchors.profiles_at(self.profiles, speed)  # (B, R, 80)
            along = along.unsqueeze(1).expand(-1, paths.shape[1], -1, -1)
            goals = self.goal(goal_features(batch, along, prior))
            return along, goals + line + self.profile
        along = anchors.driven(grid.along_m, speed)
        none = along.new_zeros(along.shape[0], along.shape[2])  # they have no frequency
        shape = torch.cat([goal_features(batch, along, none), _places(paths, grid)], -1)
        goals = self.goal(shape) + line
        return along, self.goal_to_elements(goals.flatten(1, 2), elements, there).view_as(goals)

    def decode(self, scene: Encoding, given: Condition | None = None) -> Goals:
        """Goals under K given futures if there are any."""
        target = self._target(scene, given)  # (B, K, 3H)
        context = self.goal_target(target).unsqueeze(2)  # (B, K, 1, H)
        if self.conditional and given is not None:
            along = scene.along_m[..., EVERY - 1 :: EVERY]
            on_paths = OnPaths.of(scene.paths, given.position_m)
            met = condition.relations(scene.paths, along, given.position_m, on_paths)
            follow = None
            if self.preset.reactive:
                follow = condition.following(scene.road, along, given, on_paths)
            gate = given.given[:, :, None, None]
            context = context + (self.goal_met_path(met[0]) + self.goal_met.bias) * gate
            goals = scene.goals.unsqueeze(1) + context.unsqueeze(3)
            _add_product(goals, met[1].mul_(gate.unsqueeze(4)), self.goal_met.weight)
            if follow is not None:
                _add_product(goals, follow.mul_(gate.unsqueeze(4)), self.goal_follow.weight)
        else:
            goals = scene.goals.unsqueeze(1) + context.unsqueeze(3)
        score, residual = self._heads(self.goal_hidden(goals))
        knots = self.reach * residual.tanh()
        exists, counts = scene.exists[:, None, :, None], None
        if scene.grid is not None:
            exists = scene.grid.there.unsqueeze(1)
            score = score + scene.grid.log_count.unsqueeze(1)
            knots = _towards_the_end(knots, scene.along_m, scene.grid.left_m)
            counts = anchors.within_reach(scene.road.speed_mps)
        return Goals(
            logits=score.masked_fill(~exists, float("-inf")),
            along_m=scene.along_m,
            knots=knots,
            paths=scene.paths,
            lanes=scene.lanes,
            counts=counts,
        )

    def _heads(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Scores (B, K, P, R) and residuals (B, K, P, R, 5, 2) of goals (B, K, P, R, H).

        One product with the few outputs as rows: on CPUs three times as fast as with columns.
        """
        weight = torch.cat([self.score.weight, self.complete.weight])
        bias = torch.cat([self.score.bias, self.complete.bias])
        rows = torch.addmm(bias.unsqueeze(1), weight, hidden.flatten(0, 3).T)
        score, residual = rows[0], rows[1:]
        return score.view(hidden.shape[:4]), residual.view(
            len(KNOT_STEPS), 2, *hidden.shape[:4]
        ).movedim((0, 1), (-2, -1))

    def log_prior(self, speed_mps: Tensor) -> Tensor:
        """(B, R) log frequency of the profiles at the nearest tabulated start speeds."""
        table = self.prior.new_tensor(START_SPEEDS_MPS)
        nearest = (speed_mps.unsqueeze(-1) - table).abs().argmin(-1)
        return self.prior[nearest]

    def log_density(self, goals: Goals, position_m: Tensor, valid: Tensor) -> Tensor:
        """(B, K, P, R) log of probability times Laplace kernels at the knots, in log 1/m^2 each.

        ``position_m`` (B, K, 5, 2) are true positions, ``valid`` (B, K, 5) which of them count.
        """
        # Each axis by itself, goals and knots in rows: three times as fast as vectors of two.
        centre, tangent = goals.at_knots()
        goal_x, goal_y = centre.flatten(2, 3).unbind(-1)  # (B, K', N, 5)
        cos, sin = (each.contiguous() for each in tangent.flatten(2, 3).unbind(-1))
        x, y = position_m.unsqueeze(2).unbind(-1)  # (B, K, 1, 5)
        ahead = cos * x + sin * y - (cos * goal_x + sin * goal_y)
        left = cos * y - sin * x - (cos * goal_y - sin * goal_x)
        width = self._kernels()
        log_kernel = -ahead.abs() / width[:, 0] - left.abs() / width[:, 1]
        log_kernel = log_kernel - (4 * width[:, 0] * width[:, 1]).log()
        fit = (log_kernel * valid.unsqueeze(2)).sum(-1)  # (B, K, N)
        score = goals.logits.flatten(2).log_softmax(-1)
        return (score + fit).view(*fit.shape[:2], *goals.logits.shape[2:])

    def _lines(self, batch: dict[str, Tensor], elements: Tensor, there: Tensor) -> Tensor:
        """(B, P, H) features of the paths: shape, agents on them, surroundings, each other."""
        paths, info = batch["paths"], batch["path_info"]
        valid = info[..., PathInfo.THERE] > 0
        bend = torch.nn.functional.pad(anchors.curvature(paths), (1, 1))
        tangent = torch.diff(paths, dim=2, append=2 * paths[:, :, -1:] - paths[:, :, -2:-1])
        nodes = list(_PATH_NODES)
        shape = torch.cat([paths / 60.0, tangent / NODE_SPACING_M, bend.unsqueeze(-1) * 10.0], -1)
        scale = info.new_tensor([1, 1, 0.3, 2, 0.01, 0.07, 0.02, 1, 1, 1, 1, 1, 0.3, 0.2])
        line = self.path_line(torch.cat([shape[:, :, nodes].flatten(2), info * scale], -1))
        others = batch["path_agents"]
        factor = others.new_tensor([1 / 30, 0.3, 1 / 15, 0.3, 1, 1, 0.2, 1])
        gone = others[..., PathAgent.THERE, None] <= 0
        met = self.path_agents(others * factor).masked_fill(gone, 0.0).amax(2)
        line = self.path_to_elements(line + met, elements, there)
        return self.path_to_paths(line, line, valid)

    def _target(self, scene: Encoding, given: Condition | None) -> Tensor:
        """(B, K, 3H) the vehicle: its vectors and motion, the given future, the image."""
        target = scene.target
        if not self.conditional:
            return torch.cat([target, scene.around, self._picture(scene, None)], -1)
        future = given or self._nothing_given(target)
        count = future.futures
        line = self.given_line(future.tokens, torch.ones_like(future.tokens[..., 0]) > 0)
        gate = future.given.unsqueeze(-1)
        line = line.unflatten(0, (-1, count)) * gate  # (B, K, H)
        aware = self.target_to_given.with_own(
            target, scene.elements, scene.there, line, future.given > 0
        )
        scale, shift = (self.film(line) * gate).chunk(2, -1)
        picture = self._picture(scene, future)
        return torch.cat([target * (1 + scale) + shift, scene.around + aware, picture], -1)

    def _motion(self, motion: Tensor) -> Tensor:
        """(B) of `encode.OwnMotion`, scaled; take-over times only for reactive networks."""
        scaled = motion * motion.new_tensor([1 / 15, 0.5, 2, 0.2, 0.5, 1, 1])
        if not self.preset.reactive:
            scaled[:, OwnMotion.PLANNER].clamp_(max=1.0)
        return scaled

    def _elements(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """(B, E, H) of VectorNet, the vehicle first, and the mask (B, E); one zero without it."""
        if self.vectors is not None:
            elements, there = self.vectors(batch)
            return elements, there
        nothing = batch["motion"].new_zeros(len(batch["motion"]), 1, self.preset.hidden)
        return nothing, nothing[..., 0] == 0

    def _picture(self, scene: Encoding, given: Condition | None) -> Tensor:
        """(B, K, H) of VGG16, K = 1 without condition; zero without it."""
        count = given.futures if given else 1
        if self.image is None or scene.image is None:
            return scene.target.new_zeros(len(scene.target), count, self.preset.hidden)
        picture: Tensor = self.image(scene.image, given.image if given else None)
        return picture.view(-1, count, self.preset.hidden)

    def _nothing_given(self, target: Tensor) -> Condition:
        """The empty condition: one future for each scene, switched off."""
        size = len(target)
        position = target.new_zeros(size, 1, 80, 2)
        heading = target.new_zeros(size, 1, 80)
        return Condition.of(position, heading, target.new_zeros(size, 1), self.preset)


def _add_product(goals: Tensor, columns: Tensor, weight: Tensor) -> None:
    """Add (B, K, P, R, C) columns times a weight (H, C) to goals (B, K, P, R, H)."""
    if torch.is_inference_mode_enabled() and goals.dtype == columns.dtype:
        # without a copy as large as the goals: twice as fast
        goals.view(-1, goals.shape[-1]).addmm_(columns.flatten(0, 3), weight.T)
    else:
        goals += nn.functional.linear(columns, weight)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))


def as_batch(features: Features, device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """A batch of one scene."""
    return {name: torch.from_numpy(values)[None].to(device) for name, values in features.items()}


def trimmed(batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """The batch without path rows that no scene uses; valid paths come first."""
    used = max(int((batch["path_info"][..., PathInfo.THERE] > 0).sum(1).max()), 1)
    cut = {name: batch[name][:, :used] for name in ("paths", "path_info", "path_agents")}
    return {**batch, **cut}


def _towards_the_end(knots: Tensor, along_m: Tensor, left_m: Tensor) -> Tensor:
    """Knots (B, K, P, R, 5, 2) of dense goals, which lie ahead of all that is driven before.

    Without residuals the vehicle moves sideways by ``left_m`` (B, P, R), first and last slowly.
    """
    at = along_m[..., list(KNOT_STEPS)]
    along = torch.minimum(knots[..., 0], (at[..., -1:] - at).unsqueeze(1))
    ease = knots.new_tensor(KNOTS_S) / KNOTS_S[-1]
    left = left_m[:, None, :, :, None] * ease.square() * (3.0 - 2.0 * ease)
    return torch.stack([along, knots[..., 1] + left], -1)


def _likeliest(
    batch: dict[str, Tensor], lines: Tensor, lanes: Tensor
) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """The batch, features and scores of the `anchors.LANES` likeliest paths, in their order."""
    best = lanes.topk(min(anchors.LANES, lanes.shape[1]), -1).indices.sort(-1).values
    row = torch.arange(len(best), device=best.device).unsqueeze(1)
    cut = {name: batch[name][row, best] for name in ("paths", "path_info", "path_agents")}
    return {**batch, **cut}, lines[row, best], lanes[row, best]


def _places(paths: Tensor, grid: Grid) -> Tensor:
    """(B, P, R, 5) where the dense goals are, and in which direction their paths go."""
    position, tangent = anchors.placed(paths, grid.along_m, grid.left_m)
    return torch.cat([position / 60.0, tangent, grid.left_m.unsqueeze(-1) / 2.0], -1)
