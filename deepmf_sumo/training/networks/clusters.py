"""k-means of recorded motion: speed profiles for the dense goals, and a map-blind baseline.

The baseline clusters the trajectories nearest to each cell of a grid of speeds and yaw rates, as
deviations from constant velocity in the vehicle's frame.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from deepmf_sumo import files
from deepmf_sumo.deepmf.networks.anchors import START_SPEEDS_MPS
from deepmf_sumo.errors import RunError, WeightsError
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Bools, Floats, Ints
from deepmf_sumo.training.fit import checkpoints

FILE: Final = "clusters.safetensors"
MODES: Final = (6, 16, 32)
SPEEDS_MPS: Final = (0.0, 0.5, 1.5, 3.0, 5.0, 7.0, 9.0, 11.0, 13.5, 16.0, 20.0, 25.0, 30.0)
YAW_RATES_RADPS: Final = (-0.4, -0.2, -0.07, 0.0, 0.07, 0.2, 0.4)
_NEAREST: Final = 500
_ROUNDS: Final = 25
_PROFILE_ROUNDS: Final = 30
_SPEED_SCALE_MPS, _YAW_SCALE_RADPS = 1.0, 0.05
"""Units in which the distance of speeds and yaw rates to a cell is measured."""
_EVERY: Final = 5
"""Clusters are stored at 2 Hz."""
_TIMES_S = np.arange(_EVERY, FUTURE_STEPS + 1, _EVERY) * DT_S


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProfileTable:
    """Profiles for the dense goals.

    Attributes:
        relative_m: (13, R, 80) s(t) - v0 t by start speed, least distance first.
        log_prior: (13, R) log frequency.
    """

    relative_m: Floats
    log_prior: Floats


def speed_profiles(
    distance_m: Floats, speed_mps: Floats, profiles: int, rng: np.random.Generator
) -> ProfileTable:
    """The table of R profiles from distances driven (N, 80) at start speeds (N).

    Raises RunError if there are too few.
    """
    if len(speed_mps) < 2 * profiles:
        raise RunError(
            f"Only {len(speed_mps)} vehicles are known for 8 s, but speed profiles need at least "
            f"{2 * profiles}; give more recordings."
        )
    times = np.arange(1, distance_m.shape[1] + 1) * DT_S
    relative = distance_m - speed_mps[:, None] * times
    count = min(_NEAREST, max(2 * profiles, len(speed_mps) // 2))
    table, prior = [], []
    for start in START_SPEEDS_MPS:
        near = np.argsort(np.abs(speed_mps - start), kind="stable")[:count]
        centres, shares = _profile_means(relative[near], profiles, rng)
        order = np.argsort(centres[:, -1], kind="stable")
        table.append(centres[order])
        prior.append(np.log(np.maximum(shares[order], 1e-3)))
    return ProfileTable(relative_m=np.stack(table), log_prior=np.stack(prior))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Clusters:
    """Fitted clusters.

    Attributes:
        deviation_m: modes -> (S, Y, M, 16, 2) position minus that of constant velocity at 2 Hz, x
            ahead and y to the left, largest cluster first; S speeds, Y yaw rates.
        samples: number of fitted trajectories.
    """

    deviation_m: dict[int, Floats]
    samples: int


def fit(future_m: Floats, valid: Bools, motion: Floats, rng: np.random.Generator) -> Clusters:
    """Clusters of futures (N, 80, 2) in each vehicle's frame, valid (N, 80), motion (N, 6).

    ``motion`` is that of `encode.Features`: speed first, yaw rate third. Futures that are not
    known at each half second are left out. Raises RunError if fewer than 32 are left.
    """
    rows = slice(_EVERY - 1, None, _EVERY)
    known = np.asarray(valid, bool)[:, rows].all(1)
    if int(known.sum()) < max(MODES):
        raise RunError(
            f"Only {int(known.sum())} vehicles are known for 8 s, but clusters need at least "
            f"{max(MODES)}; give more recordings."
        )
    speed = np.asarray(motion[known, 0], float)
    yaw_rate = np.asarray(motion[known, 2], float)
    went = np.asarray(future_m[known][:, rows], float)
    went[..., 0] -= speed[:, None] * _TIMES_S
    went = went.reshape(len(went), -1)  # (N, 32)
    count = min(_NEAREST, max(*MODES, len(went) // 4))
    made: dict[int, list[Floats]] = {modes: [] for modes in MODES}
    for start in SPEEDS_MPS:
        for turn in YAW_RATES_RADPS:
            apart = ((speed - start) / _SPEED_SCALE_MPS) ** 2
            apart += ((yaw_rate - turn) / _YAW_SCALE_RADPS) ** 2
            near = went[np.argpartition(apart, count - 1)[:count]]
            for modes in MODES:
                made[modes].append(_k_means(near, modes, rng))
    grid = (len(SPEEDS_MPS), len(YAW_RATES_RADPS))
    return Clusters(
        deviation_m={
            modes: np.stack(cells).reshape(*grid, modes, len(_TIMES_S), 2)
            for modes, cells in made.items()
        },
        samples=len(went),
    )


def predict(clusters: Clusters, speed_mps: float, yaw_rate_radps: float, modes: int) -> Floats:
    """(M, 80, 2) trajectories of the nearest cell, in the vehicle's frame, largest cluster first.

    Raises ValueError for a number of modes other than those of `MODES`.
    """
    if modes not in clusters.deviation_m:
        raise ValueError(f"clusters are fitted for {MODES} modes, not {modes}")
    row = int(np.abs(np.array(SPEEDS_MPS) - speed_mps).argmin())
    column = int(np.abs(np.array(YAW_RATES_RADPS) - yaw_rate_radps).argmin())
    deviation = clusters.deviation_m[modes][row, column]  # (M, 16, 2)
    times, knots = np.arange(1, FUTURE_STEPS + 1) * DT_S, np.concatenate([[0.0], _TIMES_S])
    deviation = np.concatenate([np.zeros((modes, 1, 2)), deviation], axis=1)
    base = np.clip(np.searchsorted(knots, times) - 1, 0, len(knots) - 2)
    share = ((times - knots[base]) / (knots[base + 1] - knots[base]))[:, None]
    path = (1 - share) * deviation[:, base] + share * deviation[:, base + 1]
    path[..., 0] += speed_mps * times
    return np.asarray(path, float)


def write(clusters: Clusters, folder: Path) -> None:
    """Write the clusters to the folder of the weights."""
    arrays = {
        f"modes_{modes}": values.astype(np.float16)
        for modes, values in clusters.deviation_m.items()
    }
    arrays["samples"] = np.array([clusters.samples])
    checkpoints.write(folder / FILE, save(arrays))


def read(folder: Path) -> Clusters | None:
    """The clusters in the folder of the weights; None if there are none.

    Raises WeightsError if the file is damaged or has another grid.
    """
    file = folder / FILE
    if not file.is_file():
        return None
    again = "write it again with `deepmf-sumo train marginal`, or remove it"
    try:
        arrays = load(files.content(file))
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{file} is damaged ({error}); {again}.") from None
    grid = (len(SPEEDS_MPS), len(YAW_RATES_RADPS))
    found = {}
    for modes in MODES:
        values = arrays.get(f"modes_{modes}")
        if values is None or values.shape != (*grid, modes, len(_TIMES_S), 2):
            raise WeightsError(f"{file} has no clusters of {modes} modes that fit; {again}.")
        found[modes] = np.asarray(values, float)
    if "samples" not in arrays:
        raise WeightsError(f"{file} lacks 'samples'; {again}.")
    return Clusters(deviation_m=found, samples=int(arrays["samples"][0]))


def _profile_means(values: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Means (R, 80) and shares (R) of clusters by distances at each half second."""
    seen = values[:, 4::5]
    centres = _spread(seen, count, rng)
    member = np.zeros(len(values), np.int64)
    for _ in range(_PROFILE_ROUNDS):
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


