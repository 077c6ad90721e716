"""Errors, calibration and likelihood of forecasts, with standard errors, rounded for tables."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from deepmf_sumo.scene import FUTURE_STEPS, Bools, Floats, Forecast
from deepmf_sumo.training.samples.windows import Future

HORIZONS: Final[Mapping[float, tuple[int, float, float]]] = {
    3.0: (29, 1.0, 2.0),
    5.0: (49, 1.8, 3.6),
    8.0: (79, 3.0, 6.0),
}
"""Seconds -> index in the 80 steps, and WOMD's miss thresholds across and along, metres."""
EARLY: Final[Mapping[float, int]] = {1.0: 9, 2.0: 19}
"""Seconds at which the attack needs its best mode close; WOMD has no miss rule there."""
STEPS: Final[Mapping[float, int]] = {
    **EARLY,
    **{seconds: step for seconds, (step, *_) in HORIZONS.items()},
}
BINS: Final = 10
_DRAWINGS: Final = 1000
KERNELS_M: Final = {3.0: 0.75, 5.0: 1.25, 8.0: 2.0}
_FREEDOM: Final = 4
"""Degrees of freedom of Student's t."""
Measured = tuple[str, float]
"""Quantity and horizon in seconds."""
EndDensity = Callable[[Floats, float], Floats]
"""Ends (Q, 2) and the kernel's width in metres -> log densities (Q)."""


def mean(values: Sequence[float], digits: int = 3) -> float | None:
    """Rounded mean; None of nothing."""
    return round(float(np.mean(values)), digits) if len(values) else None


def standard_error(values: Sequence[float], digits: int = 3) -> float | None:
    """Rounded standard error of the mean; None of fewer than two values."""
    if len(values) < 2:
        return None
    return round(float(np.std(values, ddof=1) / np.sqrt(len(values))), digits)


def difference(
    values: Sequence[float], others: Sequence[float]
) -> tuple[float | None, float | None]:
    """Mean of the paired differences ``values - others`` and its standard error.

    Both are None where one of them was not measured for each object.
    """
    if len(values) != len(others):
        return None, None
    apart = (np.asarray(values, float) - np.asarray(others, float)).tolist()
    return mean(apart), standard_error(apart)


def final_errors(
    modes_m: Floats, future: Future, quantity: str, horizons: Iterable[float] = STEPS
) -> dict[Measured, float]:
    """Distance of the best of modes (M, 80, 2) at each horizon at which the object is known."""
    return {
        (quantity, seconds): float(
            np.linalg.norm(modes_m[:, step] - future.position_m[step], axis=-1).min()
        )
        for seconds, step in STEPS.items()
        if seconds in horizons and future.valid[step]
    }


def path_errors(modes_m: Floats, future: Future, speed_mps: float) -> dict[Measured, float]:
    """``min_ade`` (at 2 Hz up to each horizon) and ``miss_rate`` of modes (M, 80, 2).

    An object counts at a horizon if it is known there (ADE: at any step up to there).
    ``speed_mps`` is its speed now.
    """
    found: dict[Measured, float] = {}
    error = np.linalg.norm(modes_m - future.position_m, axis=-1)  # (M, 80)
    for seconds, (step, across_m, along_m) in HORIZONS.items():
        seen = np.arange(4, step + 1, 5)
        seen = seen[future.valid[seen]]
        if len(seen):
            found["min_ade", seconds] = float(error[:, seen].mean(1).min())
        if future.valid[step]:
            off = modes_m[:, step] - future.position_m[step]
            cos, sin = np.cos(future.heading_rad[step]), np.sin(future.heading_rad[step])
            factor = _speed_factor(speed_mps)
            along = np.abs(off[:, 0] * cos + off[:, 1] * sin) <= along_m * factor
            across = np.abs(off[:, 1] * cos - off[:, 0] * sin) <= across_m * factor
            found["miss_rate", seconds] = float(not (along & across).any())
    return found


def _speed_factor(speed_mps: float) -> float:
    """WOMD's scale of miss thresholds: 0.5 below 1.4 m/s, 1 above 11 m/s, linear between."""
    return 0.5 + 0.5 * min(max((speed_mps - 1.4) / (11.0 - 1.4), 0.0), 1.0)


def expected_error(probability: Floats, happened: Bools) -> float | None:
    """Mean of |share that happened - mean probability| over ten equal bins, weighed by count."""
    if not len(probability):
        return None
    row = np.minimum((probability * BINS).astype(int), BINS - 1)
    apart = np.bincount(row, weights=probability - happened, minlength=BINS)
    return round(float(np.abs(apart).sum() / len(probability)), 4)


def error_if_right(
    probability: Floats, groups: Sequence[int] | None = None
) -> tuple[float, float] | None:
    """`expected_error` of as many correct probabilities: its mean and 95 % quantile.

    A finite sample never matches its probabilities exactly. By 1000 draws with a fixed seed.

    Args:
        probability: of each of N events.
        groups: sizes, N in all, of the runs of events of which at most one happens; without them
            each event happens whatever the others do.
    """
    if not len(probability):
        return None
    sizes = np.ones(len(probability), int) if groups is None else np.asarray(groups, int)
    up_to = np.cumsum(probability)
    first = np.cumsum(sizes) - sizes
    up_to -= np.repeat(up_to[first] - probability[first], sizes)  # within its group
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(_DRAWINGS):
        point = np.repeat(rng.random(len(sizes)), sizes)
        happened = (up_to - probability <= point) & (point < up_to)
        drawn.append(expected_error(probability, happened) or 0.0)
    return round(float(np.mean(drawn)), 4), round(float(np.quantile(drawn, 0.95)), 4)


def nearest_modes(
    forecast: Forecast, future: Future, kind: str = "", horizons: Iterable[float] = HORIZONS
) -> dict[Measured, Floats]:
    """``probability`` (M) of the modes, and which of them is the ``nearest`` (M) at each horizon.

    ``kind`` is the end of the names of both.
    """
    found: dict[Measured, Floats] = {}
    for seconds in horizons:
        step = STEPS[seconds]
        if future.valid[step]:
            off = forecast.futures.position_m[:, step] - future.position_m[step]
            error = np.hypot(off[:, 0], off[:, 1])
            found[f"probability{kind}", seconds] = forecast.probability
            found[f"nearest{kind}", seconds] = np.arange(len(error)) == error.argmin()
    return found


def log_likelihoods(
    forecast: Forecast, future: Future, end_density: EndDensity
) -> dict[Measured, float]:
    """``log_likelihood`` at each horizon at which the object is known, nats."""
    found: dict[Measured, float] = {}
    for seconds, (step, *_) in HORIZONS.items():
        if future.valid[step]:
            place, kernel_m = future.position_m[step], KERNELS_M[seconds]
            found["log_likelihood", seconds] = (
                float(end_density(place[None], kernel_m)[0])
                if step == FUTURE_STEPS - 1
                else of_modes(forecast, step, place, kernel_m)
            )
    return found


def of_modes(forecast: Forecast, step: int, place_m: Floats, kernel_m: float) -> float:
    """Log density of a position (2) at a step: a bivariate t at each mode, by probability."""
    off = (forecast.futures.position_m[:, step] - place_m) / kernel_m
    tail = -(_FREEDOM + 2) / 2 * np.log1p((off**2).sum(-1) / _FREEDOM)
    log = np.log(np.maximum(forecast.probability, 1e-12)) + tail - np.log(2 * np.pi * kernel_m**2)
    return float(np.logaddexp.reduce(log))
