"""Batches made more various: mirrored, seen less completely, measured less exactly.

Each change keeps what a sample says true: what is mirrored is mirrored everywhere; who is left out
of sight is the other vehicles and the map, never the target, its paths, or a given future (though
its vehicle's past may be: one may know where somebody goes without having seen them come).
"""

from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.predictors import raster
from deepmf_sumo.predictors.config import Preset

MIRRORED: Final = 0.3
AGENT_DROPPED: Final = 0.1
LANE_DROPPED: Final = 0.05
POSITION_NOISE_M: Final = 0.03
HEADING_NOISE_RAD: Final = 0.01

_LEFT_COLUMNS: Final = {
    "agents": (1, 3, 5),
    "lanes": (1,),
    "paths": (1,),
    "path_info": (2, 3),
    "path_agents": (1, 3, 5),
    "motion": (2,),
    "future": (1,),
    "partner": (1, 2),
}
"""Columns that change their sign when left becomes right."""


def augmented(
    batch: dict[str, Tensor], preset: Preset, generator: torch.Generator
) -> dict[str, Tensor]:
    """A batch of `samples.trajectory_samples`, changed at random."""
    batch = _noisy(_dropped(dict(batch), generator), generator)
    rows = _drawn(len(batch["motion"]), MIRRORED, generator, batch["motion"].device)
    return mirrored(batch, rows, preset)


def mirrored(batch: dict[str, Tensor], rows: Tensor, preset: Preset) -> dict[str, Tensor]:
    """Left and right exchanged in the given rows (B)."""
    batch = dict(batch)
    for name, columns in _LEFT_COLUMNS.items():
        values = batch[name]
        sign = torch.ones_like(values)
        sign[..., list(columns)] = (1.0 - 2.0 * rows.to(values.dtype)).view(
            -1, *[1] * (values.ndim - 1)
        )
        batch[name] = values * sign
    if preset.raster and rows.any():
        bits = batch["raster"].clone()
        bits[rows] = raster.repack(raster.unpack(bits[rows], preset).flip(3))
        batch["raster"] = bits
    return batch


def _dropped(batch: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Agents and pieces of lanes that were overlooked; they stay in the image."""
    for states, info, share, column, first in (
        ("agents", "agent_info", AGENT_DROPPED, 7, 1),
        ("lanes", "lane_info", LANE_DROPPED, 9, 0),
        ("path_agents", "path_agents", AGENT_DROPPED, 7, 0),
    ):
        there = batch[info][..., column]
        keep = ~_drawn(there.shape, share, generator, there.device)
        keep[:, :first] = True
        batch[info] = batch[info] * keep.unsqueeze(-1)
        if states != info:
            mask = keep.view(*keep.shape, *[1] * (batch[states].ndim - keep.ndim))
            batch[states] = batch[states] * mask
    return batch


def _noisy(batch: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Histories of the others with small errors, the same ones at all steps of an agent."""
    agents = batch["agents"].clone()
    shape = (*agents.shape[:2], 1)
    shift = torch.randn(*shape, 2, generator=generator).to(agents.device) * POSITION_NOISE_M
    turn = torch.randn(*shape, generator=generator).to(agents.device) * HEADING_NOISE_RAD
    there = agents[..., 6]
    shift[:, 0], turn[:, 0] = 0.0, 0.0
    agents[..., 0:2] += shift * there.unsqueeze(-1)
    cos, sin = agents[..., 2].clone(), agents[..., 3].clone()
    agents[..., 2] = cos * turn.cos() - sin * turn.sin()
    agents[..., 3] = sin * turn.cos() + cos * turn.sin()
    batch["agents"] = agents
    return batch


def _drawn(
    shape: int | torch.Size, share: float, generator: torch.Generator, device: torch.device
) -> Tensor:
    """True with the given probability."""
    size = (shape,) if isinstance(shape, int) else tuple(shape)
    return (torch.rand(size, generator=generator) < share).to(device)
