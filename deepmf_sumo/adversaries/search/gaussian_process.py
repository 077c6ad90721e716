"""A small Gaussian process: what is known of a function from few evaluations.

Kernel Matern 5/2 with a length scale an axis, zero mean, and an amplitude that maximises the
likelihood in closed form (Rasmussen and Williams 2006, chapters 4 and 5).
"""

import math

import numpy as np

from deepmf_sumo.datatypes import Floats

_NOISE = 1e-4  # variance per amplitude: keeps near points from making the kernel singular
_FLAT = 1e-12  # smallest amplitude: a function that is the same everywhere
_FACTORS = (0.5, 2.0)  # of all length scales at once,
_AXIS_FACTORS = (0.6, 1 / 0.6)  # and of one at a time, that a fit tries
_SHORTEST, _LONGEST = 0.1, 20.0


class GaussianProcess:
    """Fitted to values (n) at points (n, D) under given length scales (D)."""

    def __init__(self, points: Floats, values: Floats, scales: Floats) -> None:
        self._scales = scales
        self._points = points / scales
        kernel = _matern(self._points, self._points)
        kernel[np.diag_indices_from(kernel)] += _NOISE
        lower = np.linalg.cholesky(kernel)
        self._whitening = np.linalg.inv(lower)
        white = self._whitening @ values
        self._amplitude = max(float(white @ white) / len(values), _FLAT)
        self._weights = self._whitening.T @ white
        self.log_likelihood = (
            -0.5 * len(values) * math.log(self._amplitude) - np.log(np.diag(lower)).sum()
        )

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Mean and standard deviation, (B) each, at points (B, D)."""
        kernel = _matern(points / self._scales, self._points)
        known = ((kernel @ self._whitening.T) ** 2).sum(-1)
        return kernel @ self._weights, np.sqrt(np.maximum(1 - known, 1e-10) * self._amplitude)


def fitted_scales(points: Floats, values: Floats, scales: Floats) -> Floats:
    """(D) length scales that are likelier than those given: one round of steps along each axis.

    Few points say little of ten scales: a log-normal prior around 1 keeps them within reason.
    """

    def evidence(tried: Floats) -> float:
        prior = -0.5 * float((np.log(tried) ** 2).sum())
        return float(GaussianProcess(points, values, tried).log_likelihood) + prior

    best, most = scales, evidence(scales)
    steps = [np.full(len(scales), factor) for factor in _FACTORS]
    for axis in range(len(scales)):
        for factor in _AXIS_FACTORS:
            steps.append(np.ones(len(scales)))
            steps[-1][axis] = factor
    for step in steps:
        tried = np.clip(best * step, _SHORTEST, _LONGEST)
        found = evidence(tried)
        if found > most:
            best, most = tried, found
    return best


def _matern(first: Floats, second: Floats) -> Floats:
    """(B, n) correlation of points (B, D) and (n, D) in units of the length scales."""
    square = (first**2).sum(-1)[:, None] + (second**2).sum(-1) - 2 * first @ second.T
    away = np.sqrt(5 * np.maximum(square, 0.0))
    correlation: Floats = (1 + away + away**2 / 3) * np.exp(-away)
    return correlation