def _k_means(values: Floats, modes: int, rng: np.random.Generator) -> Floats:
    """(M, D) centres of values (N, D), largest cluster first."""
    centres = _spread(values, modes, rng)
    member = _nearest(values, centres)
    for _ in range(_ROUNDS):
        counts = np.bincount(member, minlength=modes)
        sums = np.zeros_like(centres)
        np.add.at(sums, member, values)
        centres = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centres)
        again = _nearest(values, centres)
        if np.array_equal(again, member):
            break
        member = again
    order = np.argsort(-np.bincount(member, minlength=modes), kind="stable")
    return np.asarray(centres[order], float)


def _nearest(values: Floats, centres: Floats) -> Ints:
    """(N) row of the nearest centre."""
    square = (centres**2).sum(1) - 2 * values @ centres.T
    return np.asarray(square.argmin(1), np.int64)


def _spread(values: Floats, modes: int, rng: np.random.Generator) -> Floats:
    """(M, D) start centres by k-means++."""
    centres = [values[rng.integers(len(values))]]
    least = ((values - centres[0]) ** 2).sum(-1)
    for _ in range(modes - 1):
        weight = least + 1e-9
        centres.append(values[rng.choice(len(values), p=weight / weight.sum())])
        least = np.minimum(least, ((values - centres[-1]) ** 2).sum(-1))
    return np.stack(centres)
