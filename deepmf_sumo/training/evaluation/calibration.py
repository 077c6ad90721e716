"""Expected calibration error: do things happen as often as their probability says?"""

from collections.abc import Collection, Sequence
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


def error_if_right(
    probability: Floats, groups: Sequence[int] | None = None
) -> tuple[float, float] | None:
    """What `expected_error` shows of so many probabilities that are right: mean, and 95 % quantile.

    Few draws never happen just as often as they should. By 1000 drawings, the same each time.

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
        """What `error` would show on average, and in 95 % at most, were the probabilities right."""
        each = self.probability[key]
        if not each:
            return None, None
        return error_if_right(np.concatenate(each), [len(one) for one in each]) or (None, None)
