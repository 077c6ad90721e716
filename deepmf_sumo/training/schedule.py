"""How a network is trained, and what comes of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from deepmf_sumo.training.cache import Arrays

Loss = Callable[[dict[str, Tensor], torch.Generator], Tensor]
"""Batch -> mean loss; the generator is for what is drawn at random in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """How to train.

    Attributes:
        rate: highest learning rate of the cycle.
        fresh: beginnings of the names of layers that begin anew in a network that does not.
        fresh_rate: their highest learning rate.
        clip: largest norm of the gradient.
        average: decay of the exponential average of the weights, which is what is evaluated and
            kept; 0 keeps the weights themselves.
        precision: of the layers; ``bf16`` is mixed.
        evaluate_every: steps between looks at the held-out samples.
        patience: looks without a better held-out loss after which training stops; 0 never stops.
        checkpoint_s: longest time between checkpoints, which also follow each look.
    """

    steps: int
    batch: int = 64
    rate: float = 2e-3
    fresh: tuple[str, ...] = ()
    fresh_rate: float = 4e-3
    weight_decay: float = 0.02
    clip: float = 5.0
    average: float = 0.0
    precision: Literal["fp32", "bf16"] = "fp32"
    evaluate_every: int = 250
    patience: int = 0
    checkpoint_s: float = 180.0
    held_out_samples: int = 1024
    seed: int = 0
    device: str = "cpu"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of it.

    Attributes:
        held_out: least held-out loss, a mean over sources by their shares, at ``best_step``; the
            network holds that step's weights. None where nothing is held out.
        by_source: the same of each source, in their order.
        steps: that were made. hours: wall time, resumed parts included.
    """

    held_out: float | None
    by_source: list[float | None]
    best_step: int
    steps: int
    hours: float


def tensors(arrays: Arrays, device: str = "cpu") -> dict[str, Tensor]:
    """The arrays as tensors on a device."""
    return {name: torch.from_numpy(values).to(device) for name, values in arrays.items()}
