"""Command line and configuration -> trainings; flags take precedence over the file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch

from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.networks.config import preset_named
from deepmf_sumo.deepmf.networks.weights import BASELINES, NETWORKS, Network
from deepmf_sumo.errors import UsageError
from deepmf_sumo.training import config, initial_weights, members, run
from deepmf_sumo.training.config import Config
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples.dataset import Progress
from deepmf_sumo.training.samples.feature_cache import Data


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Options of the command line; None is the value in ``file``, else the default.

    Attributes:
        network: its name, or ``all`` for the three of the paper.
        file: the configuration. data: ``PATH`` or ``PATH=WEIGHT`` each.
        name: of the set of weights. out: its folder, instead of one in the weights home.
        optimisation: values of `config.Optimisation`, for all networks.
        threads: CPU threads; None is torch's default.
        command: for the card.
    """

    network: str
    file: Path | None = None
    data: Sequence[str] = ()
    name: str = "custom"
    out: Path | None = None
    preset: str | None = None
    begin_from: str | None = None
    seed: int | None = None
    licence: str | None = None
    members: int | None = None
    optimisation: Mapping[str, Any] = field(default_factory=dict)
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    threads: int | None = None
    cache: Path | None = None
    jobs: int = 1
    again: bool = False
    command: str = ""


def train_requested(request: Request, report: Progress) -> None:
    """Train the networks of a request.

    Raises UsageError without data, and WeightsError if the initial weights of a network do not fit,
    both before any network is trained.
    """
    settings = config.load(request.file) if request.file is not None else Config(version=1)
    data = _sources(request, settings)
    if request.members is not None and request.network not in {"marginal", "all"}:
        raise UsageError(
            f"--members applies to the marginal network; the {request.network} network has one."
        )
    networks = _networks(request.network)
    trainings = {network: _training(network, request, settings, data) for network in networks}
    for network, one in trainings.items():
        if one.begin_from is not None:
            initial_weights.check(network, one.preset, one.folder, one.begin_from, report)
    for network, one in trainings.items():
        train_each([network], one, request.threads, report)


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
    return [network for network in (*NETWORKS, *BASELINES) if network == name]


def _training(
    network: Network, request: Request, settings: Config, data: Sequence[Data]
) -> Training:
    """How to train one network; flags take precedence over the file, and it over defaults."""
    flags = config.Optimisation(**request.optimisation)
    return Training(
        data=data,
        folder=request.out or weights.place(request.name),
        cache=request.cache or weights.home() / ".features",
        preset=preset_named(request.preset or settings.preset or config.PRESETS[network]),
        optimisation={network: flags.over(settings.of(network))},
        begin_from=request.begin_from or settings.begin_from,
        seed=settings.seed or 0 if request.seed is None else request.seed,
        device=request.device,
        jobs=request.jobs,
        again=request.again,
        licence=settings.licence or "" if request.licence is None else request.licence,
        command=request.command,
        members=request.members or settings.members or config.MEMBERS,
    )


def _sources(request: Request, settings: Config) -> list[Data]:
    sources = [config.parsed(text) for text in request.data] or settings.sources()
    if not sources:
        raise UsageError("No data to train on; give --data, or a --config with 'data'.")
    config.check_weights(sources)
    return sources
