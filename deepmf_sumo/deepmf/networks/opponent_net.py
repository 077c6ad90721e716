"""The network of the opponent predictor: VectorNet, VGG16, and attention among the vehicles."""

from typing import Final

import torch
from torch import Tensor, nn

from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.densetnt import VectorNet, as_batch
from deepmf_sumo.deepmf.networks.encode import Features
from deepmf_sumo.deepmf.networks.opponent import OTHERS, SLOTS, Pair
from deepmf_sumo.deepmf.networks.vgg import VGG16, unpack
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.scene import Floats

MEMBERS: Final = 2
"""Heads, trained side by side; their logits are averaged."""

_RARE = -2.3
"""log(.09 / .91): the share of positive vehicles, where training starts."""
_DROPOUT = 0.2
_SCENE_DROPOUT = 0.5
"""Of the scene's features beside pairs: few scenes have to teach them."""
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
        return vehicles + self.mlp(vehicles)

    def _mixed(self, vehicles: Tensor, there: Tensor) -> Tensor:
        size, count, hidden = vehicles.shape
        parts = self.keys(self.before(vehicles)).view(size, count, 3, _HEADS, hidden // _HEADS)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        scores = query @ key.transpose(2, 3) / (hidden // _HEADS) ** 0.5
        scores = scores.masked_fill(~there[:, None, None], -1e4)
        mixed = (scores.softmax(-1) @ value).transpose(1, 2).reshape(size, count, hidden)
        return nn.functional.dropout(self.out(mixed), _DROPOUT, self.training)


class Member(nn.Module):
    """Pair features and scene features -> two logits of each vehicle."""

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        hidden = preset.hidden
        self.pair, dropout = None, _DROPOUT
        if preset.pairs:
            self.pair = nn.Sequential(nn.Dropout(_DROPOUT / 2), nn.Linear(len(Pair), hidden))
            dropout = _SCENE_DROPOUT
        added = nn.Linear(3 * hidden, hidden)
        if preset.pairs:
            nn.init.zeros_(added.weight)  # begins as a network on pairs alone
        self.scene = nn.Sequential(nn.LayerNorm(3 * hidden), nn.Dropout(dropout), added)
        self.blocks = nn.ModuleList(
            Block(hidden, attends=attends) for attends in (False, preset.mixing, False)
        )
        heads = nn.Linear(hidden, 2)
        nn.init.constant_(heads.bias, _RARE)
        self.heads = nn.Sequential(nn.LayerNorm(hidden), heads)

    def forward(self, pair: Tensor | None, scene: Tensor | None, there: Tensor) -> Tensor:
        """(B, V, P) or None, (B, V, 3H) or None, mask (B, V) -> (B, V, 2)."""
        parts = [] if self.pair is None else [self.pair(pair)]
        if scene is not None:
            parts.append(self.scene(scene))
        vehicles: Tensor = sum(parts[1:], parts[0])
        for block in self.blocks:
            vehicles = block(vehicles, there)
        return self.heads(vehicles)


class OpponentNet(nn.Module):
    """VectorNet and VGG16 around the AV, then MLP and FC for each vehicle; two heads.

    The first head learns the paper's pseudo-labels, the second which vehicle is the labelled
    interaction partner. Each vehicle's relation to the AV (`opponent_features`) matters most, so
    the residual path starts with it, and the outputs of the two encoders are added. Without
    pairs, as published, it has the two encoders alone.

    Raises WeightsError for a preset with neither pairs nor vectors.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        if not (preset.pairs or preset.vectors):
            raise WeightsError("The opponent network needs 'pairs' or 'vectors' of each vehicle.")
        self.preset = preset
        if preset.pairs:
            self.scale = nn.BatchNorm1d(len(Pair), affine=False, momentum=0.02)
        self.vectors = VectorNet(preset) if preset.vectors else None
        self.image = VGG16(preset) if preset.raster else None
        self.members = nn.ModuleList(Member(preset) for _ in range(MEMBERS))

    @torch.inference_mode()
    def scored(self, arrays: Features) -> Floats:
        """See `opponent.OpponentNetwork`."""
        device = next(self.parameters()).device
        logits: Floats = self(as_batch(arrays, device)).mean(0)[0].cpu().double().numpy()
        return logits

    def forward(self, batch: dict[str, Tensor]) -> Tensor:
        """Arrays of `opponent_features` -> logits (M, B, 63, 2) of each member; 0 in free slots."""
        used = max(int((batch["vehicle"] > 0).sum(1).max()), 1)
        slots = {name: batch[name][:, :used] for name in SLOTS if name in batch}
        return nn.functional.pad(self.logits({**batch, **slots}), (0, 0, 0, OTHERS - used))

    def logits(self, batch: dict[str, Tensor]) -> Tensor:
        """(M, B, V, 2) as `forward`, of a batch whose `SLOTS` are cut to V."""
        there = batch["vehicle"] > 0
        pair = self._scaled(batch["pair"], there) if self.preset.pairs else None
        scene = self._scene(batch, there.shape[1])
        logits = torch.stack([member(pair, scene, there) for member in self.members])
        return logits.masked_fill(~there[None, ..., None], 0.0)

    def _scaled(self, pair: Tensor, there: Tensor) -> Tensor:
        """Each feature in standard deviations over the vehicles that are there."""
        if not self.training:
            scaled = self.scale(pair.flatten(0, 1)).view_as(pair)
            scaled = scaled.clamp(-_MOST_DEVIATIONS, _MOST_DEVIATIONS)
            return scaled.masked_fill(~there.unsqueeze(-1), 0.0)
        scaled = torch.zeros_like(pair)
        if there.any():
            rows = self.scale(pair[there]) if there.sum() > 1 else pair[there]
            scaled[there] = rows.clamp(-_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        return scaled

    def _scene(self, batch: dict[str, Tensor], used: int) -> Tensor | None:
        """(B, V, 3H) the vehicle and the AV from VectorNet, the image from VGG16."""
        if self.vectors is None and self.image is None:
            return None
        size, hidden = len(batch["vehicle"]), self.preset.hidden
        parts = [batch["vehicle"].new_zeros(size, used, hidden)] * 3
        if self.vectors is not None:
            elements, _ = self.vectors(batch)
            parts[0] = elements[:, 1 : used + 1]
            parts[1] = elements[:, :1].expand(-1, used, -1)
        if self.image is not None:
            image = self.image(self.image.shared(unpack(batch["raster"], self.preset)))
            parts[2] = image.unsqueeze(1).expand(-1, used, -1)
        return torch.cat(parts, -1)
