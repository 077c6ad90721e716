"""How different attacks are from each other."""

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence

import numpy as np

from deepmf_sumo.datatypes import Floats


def mean_distance_m(paths_m: Sequence[Floats]) -> float | None:
    """Mean distance of the opponents' trajectories, over all pairs; None for fewer than two.

    Trajectories (K, 2), K >= 1, begin at the same time and are in one frame: those of attacks on
    one scene, or each in the frame of its AV's first pose. Of two the mean distance at equal times
    counts, as long as both last.
    """
    if len(paths_m) < 2:
        return None
    every = np.full((len(paths_m), max(map(len, paths_m)), 2), np.nan)
    for row, path in zip(every, paths_m, strict=True):
        row[: len(path)] = path
    return float(
        np.concatenate([_to_later(every, number) for number in range(len(every) - 1)]).mean()
    )


def mean_distance_within_m(scenes: Iterable[Sequence[Floats]]) -> float | None:
    """`mean_distance_m` of each scene's attacks, mean over scenes with two attacks or more."""
    means = [mean for paths in scenes if (mean := mean_distance_m(paths)) is not None]
    return float(np.mean(means)) if means else None


def kinds(values: Iterable[Hashable | None]) -> int:
    """Number of different impact sectors or accident types; None (no collision) is not counted."""
    return len({value for value in values if value is not None})


def effective_kinds(values: Iterable[Hashable | None]) -> float:
    """Exponential of the entropy of sectors or types: how many are about equally frequent."""
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
