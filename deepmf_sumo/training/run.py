"""``deepmf-sumo train``: recordings -> features -> network -> weights with a card."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import torch
from torch import nn

from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import RunError, WeightsError
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.densetnt import DenseTNT
from deepmf_sumo.predictors.opponent import OpponentNet
from deepmf_sumo.predictors.presets import Preset, preset_named
from deepmf_sumo.predictors.weights import NETWORKS, Network
from deepmf_sumo.training import cards, loop, opponent, samples, trajectory
from deepmf_sumo.training.cache import Arrays, Cache, Progress, open_or_make

STEPS: Final[dict[Network, int]] = {"opponent": 1500, "marginal": 3000, "conditional": 1500}
_MODES: Final[dict[Network, int]] = {"marginal": 32, "conditional": 6}


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """What to train, on what, and where to.

    Attributes:
        folder: of the weights; checkpoints of a run that was cut off lie beside the tensors.
        cache: folder of computed features.
        steps: None takes the default of each network.
        licence: a note on the data for the card.
        command: for the card.
    """

    data: Sequence[Path]
    folder: Path
    cache: Path
    preset: Preset
    steps: int | None = None
    seed: int = 0
    device: Literal["cpu", "cuda"] = "cpu"
    licence: str = ""
    command: str = ""


def train(network: Network, training: Training, report: Progress) -> None:
    """Train one network and write it; a run that was cut off goes on."""
    if training.device == "cuda" and not torch.cuda.is_available():
        raise WeightsError("There is no CUDA device for --device cuda; use --device cpu.")
    cache = _cache(network, training, report)
    torch.manual_seed(training.seed)
    net = weights.build(network, training.preset)
    began = _begin(network, net, training, cache)
    if network == "conditional":
        cache = replace(cache, chosen=trajectory.interacting(cache))
        if not len(cache.rows(held_out=False)):
            raise RunError("No two vehicles come near each other in these recordings; give more.")
    steps = training.steps or STEPS[network]
    schedule = loop.Schedule(
        steps=steps,
        batch=16 if network == "opponent" else 64,
        rate=5e-4 if began else 1e-3 if network == "opponent" else 2e-3,
        fresh=trajectory.CONDITION_LAYERS if began else (),
        weight_decay=0.1 if network == "opponent" else 0.02,
        seed=training.seed,
        device=training.device,
        evaluate_every=min(250, max(steps // 4, 1)),
    )
    loss = _loss(net)
    name = f"{network}-{training.preset.name}-{steps}-{training.seed}.checkpoint"
    outcome = loop.train(net, cache, loss, schedule, training.folder / name, report)
    card = {
        "network": network,
        "preset": training.preset.name,
        "sizes": training.preset.record(),
        "weights": sum(value.numel() for value in net.parameters()),
        "data": [path.name for path in training.data],
        "scenes": cache.scenes,
        "refused": cache.refused,
        "samples": len(cache.rows(held_out=False)),
        "licence": training.licence,
        "command": training.command,
        "began_from": began,
        "seed": training.seed,
        "steps": steps,
        "batch": schedule.batch,
        "best_step": outcome.best_step,
        "held_out_loss": round(outcome.held_out, 4),
        "hours": round(outcome.hours, 3),
        **_temperatures(network, net, cache),
    }
    cards.write(training.folder, network, net, card)
    report(f"{network}: held-out loss {outcome.held_out:.3f}, written to {training.folder}")


def _cache(network: Network, training: Training, report: Progress) -> Cache:
    make: Callable[[Scene], Iterable[Arrays]]
    if network == "opponent":
        kind, make = "opponent", partial(samples.opponent_samples, preset=training.preset)
    else:
        kind, make = "trajectory", partial(samples.trajectory_samples, preset=training.preset)
    steps = samples.OPPONENT_STEPS if network == "opponent" else samples.WINDOW_STEPS
    settings = f"{training.preset.record()} {steps}"
    return open_or_make(kind, training.data, settings, make, training.cache, report)


def _begin(network: Network, net: nn.Module, training: Training, cache: Cache) -> str:
    """Fit profiles; the conditional network begins from the marginal one of the same folder.

    They share all layers but those that read the condition. Where the condition enters the image,
    its channels come after the shared ones.
    """
    if not isinstance(net, DenseTNT):
        return ""
    trajectory.start(net, cache, training.seed)
    file = training.folder / "marginal.safetensors"
    if network != "conditional" or not file.is_file():
        return ""
    card = weights.read_card(training.folder, "marginal")
    if card.get("preset") != training.preset.name:
        return ""
    marginal = weights.tensors(training.folder, "marginal")
    own = net.state_dict()
    for name, value in marginal.items():
        shared = own[name] if own[name].shape == value.shape else own[name][:, : value.shape[1]]
        shared.copy_(value)
    return "marginal"


def _loss(net: nn.Module) -> loop.Loss:
    if isinstance(net, DenseTNT):
        return trajectory.loss_of(net)
    assert isinstance(net, OpponentNet)
    return opponent.loss_of(net)


def _temperatures(network: Network, net: nn.Module, cache: Cache) -> dict[str, Any]:
    net.cpu()
    if isinstance(net, DenseTNT):
        return {"temperature": trajectory.fit_temperature(net, cache, _MODES[network])}
    assert isinstance(net, OpponentNet)
    first, second = opponent.fit_temperatures(net, cache)
    return {"temperature": first, "partner_temperature": second}


def train_named(
    network: str,
    *,
    data: Sequence[Path],
    name: str,
    out: Path | None,
    preset: str,
    steps: int | None,
    seed: int,
    device: str,
    threads: int | None,
    cache: Path | None,
    licence: str,
    command: str,
    report: Progress,
) -> None:
    """Train the network of a name, or ``all``, into the weights home or the folder ``out``."""
    if threads is not None:
        torch.set_num_threads(threads)
    training = Training(
        data=data,
        folder=out or weights.place(name),
        cache=cache or weights.home() / ".features",
        preset=preset_named(preset),
        steps=steps,
        seed=seed,
        device="cuda" if device == "cuda" else "cpu",
        licence=licence,
        command=command,
    )
    for each in NETWORKS:
        if network in {each, "all"}:
            train(each, training, report)
