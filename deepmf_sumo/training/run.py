"""``deepmf-sumo train``: recordings -> features -> network -> weights with a card."""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch
from torch import nn

from deepmf_sumo.baselines.priors.diffscene import DiffusionPrior
from deepmf_sumo.baselines.priors.strive import MotionPrior
from deepmf_sumo.deepmf.networks import people_net, torch_networks, weights
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT
from deepmf_sumo.deepmf.networks.opponent_net import OpponentNet
from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.errors import OutputError, RunError, WeightsError
from deepmf_sumo.training import cards, initial_weights
from deepmf_sumo.training.config import Optimisation
from deepmf_sumo.training.fit import loop
from deepmf_sumo.training.fit.checkpoints import Checkpoints, LearningCurves
from deepmf_sumo.training.fit.loop import Loss, Schedule, TrainingOutcome
from deepmf_sumo.training.networks import clusters, diffscene, opponent, people, strive, trajectory
from deepmf_sumo.training.networks.people import PeopleLayers
from deepmf_sumo.training.samples import feature_cache, graph
from deepmf_sumo.training.samples import opponent as opponent_samples
from deepmf_sumo.training.samples import people as people_samples
from deepmf_sumo.training.samples import trajectory as trajectory_samples
from deepmf_sumo.training.samples.dataset import (
    Dataset,
    Progress,
    filter_drivers,
    filter_pairs,
    mix,
)
from deepmf_sumo.training.samples.feature_cache import Data, Features

_CPU_INFO: Final = Path("/proc/cpuinfo")
MODES: Final[dict[Network, int]] = {"marginal": 32, "conditional": 6}


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """What to train, on which data, and the folder of the weights.

    Attributes:
        folder: of the weights; checkpoints of an interrupted training are beside the tensors.
        cache: folder of computed features. jobs: processes that compute them.
        optimisation: by network; the others have their defaults.
        begin_from: set of weights that are the initial weights.
        again: repeat a training that is complete.
        licence: a note on the data for the card.
        command: for the card.
        members: of the marginal network, trained one after the other.
    """

    data: Sequence[Data]
    folder: Path
    cache: Path
    preset: Preset
    optimisation: Mapping[Network, Optimisation] = field(default_factory=dict)
    begin_from: str | None = None
    seed: int = 0
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    jobs: int = 1
    again: bool = False
    licence: str = ""
    command: str = ""
    members: int = 1


def train(network: Network, training: Training, report: Progress, member: int = 1) -> None:
    """Train one network, or one member with its own seed, and write it.

    An interrupted training resumes from its last checkpoint.

    Raises:
        WeightsError: no such device, or initial weights that do not fit.
        ReaderError: the data gives no samples.
        RunError: no pairs for the conditional network, or a loss that is not finite.
        OutputError: the weights cannot be written; the last checkpoint stays.
    """
    device = torch_networks.device(training.device)
    training = replace(training, seed=training.seed + member - 1, device=device)
    stem = weights.member(network, member)
    initial = initial_weights.file_of(
        network, training.preset, training.folder, training.begin_from, report, member
    )
    schedule = _schedule(network, training, began=initial is not None)
    digest = _digest(network, training, schedule, initial)
    if not training.again and _complete(training.folder, stem, digest):
        report(f"{stem}: this training is complete; --again repeats it")
        return
    net, dataset = _prepared(network, training, initial, report)
    checkpoints = Checkpoints(training.folder / f"{stem}-{digest[:12]}.checkpoint")
    file = training.folder / "curves" / f"{stem}.csv"
    curves = LearningCurves(file, [source.name for source in dataset.sources], report)
    outcome = loop.train(net, dataset, _loss(net), schedule, checkpoints, curves, report)
    card = {
        **_card(network, net, training, dataset, schedule, outcome),
        "began_from": initial_weights.name_of(initial, training.begin_from),
        "training_digest": digest,
        **_fitted(network, net, dataset, training.device),
    }
    net.cpu()
    _write(training, stem, net, dataset, card)
    checkpoints.clear()
    report(f"{stem}: best step {outcome.best_step}, written to {training.folder}")


def open_dataset(network: Network, training: Training, report: Progress) -> Dataset:
    """The samples of all sources; missing features are computed.

    Raises RunError if none is left to train on.
    """
    features = _features(network, training.preset)
    dataset = mix(
        [
            feature_cache.open_or_build(features, data, training.cache, report, training.jobs)
            for data in training.data
        ]
    )
    if not dataset.is_apart:
        report("all scenes are of one place: the held-out ones have the same roads as the others")
    if not len(dataset.rows(held_out=False)):
        raise RunError("All scenes with samples are held out; give more recordings.")
    return dataset


def _features(network: Network, preset: Preset) -> Features:
    if network in weights.BASELINES:
        return graph.features()
    if network == weights.PEOPLE:
        return people_samples.features_for()
    if network == "opponent":
        return opponent_samples.features_for(preset)
    return trajectory_samples.features_for(preset)


def _prepared(
    network: Network, training: Training, initial: Path | None, report: Progress
) -> tuple[nn.Module, Dataset]:
    """The network before its first step, and the samples to train it on."""
    torch.manual_seed(training.seed)
    net = initial_weights.untrained(network, training.preset)
    if initial is not None:
        initial_weights.load(net, network, initial)
    dataset = filter_drivers(network, open_dataset(network, training, report), report)
    if isinstance(net, DenseTNT):
        trajectory.fit_profiles(net, dataset, training.seed)
    if isinstance(net, DiffusionPrior) and initial is None:  # else layers know those of the set
        diffscene.fit_components(net, dataset, training.seed)
    return net, filter_pairs(dataset) if network == "conditional" else dataset


