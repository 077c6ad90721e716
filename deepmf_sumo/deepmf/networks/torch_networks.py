"""The networks in torch: reading, building, and the runtime that computes with them."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import torch
from safetensors import SafetensorError
from safetensors.torch import load as tensors_of
from torch import Tensor, nn

from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT
from deepmf_sumo.deepmf.networks.opponent import Opponent, OpponentNetwork
from deepmf_sumo.deepmf.networks.opponent_net import OpponentNet
from deepmf_sumo.deepmf.networks.predict import Conditional, Marginal, TrajectoryNetwork
from deepmf_sumo.deepmf.networks.weights import Network, Predictors, broken
from deepmf_sumo.errors import WeightsError


def device(name: str | None = None) -> Literal["cpu", "cuda"]:
    """``cpu`` or ``cuda`` for a name of `weights.DEVICES`; None: ``$DEEPMF_SUMO_DEVICE``, else cpu.

    Raises WeightsError for other names, and for cuda where there is no such device.
    """
    named = name or os.environ.get(weights.DEVICE) or "cpu"
    place = weights.DEVICE
    if named not in weights.DEVICES:
        raise WeightsError(f"{place} is {named!r:.80}; set it to {', '.join(weights.DEVICES)}.")
    there = named != "cpu" and torch.cuda.is_available()
    if named == "cuda" and not there:
        raise WeightsError(f"There is no CUDA device for {place}={named}; use cpu or auto.")
    return "cuda" if there else "cpu"


class TorchRuntime:
    """See `weights.Runtime`."""

    def opponent(self, folder: Path) -> tuple[OpponentNetwork, dict[str, Any]]:
        """The opponent network."""
        net, card = read_network(folder, "opponent")
        assert isinstance(net, OpponentNet)
        return net.to(device()), card

    def trajectory(
        self, folder: Path, network: Network, number: int = 1
    ) -> tuple[TrajectoryNetwork, dict[str, Any]]:
        """The marginal or conditional network, or one member of it."""
        net, card = read_network(folder, network, number)
        assert isinstance(net, DenseTNT)
        return net.to(device()), card


def build(network: Network, preset: Preset) -> nn.Module:
    """An untrained network of the method."""
    if network == "opponent":
        return OpponentNet(preset)
    return DenseTNT(preset, conditional=network == "conditional")


def random(preset: Preset, seed: int) -> Predictors:
    """Untrained predictors, for tests."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        nets = {network: build(network, preset).eval() for network in weights.NETWORKS}
    for net in (nets["marginal"], nets["conditional"]):
        assert isinstance(net, DenseTNT)
        if net.dense:
            continue
        share = torch.linspace(-1.0, 1.0, net.profiles.shape[1])[:, None]
        share = share * torch.linspace(0.1, 8.0, 80)
        net.profiles.copy_(4.0 * share.expand_as(net.profiles))
    opponent, marginal, conditional = nets.values()
    assert isinstance(opponent, OpponentNet)
    assert isinstance(marginal, DenseTNT)
    assert isinstance(conditional, DenseTNT)
    return Predictors(
        name="random",
        folder=None,
        opponent=Opponent(opponent, 1.0, 1.0),
        marginal=Marginal([marginal], 1.0),
        conditional=Conditional(conditional, 1.0),
    )


def tensors(folder: Path, network: str, digest: object = None) -> dict[str, Tensor]:
    """The tensors of one network or `member`.

    Raises WeightsError where they cannot be read, or have another digest than the one given.
    """
    try:
        return tensors_of(weights.content(folder, network, digest))
    except (SafetensorError, ValueError, KeyError) as error:
        raise broken(folder, network, f"{network}.safetensors is damaged ({error})") from None


def read_network(
    folder: Path,
    network: Network,
    number: int = 1,
    *,
    build: Callable[[Network, Preset], nn.Module] = build,
) -> tuple[nn.Module, dict[str, Any]]:
    """One network, or one member of it, and its card. Raises WeightsError where it is not whole.

    ``build`` makes the network that the tensors are loaded into.
    """
    stem = weights.member(network, number)
    card, preset = weights.network_card(folder, network, stem)
    net = build(network, preset)
    try:
        net.load_state_dict(tensors(folder, stem, card.get(weights.DIGEST)))
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:200]
        what = f"{stem}.safetensors does not fit the {network} network of preset '{preset.name}'"
        raise broken(folder, stem, f"{what} ({reason})") from None
    for key, value in net.state_dict().items():
        if not torch.isfinite(value).all():
            what = f"{stem}.safetensors has numbers in '{key}' that are not finite"
            raise broken(folder, stem, what)
    return net.eval(), card
