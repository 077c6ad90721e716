"""Initial weights: random, from another set, or from the marginal network of the same set."""

from pathlib import Path
from typing import Final

from torch import Tensor, nn

from deepmf_sumo import files
from deepmf_sumo.baselines.priors import reading
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training.networks.people import PeopleLayers
from deepmf_sumo.training.samples.dataset import Progress

MARGINAL: Final = "marginal"
"""On the card of a conditional network that started from the marginal one of its own set."""
_ADDED: Final = frozenset({"goal_follow.weight"})
"""Tensors that networks without the follower as an input lack; they start as zeros."""
_NO_SIZES: Final = ("name", "dropout", "reactive")
"""Fields of a preset on which no tensors except `_ADDED` depend."""


def file_of(
    network: Network,
    preset: Preset,
    folder: Path,
    begin_from: str | None,
    report: Progress,
    member: int = 1,
) -> Path | None:
    """The file with the initial tensors; None for random ones.

    A member starts from the same member of another set, or from the first if that has fewer. If no
    other set is named, the conditional network starts from the marginal one of the same folder.
    Raises WeightsError if the set is missing, or has another version or other sizes.
    """
    if begin_from is not None:
        source = weights.find(begin_from)
        if source.resolve() == folder.resolve():
            raise WeightsError(
                f"begin_from {begin_from} is the set to be trained; give this one another --name."
            )
        stem = weights.member(network, member)
        if member > 1 and stem not in weights.listed(source):
            stem = network
        _check_sizes(source, stem, preset)
        torch_networks.tensors(source, stem)
        return source / f"{stem}.safetensors"
    if network != "conditional" or not (folder / "marginal.safetensors").is_file():
        return None
    try:
        _check_sizes(folder, MARGINAL, preset)
    except WeightsError as error:
        report(f"conditional: random initial weights, not those of the marginal network: {error}")
        return None
    return folder / "marginal.safetensors"


def check(
    network: Network, preset: Preset, folder: Path, begin_from: str | None, report: Progress
) -> None:
    """Raise the errors of `file_of` and `load`."""
    file = file_of(network, preset, folder, begin_from, report)
    if file is not None:
        load(untrained(network, preset), network, file)


def untrained(network: Network, preset: Preset) -> nn.Module:
    """A network of the method or of a baseline, with random weights."""
    if network == weights.PEOPLE:
        return PeopleLayers()
    build = reading.build if network in weights.BASELINES else torch_networks.build
    return build(network, preset)


def digest(file: Path | None) -> str:
    """Digest of the tensors in a file; empty without one."""
    return files.sha256(file) if file is not None else ""


def load(net: nn.Module, network: Network, file: Path) -> None:
    """Load the tensors of a file into the network.

    The conditional network shares all layers with the marginal one except those that read the
    condition. If the condition enters the image, its channels come after the shared ones. Tensors
    that an older set lacks start as zeros. Raises WeightsError if the tensors do not fit.
    """
    found = torch_networks.tensors(file.parent, file.stem)
    own = net.state_dict()
    widens = network == "conditional" and file.stem == MARGINAL
    lacking = set() if widens else own.keys() - found.keys()
    unlike = sorted((found.keys() - own.keys()) | (lacking - _ADDED))
    unlike += sorted(
        name
        for name in found.keys() & own.keys()
        if own[name].shape != found[name].shape
        and not (widens and _wider(name, own[name], found[name]))
    )
    if unlike:
        raise WeightsError(
            f"{file} does not fit the {network} network: it differs in {', '.join(unlike[:3])}"
            f"{' and others' if len(unlike) > 3 else ''}; choose another begin_from."
        )
    for name in lacking:
        own[name].zero_()
    for name, value in found.items():
        own[name][tuple(slice(size) for size in value.shape)].copy_(value)


def name_of(file: Path | None, begin_from: str | None) -> str:
    """For the card."""
    return "" if file is None else begin_from or MARGINAL


def _wider(name: str, own: Tensor, shared: Tensor) -> bool:
    """Whether a layer has the channels of another one and more, or more profiles."""
    grows = 0 if name == "profile" else 1
    rest = [size for axis, size in enumerate(own.shape) if axis != grows]
    same = rest == [size for axis, size in enumerate(shared.shape) if axis != grows]
    able = own.ndim == 4 or name in {"profile", "profiles", "prior"}
    return able and own.ndim == shared.ndim and same and own.shape[grows] > shared.shape[grows]


def _check_sizes(folder: Path, network: str, preset: Preset) -> None:
    """Raises WeightsError for another version, or other sizes than the preset's."""
    card = weights.read_card(folder, network)
    sizes, wanted = Preset.from_record(card.get("sizes")).record(), preset.record()
    for key, value in wanted.items():
        if key not in _NO_SIZES and sizes[key] != value:
            raise WeightsError(
                f"The {network} network of {folder} has {key} {sizes[key]}, but preset"
                f" '{preset.name}' has {value}; choose weights of the same preset."
            )
