"""The networks of the baselines: building, and reading from a set of weights."""

from pathlib import Path

from torch import nn

from deepmf_sumo import files
from deepmf_sumo.baselines.priors.diffscene import DiffusionPrior
from deepmf_sumo.baselines.priors.strive import MotionPrior
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.weights import Network


def build(network: Network, preset: Preset) -> MotionPrior | DiffusionPrior:
    """An untrained network of `weights.BASELINES`."""
    return MotionPrior(preset) if network == "strive" else DiffusionPrior(preset)


def motion_prior(name: str | Path) -> MotionPrior:
    """STRIVE's motion prior of a name or folder, in evaluation mode; read again once it changed.

    Raises WeightsError where the set has none, with the command that trains it, or a damaged one.
    """
    net = _latest(weights.find(name), "strive")
    assert isinstance(net, MotionPrior)
    return net


def diffusion_prior(name: str | Path) -> DiffusionPrior:
    """DiffScene's network, as `motion_prior`."""
    net = _latest(weights.find(name), "diffscene")
    assert isinstance(net, DiffusionPrior)
    return net


def _latest(folder: Path, network: Network) -> nn.Module:
    return _kept(folder.resolve() / f"{network}.safetensors", network)


@files.while_unchanged(2)
def _kept(file: Path, network: Network) -> nn.Module:
    net, _ = torch_networks.read_network(file.parent, network, build=build)
    return net.requires_grad_(requires_grad=False)
