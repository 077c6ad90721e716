"""phi(X): which vehicle suits as the opponent (paper, section IV-B)."""

import torch
from torch import Tensor, nn

from deepmf_sumo.datatypes import OpponentScores, View
from deepmf_sumo.predictors.completion import as_batch
from deepmf_sumo.predictors.opponent_features import PAIR, opponent_features
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.predictors.raster import unpack
from deepmf_sumo.predictors.vectornet import VectorNet
from deepmf_sumo.predictors.vgg import VGG16

_RARE = -2.3
"""log(.09 / .91): the share of positive candidates, where training starts."""
_DROPOUT = 0.3
"""More than elsewhere: there are few scenes, and one sample a scene and window."""


class OpponentNet(nn.Module):
    """VectorNet and VGG16 around the AV, then MLP and FC for each candidate; two heads.

    The first head learns the paper's pseudo-labels, the second which vehicle is the labelled
    interacting partner.
    """

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        hidden = preset.hidden
        self.preset = preset
        self.vectors = VectorNet(preset)
        self.image = VGG16(preset)
        self.pair = nn.Sequential(nn.Linear(PAIR, hidden), nn.ReLU(), nn.Linear(hidden, hidden))
        self.mlp = nn.Sequential(
            nn.ReLU(),
            nn.Dropout(_DROPOUT),
            nn.Linear(4 * hidden, hidden),
            nn.ReLU(),
            nn.Dropout(_DROPOUT),
        )
        self.heads = nn.Linear(hidden, 2)
        nn.init.constant_(self.heads.bias, _RARE)

    def forward(self, batch: dict[str, Tensor]) -> Tensor:
        """Arrays of `opponent_features` -> logits (B, 64, 2) of every agent slot."""
        elements, _ = self.vectors(batch)
        agents = elements[:, : batch["agents"].shape[1]]  # (B, 64, H); the AV is the first
        image = self.image(unpack(batch["raster"], self.preset)).unsqueeze(1)
        joined = torch.cat(
            [
                agents,
                agents[:, :1].expand_as(agents),
                image.expand_as(agents),
                self.pair(batch["pair"]),
            ],
            -1,
        )
        logits: Tensor = self.heads(self.mlp(joined))
        return logits


class Opponent:
    """Scores of all candidates in a view.

    Args:
        net: in evaluation mode.
        temperature, partner_temperature: divide the logits, so that their sigmoid is calibrated.
    """

    def __init__(self, net: OpponentNet, temperature: float, partner_temperature: float) -> None:
        self.net = net.eval()
        self.temperature = temperature
        self.partner_temperature = partner_temperature

    @torch.inference_mode()
    def score(self, view: View) -> OpponentScores:
        """Logits of both heads for vehicles within 80 m that are not parked, nearest first."""
        arrays, ids = opponent_features(view, self.net.preset)
        logits = self.net(as_batch(arrays))[0].double().numpy()[arrays["candidate"] > 0]
        return OpponentScores(
            ids=ids,
            logits=logits[:, 0] / self.temperature,
            partner_logits=logits[:, 1] / self.partner_temperature,
        )
