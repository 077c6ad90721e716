"""The loss on scenes that are kept from training, by source."""

import numpy as np
import torch
from torch import nn

from deepmf_sumo.errors import RunError
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.schedule import Loss, Schedule, tensors


@torch.inference_mode()
def evaluate(net: nn.Module, cache: Cache, loss: Loss, schedule: Schedule) -> list[float | None]:
    """Mean loss over held-out samples of each source, always the same ones; None where none are.

    Raises RunError where a loss is not finite.
    """
    net.eval()
    found: list[float | None] = []
    for number in range(len(cache.sources)):
        rows = cache.rows(held_out=True, source=number)
        most = schedule.held_out_samples // len(cache.sources)
        if len(rows) > most:
            rows = np.sort(np.random.default_rng(0).choice(rows, most, replace=False))
        total = 0.0
        for turn, start in enumerate(range(0, len(rows), schedule.batch)):
            part = rows[start : start + schedule.batch]
            batch = tensors(cache.batch(part), schedule.device)
            total += float(loss(batch, torch.Generator().manual_seed(turn))) * len(part)
        if not np.isfinite(total):
            raise RunError(
                f"The loss on the held-out scenes of {cache.sources[number].name} is {total}; the"
                " last checkpoint stays; try a lower --rate, or look at these scenes."
            )
        found.append(total / len(rows) if len(rows) else None)
    return found


def mean(by_source: list[float | None], cache: Cache) -> float | None:
    """Of the sources' losses, by their shares in training; None where nothing is held out."""
    known = [
        (value, share)
        for value, share in zip(by_source, cache.shares, strict=True)
        if value is not None and share > 0
    ]
    if not known:
        return None
    return float(sum(value * share for value, share in known) / sum(share for _, share in known))


def text(held_out: float | None, by_source: list[float | None], cache: Cache) -> str:
    """The losses in words."""
    if held_out is None:
        return "nothing"
    if len(by_source) == 1:
        return f"{held_out:.3f}"
    each = [
        f"{source.name} -" if value is None else f"{source.name} {value:.3f}"
        for source, value in zip(cache.sources, by_source, strict=True)
    ]
    return f"{held_out:.3f} ({', '.join(each)})"
