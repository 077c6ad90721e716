"""Naturalness of many attacks at once: their accelerations against those of the recordings.

Histograms of one run hold 80 samples, so that their divergence is mostly noise; pooled over runs
they have enough for fine bins. The bounded divergence and the distance of filtered accelerations
are the ones to compare by.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from deepmf_sumo.metrics.episode import distributions
from deepmf_sumo.metrics.episode.accelerations import Samples

BINS = 201
"""Of 0.1 m/s2 on [-10.05, 10.05], values outside in the end bins, 1e-10 added to each count."""


class Pooled(NamedTuple):
    """Divergences in nats and distance in m/s2 of pooled samples, and how many there were.

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


def pooled(runs: Iterable[Samples], bins: int = BINS) -> Pooled | None:
    """Compare the accelerations of all runs, of `accelerations.compared`; None without any."""
    given = list(runs)
    if not given:
        return None
    attack, recorded = (np.concatenate(side) for side in zip(*given, strict=True))
    return Pooled(
        runs=len(given),
        attack_samples=len(attack),
        recorded_samples=len(recorded),
        kl=distributions.divergence(attack, recorded, bins),
        kl_reverse=distributions.divergence(recorded, attack, bins),
        jsd=distributions.jensen_shannon(attack, recorded, bins),
        wasserstein=distributions.wasserstein(attack, recorded),
    )
