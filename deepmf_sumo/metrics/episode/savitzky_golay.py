"""Derivatives of noisy samples (Savitzky, Golay: Analytical Chemistry 36, 1964)."""

import functools

import numpy as np

from deepmf_sumo.datatypes import Floats

WINDOW = 11
_ORDER = 2


def derivative(values: Floats, dt_s: float) -> Floats:
    """(K) first derivative of samples (K), K >= `WINDOW`: slope of the parabola through 11 of them.

    The five samples at each end lie on the parabola of the first and of the last window.
    """
    samples = np.asarray(values, float)
    half = WINDOW // 2
    slopes = _slopes()
    windows = np.lib.stride_tricks.sliding_window_view(samples, WINDOW)
    inner = windows @ slopes[half]
    begin, end = slopes[:half] @ windows[0], slopes[half + 1 :] @ windows[-1]
    rates: Floats = np.concatenate([begin, inner, end]) / dt_s
    return rates


@functools.cache
def _slopes() -> Floats:
    """(WINDOW, WINDOW) row i: weights of the samples in the parabola's slope at sample i."""
    at = np.arange(WINDOW, dtype=float) - WINDOW // 2
    fit = np.linalg.pinv(np.vander(at, _ORDER + 1, increasing=True))
    slopes: Floats = fit[1] + 2 * at[:, None] * fit[2]
    return slopes
