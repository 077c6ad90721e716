"""How far a mixture of marginal networks is ahead of one of them, on held-out scenes."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.predictors import decoding, marginal
from deepmf_sumo.predictors.anchors import KNOT_STEPS
from deepmf_sumo.predictors.densetnt import DenseTNT, Goals
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.schedule import tensors

_MODES: Final = (6, 16, 32)
_SAMPLES: Final = 600
_BATCH: Final = 32


@torch.inference_mode()
def of_held_out(nets: Sequence[DenseTNT], cache: Cache) -> dict[str, Any]:
    """Samples, loss (negative log density, nats) and min FDE at 8 s (m) by number of modes.

    Of the mixture, and of the first network alone on the same samples: up to 600 held-out ones that
    are known for 8 s. Empty where there are none.
    """
    rows = cache.rows(held_out=True)
    rows = rows[np.asarray(cache.arrays["future_valid"][rows, -1]) > 0]
    rows = np.sort(np.random.default_rng(0).permutation(rows)[:_SAMPLES])
    if len(rows) == 0:
        return {}
    sums: dict[str, float] = {}
    for begin in range(0, len(rows), _BATCH):
        batch = tensors(cache.batch(rows[begin : begin + _BATCH]))
        members = [net(batch) for net in nets]
        for name, chosen in (("", len(nets)), ("first_", 1)):
            for key, value in _figures(nets[:chosen], members[:chosen], batch).items():
                sums[name + key] = sums.get(name + key, 0.0) + float(value.sum())
    return {"samples": len(rows)} | {
        key: round(value / len(rows), 4) for key, value in sums.items()
    }


def _figures(
    nets: Sequence[DenseTNT], members: Sequence[Goals], batch: dict[str, Tensor]
) -> dict[str, Tensor]:
    """(B) each."""
    knots = list(KNOT_STEPS)
    valid = batch["future_valid"][:, None, knots]
    density = marginal.log_density(nets, members, 1.0, batch["future"][:, None, knots], valid)
    found = {"loss": -density[:, 0]}
    goals = marginal.pooled(members)
    weight, ends = goals.logits[:, 0].flatten(1).softmax(-1), goals.ends()[:, 0]
    for modes in _MODES:
        chosen, _ = decoding.select(weight, ends, modes)
        at = ends.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 2))
        found[f"min_fde_{modes}"] = (at - batch["future"][:, -1:]).norm(dim=-1).amin(1)
    return found
