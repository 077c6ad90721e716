"""Distributions of accelerations, compared: divergences of histograms, and distance of samples."""

import numpy as np

from deepmf_sumo.datatypes import Floats

LIMIT_MPS2 = 10.0
"""Centres of the end bins; what lies outside is counted in them."""
BINS = 21
"""Of one run's histograms: 1 m/s2 wide, from -10.5 to 10.5. An odd number has a bin around 0: most
samples of slow cars lie there, and an edge at 0 would count them by the sign of their noise."""
_PSEUDO_COUNT = 1e-10


def wasserstein(a: Floats, b: Floats) -> float:
    """First Wasserstein distance of two samples: area between their distribution functions."""
    a, b = np.sort(a), np.sort(b)
    both = np.sort(np.concatenate([a, b]))
    below = [np.searchsorted(sample, both[:-1], "right") / len(sample) for sample in (a, b)]
    return float((np.abs(below[0] - below[1]) * np.diff(both)).sum())


def divergence(a: Floats, b: Floats, bins: int = BINS) -> float:
    """KL(a || b) in nats of histograms of two samples, 1e-10 added to each count."""
    p, q = shares(a, bins), shares(b, bins)
    return float((p * np.log(p / q)).sum())


def jensen_shannon(a: Floats, b: Floats, bins: int = BINS) -> float:
    """Jensen-Shannon divergence in nats, 0..log 2, of histograms of two samples."""
    p, q = shares(a, bins), shares(b, bins)
    middle = (p + q) / 2
    return float((p * np.log(p / middle) + q * np.log(q / middle)).sum() / 2)


def shares(sample: Floats, bins: int) -> Floats:
    """(bins) relative frequencies, all positive; the end bins are centred on -10 and 10 m/s2."""
    inside = np.clip(sample, -LIMIT_MPS2, LIMIT_MPS2)
    end = LIMIT_MPS2 * bins / (bins - 1)
    count = np.histogram(inside, bins, (-end, end))[0] + _PSEUDO_COUNT
    frequency: Floats = count / count.sum()
    return frequency
