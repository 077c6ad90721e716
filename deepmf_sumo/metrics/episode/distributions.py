"""Distributions of accelerations, compared."""

import numpy as np

from deepmf_sumo.datatypes import Floats

_BINS = np.linspace(-10.0, 10.0, 21)
_PSEUDO_COUNT = 1e-10
_QUANTILES = (np.arange(1000) + 0.5) / 1000


def speed_changes(path_m: Floats, dt_s: float) -> Floats:
    """(K - 2) signed changes of speed in m/s2 along a path (K, 2) with a point every ``dt_s``."""
    speed = np.hypot(*np.diff(path_m, axis=0).T) / dt_s
    changes: Floats = np.diff(speed) / dt_s
    return changes


def speed_changes_of(stretches: list[Floats], dt_s: float) -> Floats:
    """Signed changes of speed along several stretches (K, 2) of motion, K >= 1 each."""
    changes: Floats = np.concatenate([np.empty(0), *(speed_changes(s, dt_s) for s in stretches)])
    return changes


def wasserstein(a: Floats, b: Floats) -> float:
    """First Wasserstein distance of two samples: mean difference of their quantiles."""
    inverted = [np.quantile(sample, _QUANTILES, method="inverted_cdf") for sample in (a, b)]
    return float(np.abs(inverted[0] - inverted[1]).mean())


def divergence(a: Floats, b: Floats) -> float:
    """KL(a || b) in nats of histograms of two samples."""
    shares = []
    for sample in (a, b):
        inside = np.clip(sample, _BINS[0], _BINS[-1])
        count = np.histogram(inside, _BINS)[0] + _PSEUDO_COUNT
        shares.append(count / count.sum())
    return float((shares[0] * np.log(shares[0] / shares[1])).sum())
