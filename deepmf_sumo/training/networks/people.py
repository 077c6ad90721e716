"""Training of the network of people."""

from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from deepmf_sumo.deepmf.networks import people_net
from deepmf_sumo.deepmf.networks.decode import KNOTS_S
from deepmf_sumo.deepmf.networks.people_net import LEAST_M, ODD, SECONDS, STRETCH_M, WIDEST
from deepmf_sumo.training.fit.loop import Loss

_KNOTS: Final = len(KNOTS_S)
_DROPOUT: Final = 0.2


class PeopleLayers(nn.Module):
    """The layers of `people_net.PeopleNet`; the last one is zero before training."""

    def __init__(self) -> None:
        super().__init__()
        shapes = people_net.shapes()
        for name in people_net.LAYERS:
            outputs, inputs = shapes[f"{name}.weight"]
            self.add_module(name, nn.Linear(inputs, outputs))
        for value in self.get_submodule("last").parameters():
            nn.init.zeros_(value)

    def forward(self, batch: dict[str, Tensor]) -> Tensor:
        """(B, N, `people_net.OUTPUTS`)."""
        drop = self._dropped
        around = self._layer("around", batch["around"]).relu()
        around = (around * batch["around"][..., :1]).amax(1)
        own = drop(self._layer("own", torch.cat([batch["own"], around], -1)).relu())
        motion = batch["motion"]
        both = [own[:, None].expand(-1, motion.shape[1], -1), motion]
        hidden = drop(self._layer("motion", torch.cat(both, -1)).relu())
        hidden = drop(self._layer("mix", hidden).relu())
        return self._layer("last", hidden)

    def _layer(self, name: str, values: Tensor) -> Tensor:
        found: Tensor = self.get_submodule(name)(values)
        return found

    def _dropped(self, values: Tensor) -> Tensor:
        return nn.functional.dropout(values, _DROPOUT, self.training)


def loss_of(net: PeopleLayers) -> Loss:
    """Negative log density of the future: of all knots together, and of each by itself.

    The density of all knots chooses a motion; that of each by itself is what calibrates it. In
    training half of the samples are mirrored.
    """

    def loss(batch: dict[str, Tensor], generator: torch.Generator) -> Tensor:
        if net.training:
            batch = mirrored(batch, torch.rand(len(batch["own"]), generator=generator) < 0.5)
        share, place, width = mixture(net(batch), batch)
        kernel = _kernel(place, width, batch)  # (B, N, 5)
        known = batch["future_valid"]
        joint = -torch.logsumexp(share + (kernel * known[:, None]).sum(-1), 1)
        each = -torch.logsumexp(share[..., None] + kernel, 1) * known
        per_knot = (joint + each.sum(-1)) / (2 * known.sum(-1))
        total: Tensor = per_knot.mean()
        return total

    return loss


def mixture(outputs: Tensor, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Log shares (B, N), places (B, N, 5, 2) and widths (B, N, 5, 2), as `PeopleNet` has them."""
    size = outputs.shape[:2]
    logits = batch["motion"][..., 0] + outputs[..., 0]
    share = logits.masked_fill(batch["there"] < 1, -1e4).log_softmax(1)
    seconds = torch.from_numpy(SECONDS)[:, None]
    off = STRETCH_M * seconds * outputs[..., 1 : 1 + 2 * _KNOTS].reshape(*size, _KNOTS, 2)
    wider = outputs[..., 1 + 2 * _KNOTS :].reshape(*size, _KNOTS, 2)
    width = batch["width"] * (WIDEST * torch.tanh(wider / WIDEST)).exp()
    return share, batch["place"] + off, width.clamp(min=LEAST_M)


def _kernel(place: Tensor, width: Tensor, batch: dict[str, Tensor]) -> Tensor:
    """(B, N, 5) log of each motion's kernel where the person was."""
    away = batch["future"][:, None] - place
    cos, sin = batch["along"].cos(), batch["along"].sin()
    ahead = (away[..., 0] * cos + away[..., 1] * sin).abs()
    left = (away[..., 1] * cos - away[..., 0] * sin).abs()
    return -ahead / width[..., 0] - left / width[..., 1] - (4 * width.prod(-1)).log()


def mirrored(batch: dict[str, Tensor], chosen: Tensor) -> dict[str, Tensor]:
    """The batch with the chosen (B) samples mirrored: left is right."""
    found: dict[str, Any] = dict(batch)
    factors = {name: torch.from_numpy(values) for name, values in ODD.items()}
    other = torch.tensor([1.0, -1.0])
    factors |= {"place": other, "future": other, "along": torch.tensor(-1.0)}
    for name, factor in factors.items():
        there = chosen.reshape(-1, *[1] * (batch[name].ndim - 1))
        found[name] = torch.where(there, batch[name] * factor, batch[name])
    return found


def tensors_of(net: PeopleLayers) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """For `people_net.PeopleNet`."""
    return {name: value.detach().float().numpy() for name, value in net.state_dict().items()}
