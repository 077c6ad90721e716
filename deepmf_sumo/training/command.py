"""Command line and configuration -> trainings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import preset_named
from deepmf_sumo.deepmf.networks.weights import BASELINES, NETWORKS, PEOPLE, Network
from deepmf_sumo.errors import UsageError
from deepmf_sumo.training import config, initial_weights, members, run
from deepmf_sumo.training.config import Config
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples.dataset import Progress
from deepmf_sumo.training.samples.feature_cache import Data


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingRequest:
    """What the command line asks for.

    Attributes:
        network: its name, or ``all`` for the three of the paper.
        file: the configuration. sets: ``key=value`` over it.
        data: ``PATH`` or ``PATH=WEIGHT`` each, instead of the configuration's.
        name: of the set of weights. out: its folder, instead of one in the weights home.
        command: for the card.
    """

    network: str
    file: Path | None = None
    sets: Sequence[str] = ()
    data: Sequence[str] = ()
    name: str = "custom"
    out: Path | None = None
    cache: Path | None = None
    jobs: int = 1
    again: bool = False
    command: str = ""


def train_requested(request: TrainingRequest, report: Progress) -> None:
    """Train the networks of a request.

    Raises UsageError without data, SpecError for a wrong configuration, and WeightsError if the
    initial weights of a network do not fit or the device is not there, all before any network is
    trained.
    """
    settings = config.load(request.file, request.sets)
    data = _sources(request, settings)
    named = {one.partition("=")[0].strip() for one in request.sets}
    if "members" in named and request.network not in {"marginal", "all"}:
        raise UsageError(
            f"members applies to the marginal network; the {request.network} network has one."
        )
    networks = _networks(request.network)
    trainings = {network: _training(network, request, settings, data) for network in networks}
    for network, one in trainings.items():
        if one.begin_from is not None:
            initial_weights.check(network, one.preset, one.folder, one.begin_from, report)
    for network, one in trainings.items():
        train_each([network], one, None, report)


def train_each(
    networks: Sequence[Network], training: Training, threads: int | None, report: Progress
) -> None:
    """Train networks one after the other with ``threads`` CPU threads (None: torch's default)."""
    if threads is not None:
        torch.set_num_threads(threads)
    for network in networks:
        if network == "marginal":
            members.train(training, report)
        else:
            run.train(network, training, report)


def _networks(name: str) -> list[Network]:
    if name == "all":
        return list(NETWORKS)
    return [network for network in (*NETWORKS, PEOPLE, *BASELINES) if network == name]


def _training(
    network: Network, request: TrainingRequest, settings: Config, data: Sequence[Data]
) -> Training:
    return Training(
        data=data,
        folder=request.out or weights.place(request.name),
        cache=request.cache or weights.home() / ".features",
        preset=preset_named(settings.preset or config.PRESETS[network]),
        optimisation={network: settings.of(network)},
        begin_from=settings.begin_from,
        seed=settings.seed or 0,
        device=torch_networks.device(),
        jobs=request.jobs,
        again=request.again,
        licence=settings.licence or "",
        command=request.command,
        members=settings.members or config.MEMBERS,
    )


def _sources(request: TrainingRequest, settings: Config) -> list[Data]:
    sources = [config.parsed(text) for text in request.data] or settings.sources()
    if not sources:
        raise UsageError("No data to train on; give --data, or a --config with 'data'.")
    config.check_weights(sources)
    return sources
