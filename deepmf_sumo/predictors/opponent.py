"""phi(X): which vehicle suits as the opponent (paper, section IV-B)."""

import numpy as np
import torch
from torch import Tensor, nn

from deepmf_sumo.datatypes import OpponentScores, View
from deepmf_sumo.predictors.completion import as_batch
from deepmf_sumo.predictors.opponent_features import OTHERS, PAIR, opponent_features
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.predictors.raster import unpack
from deepmf_sumo.predictors.vectornet import VectorNet
from deepmf_sumo.predictors.vgg import VGG16

MEMBERS = 2
"""Networks on the pair features, trained side by side; their logits are averaged."""

_RARE = -2.3
"""log(.09 / .91): the share of positive vehicles, where training starts."""
_DROPOUT = 0.2
_SCENE_DROPOUT = 0.5
"""More on what comes from the whole scene: there are few scenes to learn it from."""
_HEADS = 4
_MOST_DEVIATIONS = 4.0


class Block(nn.Module):
    """Residual layers with norm before: attention among the vehicles (optional), then an MLP."""

    def __init__(self, hidden: int, *, attends: bool) -> None:
        super().__init__()
        self.attends = attends
        if attends:
            self.before = nn.LayerNorm(hidden)
            self.keys = nn.Linear(hidden, 3 * hidden)
            self.out = nn.Linear(hidden, hidden)
        self.mlp = nn.Sequential(
            nn.LayerNorm(hidden),
            nn.Linear(hidden, 2 * hidden),
            nn.ReLU(),
            nn.Dropout(_DROPOUT),
            nn.Linear(2 * hidden, hidden),
            nn.Dropout(_DROPOUT),
        )

    def forward(self, vehicles: Tensor, there: Tensor) -> Tensor:
        """(B, V, H) and mask (B, V) -> (B, V, H)."""
        if self.attends:
            vehicles = vehicles + self._mixed(vehicles, there)
        out: Tensor = vehicles + self.mlp(vehicles)
        return out

    def _mixed(self, vehicles: Tensor, there: Tensor) -> Tensor:
        size, count, hidden = vehicles.shape
        parts = self.keys(self.before(vehicles)).view(size, count, 3, _HEADS, hidden // _HEADS)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        scores = query @ key.transpose(2, 3) / (hidden // _HEADS) ** 0.5
        scores = scores.masked_fill(~there[:, None, None], -1e4)
        mixed = (scores.softmax(-1) @ value).transpose(1, 2).reshape(size, count, hidden)
        return nn.functional.dropout(self.out(mixed), _DROPOUT, self.training)


class Member(nn.Module):
    """Pair features and the scene's -> two logits of each vehicle."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.pair = nn.Sequential(nn.Dropout(_DROPOUT / 2), nn.Linear(PAIR, hidden))
        added = nn.Linear(3 * hidden, hidden)
        nn.init.zeros_(added.weight)  # begins as a network on pairs alone
        self.scene = nn.Sequential(nn.LayerNorm(3 * hidden), nn.Dropout(_SCENE_DROPOUT), added)
        self.blocks = nn.ModuleList(
            Block(hidden, attends=attends) for attends in (False, True, False)
        )
        heads = nn.Linear(hidden, 2)
        nn.init.constant_(heads.bias, _RARE)
        self.heads = nn.Sequential(nn.LayerNorm(hidden), heads)

    def forward(self, pair: Tensor, scene: Tensor | None, there: Tensor) -> Tensor:
        """(B, V, P), (B, V, 3H) or None, mask (B, V) -> (B, V, 2)."""
        vehicles = self.pair(pair)
        if scene is not None:
            vehicles = vehicles + self.scene(scene)
        for block in self.blocks:
            vehicles = block(vehicles, there)
        logits: Tensor = self.heads(vehicles)
        return logits


class OpponentNet(nn.Module):
    """VectorNet and VGG16 around the AV, then MLP and FC for each vehicle; two heads.

    The first head learns the paper's pseudo-labels, the second which vehicle is the labelled
    interacting partner. What decides is each vehicle's relation to the AV (`opponent_features`),
    so the residual path begins there, and what the two encoders find is added to it.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.preset = preset
        self.scale = nn.BatchNorm1d(PAIR, affine=False, momentum=0.02)
        self.vectors = VectorNet(preset) if preset.vectors else None
        self.image = VGG16(preset) if preset.raster else None
        self.members = nn.ModuleList(Member(preset.hidden) for _ in range(MEMBERS))

    def forward(self, batch: dict[str, Tensor]) -> Tensor:
        """Arrays of `opponent_features` -> logits (M, B, 63, 2) of each member; 0 in free slots."""
        there = batch["vehicle"] > 0
        used = max(int(there.sum(1).max()), 1)
        there = there[:, :used]
        pair = self._scaled(batch["pair"][:, :used], there)
        scene = self._scene(batch, used)
        logits = torch.stack([member(pair, scene, there) for member in self.members])
        logits = logits.masked_fill(~there[None, ..., None], 0.0)
        return nn.functional.pad(logits, (0, 0, 0, OTHERS - used))

    def _scaled(self, pair: Tensor, there: Tensor) -> Tensor:
        """Each feature in standard deviations over the vehicles that are there."""
        scaled = torch.zeros_like(pair)
        if there.any():
            rows = self.scale(pair[there]) if there.sum() > 1 or not self.training else pair[there]
            scaled[there] = rows.clamp(-_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        return scaled

    def _scene(self, batch: dict[str, Tensor], used: int) -> Tensor | None:
        """(B, V, 3H) the vehicle and the AV from VectorNet, the image from VGG16."""
        if self.vectors is None and self.image is None:
            return None
        size, hidden = len(batch["pair"]), self.preset.hidden
        parts = [batch["pair"].new_zeros(size, used, hidden)] * 3
        if self.vectors is not None:
            elements, _ = self.vectors(batch)
            parts[0] = elements[:, 1 : used + 1]
            parts[1] = elements[:, :1].expand(-1, used, -1)
        if self.image is not None:
            image = self.image(self.image.shared(unpack(batch["raster"], self.preset)))
            parts[2] = image.unsqueeze(1).expand(-1, used, -1)
        return torch.cat(parts, -1)


class Opponent:
    """Scores of all candidates in a view.

    Args:
        net: in evaluation mode.
        temperature, partner_temperature: divide the logits, so that their sigmoid is calibrated.
        offset: added to those of the first head thereafter.
    """

    def __init__(
        self,
        net: OpponentNet,
        temperature: float,
        partner_temperature: float,
        offset: float = 0.0,
    ) -> None:
        self.net = net.eval()
        self.temperature = temperature
        self.partner_temperature = partner_temperature
        self.offset = offset

    @torch.inference_mode()
    def score(self, view: View, *, everyone: bool = False) -> OpponentScores:
        """Logits of both heads for vehicles within 80 m, nearest first.

        Parked vehicles are left out, as they cannot attack, but with ``everyone``.
        """
        arrays, around = opponent_features(view, self.net.preset)
        keep = np.flatnonzero(everyone | ~around.parked)
        logits = self.net(as_batch(arrays)).mean(0)[0].double().numpy()[keep]
        ids = around.ids(view)
        return OpponentScores(
            ids=tuple(ids[row] for row in keep),
            logits=logits[:, 0] / self.temperature + self.offset,
            partner_logits=logits[:, 1] / self.partner_temperature,
        )
