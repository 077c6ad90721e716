"""Expected calibration error: do things happen as often as their probability says?"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Forecast
from deepmf_sumo.training.evaluation.displacement import STEPS
from deepmf_sumo.training.windows import Future

BINS: Final = 10
_DRAWINGS: Final = 1000


def expected_error(probability: Floats, happened: Bools) -> float | None:
    """Mean of |share that happened - mean probability| over ten equal bins, weighed by count."""
    if not len(probability):
        return None
    row = np.minimum((probability * BINS).astype(int), BINS - 1)
    apart = np.bincount(row, weights=probability - happened, minlength=BINS)
    return round(float(np.abs(apart).sum() / len(probability)), 4)


def error_if_right(probability: Floats) -> tuple[float, float] | None:
    """What `expected_error` shows of so many probabilities that are right: mean, and 95 % quantile.

    Few draws never happen just as often as they should. By 1000 drawings, the same each time.
    """
    if not len(probability):
        return None
    rng = np.random.default_rng(0)
    drawn = [
        expected_error(probability, rng.random(len(probability)) < probability) or 0.0
        for _ in range(_DRAWINGS)
    ]
    return round(float(np.mean(drawn)), 4), round(float(np.quantile(drawn, 0.95)), 4)


@dataclass(slots=True)
class ModeCalibration:
    """Probabilities of modes, and which of them came nearest to what happened, by horizon."""

    probability: dict[str, list[Floats]] = field(default_factory=lambda: {key: [] for key in STEPS})
    nearest: dict[str, list[Bools]] = field(default_factory=lambda: {key: [] for key in STEPS})

    def add(self, forecast: Forecast, future: Future) -> None:
        """One object's forecast of M modes."""
        for key, step in STEPS.items():
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
