"""Errors, calibration and likelihood of forecasts, with standard errors, rounded for tables."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Forecast
from deepmf_sumo.training.samples.windows import Future

HORIZONS: Final[dict[str, tuple[int, float, float]]] = {
    "3.0": (29, 1.0, 2.0),
    "5.0": (49, 1.8, 3.6),
    "8.0": (79, 3.0, 6.0),
}
"""Seconds -> index in the 80 steps, and WOMD's miss thresholds across and along, metres."""
EARLY: Final[dict[str, int]] = {"1.0": 9, "2.0": 19}
"""Seconds at which the attack needs its best mode close; WOMD has no miss rule there."""
STEPS: Final[dict[str, int]] = EARLY | {key: step for key, (step, *_) in HORIZONS.items()}
BINS: Final = 10
_DRAWINGS: Final = 1000
KERNELS_M: Final = {"3.0": 0.75, "5.0": 1.25, "8.0": 2.0}
_FREEDOM: Final = 4
"""Degrees of freedom of Student's t."""
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


@dataclass(slots=True)
class DisplacementErrors:
    """Errors of the best of M modes, a value an object; ADE at 2 Hz up to each horizon.

    An object counts at a horizon where it is known there (ADE: anywhere up to there).
    """

    ade: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in HORIZONS})
    fde: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in STEPS})
    missed: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in HORIZONS})

    def add(
        self,
        modes_m: Floats,
        true_m: Floats,
        true_heading_rad: Floats,
        valid: Bools,
        speed_mps: float,
    ) -> None:
        """One object: modes (M, 80, 2), what happened (80, 2), (80), (80), start speed."""
        error = np.linalg.norm(modes_m - true_m, axis=-1)  # (M, 80)
        for key, step in STEPS.items():
            if valid[step]:
                self.fde[key].append(float(error[:, step].min()))
        for key, (step, across_m, along_m) in HORIZONS.items():
            seen = np.arange(4, step + 1, 5)
            seen = seen[valid[seen]]
            if len(seen):
                self.ade[key].append(float(error[:, seen].mean(1).min()))
            if not valid[step]:
                continue
            off = modes_m[:, step] - true_m[step]
            cos, sin = np.cos(true_heading_rad[step]), np.sin(true_heading_rad[step])
            factor = _speed_factor(speed_mps)
            along = np.abs(off[:, 0] * cos + off[:, 1] * sin) <= along_m * factor
            across = np.abs(off[:, 1] * cos - off[:, 0] * sin) <= across_m * factor
            self.missed[key].append(float(not (along & across).any()))


def error_summary(errors: dict[int, DisplacementErrors], key: str) -> dict[str, object]:
    """Least final errors with standard errors, minADE and miss rate, each by number of modes."""
    found: dict[str, object] = {
        "min_fde": {str(modes): mean(each.fde[key]) for modes, each in errors.items()},
        "min_fde_standard_error": {
            str(modes): standard_error(each.fde[key]) for modes, each in errors.items()
        },
    }
    if key in HORIZONS:
        found["min_ade"] = {str(modes): mean(each.ade[key]) for modes, each in errors.items()}
        found["miss_rate"] = {str(modes): mean(each.missed[key]) for modes, each in errors.items()}
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


@dataclass(slots=True)
class ModeCalibration:
    """Probabilities of modes, and which of them came nearest to what happened, by horizon."""

    probability: dict[str, list[Floats]] = field(default_factory=lambda: {key: [] for key in STEPS})
    nearest: dict[str, list[Bools]] = field(default_factory=lambda: {key: [] for key in STEPS})

    def add(self, forecast: Forecast, future: Future, horizons: Collection[str] = STEPS) -> None:
        """One object's forecast of M modes, of which one comes nearest at each horizon."""
        for key in horizons:
            step = STEPS[key]
            if not future.valid[step]:
                continue
            off = forecast.futures.position_m[:, step] - future.position_m[step]
            error = np.hypot(off[:, 0], off[:, 1])
            self.probability[key].append(forecast.probability)
            self.nearest[key].append(np.arange(len(error)) == error.argmin())

    def error(self, key: str) -> float | None:
        """Expected calibration error at a horizon."""
        if not self.probability[key]:
            return None
        probability = np.concatenate(self.probability[key])
        return expected_error(probability, np.concatenate(self.nearest[key]))

    def error_if_right(self, key: str) -> tuple[float, float] | tuple[None, None]:
        """The mean and the 95 % quantile of `error` if the probabilities were right."""
        each = self.probability[key]
        if not each:
            return None, None
        return error_if_right(np.concatenate(each), [len(one) for one in each]) or (None, None)


def log_likelihoods(
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
