"""``deepmf-sumo train``: recordings -> features -> network -> weights with a card."""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch
from torch import nn

from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import OutputError, RunError, WeightsError
from deepmf_sumo.predictors import features, weights
from deepmf_sumo.predictors.config import Preset
from deepmf_sumo.predictors.densetnt import DenseTNT
from deepmf_sumo.predictors.opponent import OpponentNet
from deepmf_sumo.predictors.strive.motion_prior import MotionPrior
from deepmf_sumo.predictors.weights import Network
from deepmf_sumo.training import (
    beginnings,
    cards,
    clusters,
    eligible,
    loop,
    making,
    opponent,
    opponent_samples,
    samples,
    trajectory,
)
from deepmf_sumo.training.cache import Arrays, Cache, Progress, mix
from deepmf_sumo.training.checkpoints import Checkpoints
from deepmf_sumo.training.config import Optimisation
from deepmf_sumo.training.curves import Curves
from deepmf_sumo.training.making import Data
from deepmf_sumo.training.motion_prior import evaluation as motion_prior_evaluation
from deepmf_sumo.training.motion_prior import loss as motion_prior_loss
from deepmf_sumo.training.motion_prior import samples as graph_samples
from deepmf_sumo.training.schedule import Loss, Outcome, Schedule

_CPU_INFO: Final = Path("/proc/cpuinfo")
MODES: Final[dict[Network, int]] = {"marginal": 32, "conditional": 6}


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """What to train, on what, and where to.

    Attributes:
        folder: of the weights; checkpoints of a run that was cut off lie beside the tensors.
        cache: folder of computed features. jobs: processes that compute them.
        optimisation: of each network; one that is not named takes its defaults.
        begin_from: set of weights whose networks these begin from.
        again: train even what this very training has made before.
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
    device: Literal["cpu", "cuda"] = "cpu"
    jobs: int = 1
    again: bool = False
    licence: str = ""
    command: str = ""
    members: int = 1


def train(network: Network, training: Training, report: Progress, member: int = 1) -> None:
    """Train one network, or a member of it with a seed of its own, and write it.

    A run that was cut off goes on.

    Raises:
        WeightsError: no such device, or weights to begin from that do not fit.
        ReaderError: data without anything to learn from.
        RunError: no pairs for the conditional network, or a loss that is not finite.
        OutputError: the weights cannot be written; the last checkpoint stays.
    """
    if training.device == "cuda" and not torch.cuda.is_available():
        raise WeightsError("There is no CUDA device for --device cuda; use --device cpu.")
    training = replace(training, seed=training.seed + member - 1)
    stem = weights.member(network, member)
    begin = beginnings.file_of(
        network, training.preset, training.folder, training.begin_from, report, member
    )
    schedule = _schedule(network, training, began=begin is not None)
    digest = _digest(network, training, schedule, begin)
    if not training.again and _made(training.folder, stem, digest):
        report(f"{stem}: this training has been made; --again makes it again")
        return
    torch.manual_seed(training.seed)
    net = weights.build(network, training.preset)
    if begin is not None:
        beginnings.load(net, network, begin)
    cache = eligible.drivers_for(network, open_caches(network, training, report), report)
    if isinstance(net, DenseTNT):
        trajectory.start(net, cache, training.seed)
    if network == "conditional":
        cache = eligible.pairs(cache)
    checkpoints = Checkpoints(training.folder / f"{stem}-{digest[:12]}.checkpoint")
    file = training.folder / "curves" / f"{stem}.csv"
    curves = Curves(file, [source.name for source in cache.sources], report)
    outcome = loop.train(net, cache, _loss(net), schedule, checkpoints, curves, report)
    card = _card(network, net, training, cache, schedule, outcome)
    card["began_from"] = beginnings.name_of(begin, training.begin_from)
    card["training_digest"] = digest
    card |= _measured(network, net, cache)
    try:
        if stem == "marginal":  # a baseline that `evaluate` shows beside it
            clusters.write(_clusters(cache, training.seed), training.folder)
        cards.write(training.folder, stem, net, card)  # last: it says that all has been made
    except OSError as error:
        raise OutputError(
            f"The weights cannot be written to {training.folder} ({error.strerror}); the checkpoint"
            " stays there: make room, and give the same command again."
        ) from None
    checkpoints.clear()
    report(f"{stem}: best step {outcome.best_step}, written to {training.folder}")


def _clusters(cache: Cache, seed: int) -> clusters.Clusters:
    rows = cache.rows(held_out=False)
    future, valid, motion = (
        np.asarray(cache.arrays[name][rows]) for name in ("future", "future_valid", "motion")
    )
    return clusters.fit(future, valid > 0, motion, np.random.default_rng([seed, 2]))


def open_caches(network: Network, training: Training, report: Progress) -> Cache:
    """The samples of all sources; features are made where they are not there.

    Raises RunError where none is left to train on.
    """
    make = _samples(network, training.preset)
    kind, settings = _features(network, training.preset)
    cache = mix(
        [
            making.open_or_make(kind, data, settings, make, training.cache, report, training.jobs)
            for data in training.data
        ]
    )
    if not len(cache.rows(held_out=False)):
        raise RunError("All scenes that can be learnt from are held out; give more recordings.")
    return cache


def _samples(network: Network, preset: Preset) -> Callable[[Scene], Iterable[Arrays]]:
    """What one scene gives to a network."""
    if network == "strive":
        return graph_samples.graph_samples
    if network == "opponent":
        return partial(opponent_samples.opponent_samples, preset=preset)
    return partial(samples.trajectory_samples, preset=preset)


def _features(network: Network, preset: Preset) -> tuple[str, str]:
    """Kind of the features, and what they depend on: of the preset, the image alone."""
    if network == "strive":
        return "graph", graph_samples.settings()
    if network == "opponent":
        return "opponent", opponent_samples.settings(preset)
    image = {key: value for key, value in preset.record().items() if key.startswith("raster_")}
    counts = f"{samples.WINDOW_STEPS} {samples.SIMULATED_TARGETS} {features.MEANING}"
    return "trajectory", f"{json.dumps(image, sort_keys=True)} {counts}"


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
    """bf16 on processors that have it.

    Never found out by timing: the same command must give the same weights on one machine.
    """
    if device == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported() else "fp32"
    try:
        flags = set(_CPU_INFO.read_text(encoding="utf-8").split())
    except OSError:  # not Linux
        return "fp32"
    return "bf16" if flags & {"avx512_bf16", "amx_bf16"} else "fp32"


def _digest(network: Network, training: Training, schedule: Schedule, begin: Path | None) -> str:
    """Of all that the trained tensors depend on."""
    kind, settings = _features(network, training.preset)
    described = {
        "network": network,
        "preset": training.preset.record(),
        "schedule": asdict(schedule),
        "data": [(making.digest_of(kind, data, settings), data.weight) for data in training.data],
        "begin": beginnings.digest(begin),
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


def _made(folder: Path, stem: str, digest: str) -> bool:
    """Whether the folder holds the network that this training makes."""
    try:
        card = weights.read_card(folder, stem)
        weights.tensors(folder, stem)
    except WeightsError:
        return False
    return card.get("training_digest") == digest


def _loss(net: nn.Module) -> Loss:
    if isinstance(net, DenseTNT):
        return trajectory.loss_of(net)
    if isinstance(net, MotionPrior):
        return motion_prior_loss.loss_of(net)
    assert isinstance(net, OpponentNet)
    return opponent.loss_of(net)


def _card(
    network: Network,
    net: nn.Module,
    training: Training,
    cache: Cache,
    schedule: Schedule,
    outcome: Outcome,
) -> dict[str, Any]:
    return {
        "network": network,
        "preset": training.preset.name,
        "sizes": training.preset.record(),
        "weights": sum(value.numel() for value in net.parameters()),
        "data": _sources(cache, outcome),
        "scenes": cache.scenes,
        "refused": cache.refused,
        "samples": len(cache.rows(held_out=False)),
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
        "held_out_loss": None if outcome.held_out is None else round(outcome.held_out, 4),
        "hours": round(outcome.hours, 3),
    }


def _sources(cache: Cache, outcome: Outcome) -> list[dict[str, Any]]:
    found = []
    for number, source in enumerate(cache.sources):
        held_out = outcome.by_source[number]
        found.append(
            {
                "name": source.name,
                "weight": source.weight,
                "share": round(float(cache.shares[number]), 4),
                "scenes": len(source.scenes),
                "samples": len(cache.rows(held_out=False, source=number)),
                "refused": len(source.refused),
                "held_out_loss": None if held_out is None else round(held_out, 4),
            }
        )
    return found


def _measured(network: Network, net: nn.Module, cache: Cache) -> dict[str, Any]:
    net.cpu()
    if isinstance(net, MotionPrior):
        return {"held_out_errors_m": motion_prior_evaluation.of_held_out(net, cache)}
    if isinstance(net, DenseTNT):
        return {"temperature": trajectory.fit_temperature([net], cache, MODES[network])}
    assert isinstance(net, OpponentNet)
    return asdict(opponent.calibrate(net, cache))
