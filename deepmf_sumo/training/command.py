"""Command line and configuration -> what to train; flags stand above the file."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch

from deepmf_sumo.errors import UsageError
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.config import preset_named
from deepmf_sumo.predictors.weights import BASELINES, NETWORKS, Network
from deepmf_sumo.training import beginnings, config, ensembles, run
from deepmf_sumo.training.cache import Progress


def train_named(
    network: str,
    *,
    file: Path | None,
    data: Sequence[str],
    name: str,
    out: Path | None,
    preset: str | None,
    begin_from: str | None,
    seed: int | None,
    licence: str | None,
    members: int | None,
    optimisation: Mapping[str, Any],
    device: str,
    threads: int | None,
    cache: Path | None,
    jobs: int,
    again: bool,
    command: str,
    report: Progress,
) -> None:
    """Train the network of a name, or ``all`` three of the paper.

    Into the folder ``out``, or the set's place in the weights home. What is None is what
    ``file`` says, else the default. Raises UsageError without any data, and WeightsError where a
    network cannot begin from what it shall, before any is trained.
    """
    settings = config.load(file) if file is not None else config.Config(version=1)
    sources = [config.parsed(text) for text in data] or settings.sources()
    if not sources:
        raise UsageError("There is no data to train on; give --data, or a --config with 'data'.")
    config.check_weights(sources)
    if members is not None and network not in {"marginal", "all"}:
        raise UsageError(f"--members is of the marginal network; the {network} network has one.")
    flags = config.Optimisation(**optimisation)
    training = partial(
        run.Training,
        data=sources,
        folder=out or weights.place(name),
        cache=cache or weights.home() / ".features",
        optimisation={each: flags.over(settings.of(each)) for each in (*NETWORKS, *BASELINES)},
        begin_from=begin_from or settings.begin_from,
        seed=seed if seed is not None else settings.seed or 0,
        device="cuda" if device == "cuda" else "cpu",
        jobs=jobs,
        again=again,
        licence=licence if licence is not None else settings.licence or "",
        command=command,
        members=members or settings.members or config.MEMBERS,
    )
    chosen = [each for each in NETWORKS if network in {each, "all"}]
    chosen += [each for each in BASELINES if network == each]
    sizes = {e: preset_named(preset or settings.preset or config.PRESETS[e]) for e in chosen}
    trainings = {each: training(preset=sizes[each]) for each in chosen}
    for each, one in trainings.items():  # before the first of them has been trained
        if one.begin_from is not None:
            beginnings.check(each, one.preset, one.folder, one.begin_from, report)
    for each, one in trainings.items():
        train_each([each], one, threads, report)


def train_each(
    networks: Sequence[Network], training: run.Training, threads: int | None, report: Progress
) -> None:
    """Train networks one after the other, with so many CPU threads; None leaves it to torch."""
    if threads is not None:
        torch.set_num_threads(threads)
    for network in networks:
        if network == "marginal":
            ensembles.train(training, report)
        else:
            run.train(network, training, report)
