"""Log likelihood of where an object was, under a prediction: comparable between networks.

At 8 s it is that of the end under all goals, with a fixed Gaussian kernel of 2 m. Earlier it is
that of the place under the modes with their probabilities: kernels shrink in proportion, with the
tails of Student's t, since a few modes do not cover everything.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats, Forecast
from deepmf_sumo.training.evaluation.displacement import HORIZONS
from deepmf_sumo.training.windows import Future

KERNELS_M: Final = {"3.0": 0.75, "5.0": 1.25, "8.0": 2.0}
_FREEDOM: Final = 4
"""Degrees of freedom of Student's t."""

EndDensity = Callable[[Floats, float], Floats]
"""Ends (Q, 2) and the kernel's width in metres -> log densities (Q)."""


def by_horizon(
    forecast: Forecast, future: Future, end_density: EndDensity
) -> dict[str, float | None]:
    """Log likelihood at each horizon, nats; None where the object is not known there."""
    found: dict[str, float | None] = {}
    for key, (step, *_) in HORIZONS.items():
        if not future.valid[step]:
            found[key] = None
        elif key == "8.0":
            found[key] = float(end_density(future.position_m[step][None], KERNELS_M[key])[0])
        else:
            found[key] = of_modes(forecast, step, future.position_m[step], KERNELS_M[key])
    return found


def of_modes(forecast: Forecast, step: int, place_m: Floats, kernel_m: float) -> float:
    """Log density of a place (2) at a step: a bivariate t on each mode, weighed by probability."""
    off = (forecast.futures.position_m[:, step] - place_m) / kernel_m
    tail = -(_FREEDOM + 2) / 2 * np.log1p((off**2).sum(-1) / _FREEDOM)
    log = np.log(np.maximum(forecast.probability, 1e-12)) + tail - np.log(2 * np.pi * kernel_m**2)
    return float(np.logaddexp.reduce(log))
