"""Numbers of many runs together: pooled naturalness, diversity."""

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import naturalness
from deepmf_sumo.judge.metrics.naturalness import AccelerationSamples
from deepmf_sumo.scene import Floats

BINS = 201
"""Bins of 0.1 m/s2 on [-10.05, 10.05], values outside in the end bins, 1e-10 added per count."""


class Pooled(NamedTuple):
    """Divergences in nats and distance in m/s2 of pooled samples, and their numbers.

    ``kl`` is KL(attacks || recordings), ``kl_reverse`` the other direction; ``jsd`` the
    Jensen-Shannon divergence, 0 to log 2.
    """

    runs: int
    attack_samples: int
    recorded_samples: int
    kl: float
    kl_reverse: float
    jsd: float
    wasserstein: float


def pooled(runs: Iterable[AccelerationSamples], bins: int = BINS) -> Pooled | None:
    """Compare the accelerations of all runs, of `naturalness.samples`; None without any.

    The histograms of one run have 80 samples, so that their divergence is mostly noise; pooled over
    runs there are enough for fine bins. Compare by the bounded divergence and the distance of
    filtered accelerations.
    """
    given = list(runs)
    if not given:
        return None
    attack, recorded = (np.concatenate(side) for side in zip(*given, strict=True))
    return Pooled(
        runs=len(given),
        attack_samples=len(attack),
        recorded_samples=len(recorded),
        kl=naturalness.divergence(attack, recorded, bins),
        kl_reverse=naturalness.divergence(recorded, attack, bins),
        jsd=naturalness.jensen_shannon(attack, recorded, bins),
        wasserstein=naturalness.wasserstein(attack, recorded),
    )


def diversity_m(paths_m: Sequence[Floats]) -> float | None:
    """Mean distance of the opponents' trajectories, over all pairs; None for fewer than two.

    Trajectories (K, 2), K >= 1, start at the same time and are in one frame: those of attacks on
    one scene, or each in the frame of its AV's first pose. The distance of two is the mean over the
    times that both have.
    """
    if len(paths_m) < 2:
        return None
    every = np.full((len(paths_m), max(map(len, paths_m)), 2), np.nan)
    for row, path in zip(every, paths_m, strict=True):
        row[: len(path)] = path
    return float(
        np.concatenate([_to_later(every, number) for number in range(len(every) - 1)]).mean()
    )


def diversity_within_m(scenes: Iterable[Sequence[Floats]]) -> float | None:
    """`diversity_m` of each scene's attacks, mean over scenes with two attacks or more."""
    means = [mean for paths in scenes if (mean := diversity_m(paths)) is not None]
    return float(np.mean(means)) if means else None


def distinct(values: Iterable[Hashable | None]) -> int:
    """Number of different impact sectors or accident types; None (no collision) is not counted."""
    return len({value for value in values if value is not None})


def effectively_distinct(values: Iterable[Hashable | None]) -> float:
    """Exponential of the entropy of sectors or types: the effective number of them."""
    counts = np.array(list(Counter(one for one in values if one is not None).values()), float)
    if not len(counts):
        return 0.0
    share = counts / counts.sum()
    return float(np.exp(-(share * np.log(share)).sum()))


def _to_later(every: Floats, number: int) -> Floats:
    """Mean distances of a trajectory to those after it; NaN where a trajectory has ended."""
    away = every[number + 1 :] - every[number]
    distances: Floats = np.nanmean(np.hypot(away[..., 0], away[..., 1]), axis=1)
    return distances