def _write(
    training: Training, stem: str, net: nn.Module, dataset: Dataset, card: dict[str, Any]
) -> None:
    try:
        if stem == "marginal":  # a baseline that `evaluate` shows beside it
            clusters.write(_clusters(dataset, training.seed), training.folder)
        cards.write(training.folder, stem, net, card)  # last, since it marks the set as complete
    except OSError as error:
        raise OutputError(
            f"The weights cannot be written to {training.folder} ({error.strerror}); the checkpoint"
            " stays there: free some space and repeat the command."
        ) from None


def _clusters(dataset: Dataset, seed: int) -> clusters.Clusters:
    rows = dataset.rows(held_out=False)
    future, valid, motion = (
        np.asarray(dataset.arrays[name][rows]) for name in ("future", "future_valid", "motion")
    )
    return clusters.fit(future, valid > 0, motion, np.random.default_rng([seed, 2]))


def _schedule(network: Network, training: Training, *, began: bool) -> Schedule:
    given = training.optimisation.get(network, Optimisation())
    fresh = began and network == "conditional" and training.begin_from is None
    values = given.with_defaults(network, began=began and not fresh)
    precision = values.pop("precision")
    return Schedule(
        **{"average" if name == "ema" else name: value for name, value in values.items()},
        precision=_precision(training.device) if precision == "auto" else precision,
        fresh=trajectory.CONDITION_LAYERS if fresh else (),
        seed=training.seed,
        device=training.device,
    )


def _precision(device: str) -> Literal["fp32", "bf16"]:
    """bf16 on processors with such instructions.

    It does not depend on timings: one machine gives the same weights for the same command.
    """
    if device == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported() else "fp32"
    try:
        flags = set(_CPU_INFO.read_text(encoding="utf-8").split())
    except OSError:  # not Linux
        return "fp32"
    return "bf16" if flags & {"avx512_bf16", "amx_bf16"} else "fp32"


def _digest(network: Network, training: Training, schedule: Schedule, initial: Path | None) -> str:
    """Digest of everything that the trained tensors depend on."""
    features = _features(network, training.preset)
    described = {
        "network": network,
        "preset": training.preset.record(),
        "schedule": asdict(schedule),
        "data": [
            (feature_cache.digest_of(features.kind, features.settings, data.path), data.weight)
            for data in training.data
        ],
        "begin": initial_weights.digest(initial),
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


def _complete(folder: Path, stem: str, digest: str) -> bool:
    """Whether the folder contains the result of this training."""
    try:
        card = weights.read_card(folder, stem)
        torch_networks.tensors(folder, stem)
    except WeightsError:
        return False
    return card.get("training_digest") == digest


def _loss(net: nn.Module) -> Loss:
    if isinstance(net, DenseTNT):
        return trajectory.loss_of(net)
    if isinstance(net, MotionPrior):
        return strive.loss_of(net)
    if isinstance(net, DiffusionPrior):
        return diffscene.loss_of(net)
    if isinstance(net, PeopleLayers):
        return people.loss_of(net)
    assert isinstance(net, OpponentNet)
    return opponent.loss_of(net)


def _card(
    network: Network,
    net: nn.Module,
    training: Training,
    dataset: Dataset,
    schedule: Schedule,
    outcome: TrainingOutcome,
) -> dict[str, Any]:
    return {
        "network": network,
        "preset": training.preset.name,
        "sizes": training.preset.record(),
        "weights": sum(value.numel() for value in net.parameters()),
        "data": _sources(dataset, outcome),
        "scenes": dataset.scenes,
        "refused": dataset.refused,
        "samples": len(dataset.rows(held_out=False)),
        "licence": training.licence,
        "limits": cards.LIMITS[network],
        "command": training.command,
        "seed": training.seed,
        "steps": schedule.steps,
        "schedule": asdict(schedule),
        "torch": torch.__version__,
        "threads": torch.get_num_threads(),
        "trained": time.strftime("%Y-%m-%d", time.gmtime()),
        "steps_made": outcome.steps,
        "best_step": outcome.best_step,
        "held_out_loss": _rounded(outcome.held_out),
        "hours": round(outcome.hours, 3),
    }


def _sources(dataset: Dataset, outcome: TrainingOutcome) -> list[dict[str, Any]]:
    return [
        {
            "name": source.name,
            "weight": source.weight,
            "share": round(float(dataset.shares[number]), 4),
            "scenes": len(source.scenes),
            "samples": len(dataset.rows(held_out=False, source=number)),
            "refused": len(source.refused),
            "held_out_loss": _rounded(outcome.by_source[number]),
        }
        for number, source in enumerate(dataset.sources)
    ]


def _rounded(loss: float | None) -> float | None:
    return None if loss is None else round(loss, 4)


def _fitted(network: Network, net: nn.Module, dataset: Dataset, device: str) -> dict[str, Any]:
    if isinstance(net, DenseTNT):
        modes = MODES[network]
        return {"temperature": trajectory.fit_temperature([net], dataset, modes, device)}
    net.cpu()
    if isinstance(net, MotionPrior):
        return {"held_out_errors_m": strive.held_out_errors(net, dataset)}
    if isinstance(net, DiffusionPrior):
        return {"held_out_errors_m": diffscene.held_out_errors(net, dataset)}
    if isinstance(net, PeopleLayers):
        return {"inputs": people_net.INPUTS_VERSION}
    assert isinstance(net, OpponentNet)
    return asdict(opponent.calibrate(net, dataset))
