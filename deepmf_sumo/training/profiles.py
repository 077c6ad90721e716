"""Speed profiles: k-means of how vehicles of one start speed went on, for the dense goals."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import DT_S, Floats
from deepmf_sumo.errors import RunError
from deepmf_sumo.predictors.anchors import START_SPEEDS_MPS

_NEAREST = 500
_ROUNDS = 30


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProfileTable:
    """Profiles for the dense goals.

    Attributes:
        relative_m: (13, R, 80) s(t) - v0 t by start speed, least distance first.
        log_prior: (13, R) log frequency.
    """

    relative_m: Floats
    log_prior: Floats


def fit(
    distance_m: Floats, speed_mps: Floats, profiles: int, rng: np.random.Generator
) -> ProfileTable:
    """The table of R profiles from distances driven (N, 80) at start speeds (N).

    Raises RunError where there are too few.
    """
    if len(speed_mps) < 2 * profiles:
        raise RunError(
            f"Only {len(speed_mps)} vehicles are known for 8 s, {2 * profiles} are the least to "
            "fit speed profiles; give more recordings."
        )
    times = np.arange(1, distance_m.shape[1] + 1) * DT_S
    relative = distance_m - speed_mps[:, None] * times
    count = min(_NEAREST, max(2 * profiles, len(speed_mps) // 2))
    table, prior = [], []
    for start in START_SPEEDS_MPS:
        near = np.argsort(np.abs(speed_mps - start), kind="stable")[:count]
        centres, shares = _cluster(relative[near], profiles, rng)
        order = np.argsort(centres[:, -1], kind="stable")
        table.append(centres[order])
        prior.append(np.log(np.maximum(shares[order], 1e-3)))
    return ProfileTable(relative_m=np.stack(table), log_prior=np.stack(prior))


def driven(position_m: Floats, heading_rad: Floats) -> Floats:
    """(80) distance driven by positions (81, 2) with headings (81): motion ahead only, summed."""
    step = np.diff(position_m, axis=0)
    ahead = step[:, 0] * np.cos(heading_rad[:-1]) + step[:, 1] * np.sin(heading_rad[:-1])
    distance: Floats = np.maximum.accumulate(np.cumsum(ahead)).clip(min=0.0)
    return distance


def _cluster(values: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """k-means (R, 80) and shares (R); clusters are compared at each half second."""
    seen = values[:, 4::5]
    centres = _spread(seen, count, rng)
    member = np.zeros(len(values), np.int64)
    for _ in range(_ROUNDS):
        member = ((seen[:, None] - centres) ** 2).sum(-1).argmin(1)
        for row in np.unique(member):
            centres[row] = seen[member == row].mean(0)
    full = np.stack(
        [
            values[member == row].mean(0)
            if (member == row).any()
            else np.interp(np.arange(80), np.arange(4, 80, 5), centres[row])
            for row in range(count)
        ]
    )
    return full, np.bincount(member, minlength=count) / len(values)


def _spread(seen: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Start centres by k-means++."""
    centres = [seen[rng.integers(len(seen))]]
    least = ((seen - centres[0]) ** 2).sum(-1)
    for _ in range(count - 1):
        weight = least + 1e-9
        centres.append(seen[rng.choice(len(seen), p=weight / weight.sum())])
        least = np.minimum(least, ((seen - centres[-1]) ** 2).sum(-1))
    return np.stack(centres)
