"""Distances between predicted modes and what happened, as WOMD defines them."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats
from deepmf_sumo.training.evaluation.estimates import mean, standard_error

HORIZONS: Final[dict[str, tuple[int, float, float]]] = {
    "3.0": (29, 1.0, 2.0),
    "5.0": (49, 1.8, 3.6),
    "8.0": (79, 3.0, 6.0),
}
"""Seconds -> index in the 80 steps, and WOMD's miss thresholds across and along, metres."""
EARLY: Final[dict[str, int]] = {"1.0": 9, "2.0": 19}
"""Seconds at which the attack needs its best mode close; WOMD has no miss rule there."""
STEPS: Final[dict[str, int]] = EARLY | {key: step for key, (step, *_) in HORIZONS.items()}


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


def summary(errors: dict[int, DisplacementErrors], key: str) -> dict[str, object]:
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
