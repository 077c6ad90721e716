"""Measures of predictions, as WOMD and the opponent literature define them."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats
from deepmf_sumo.predictors.selection import speed_factor

HORIZONS: Final[dict[str, tuple[int, float, float]]] = {
    "3.0": (29, 1.0, 2.0),
    "5.0": (49, 1.8, 3.6),
    "8.0": (79, 3.0, 6.0),
}
"""Seconds -> index in the 80 steps, and WOMD's miss thresholds across and along, metres."""


@dataclass(slots=True)
class DisplacementErrors:
    """Errors of M modes against what happened, summed over agents; at 2 Hz up to each horizon."""

    ade: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in HORIZONS})
    fde: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in HORIZONS})
    missed: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in HORIZONS})

    def add(
        self,
        modes_m: Floats,
        true_m: Floats,
        true_heading_rad: Floats,
        valid: Bools,
        speed_mps: float,
    ) -> None:
        """One agent: modes (M, 80, 2), what happened (80, 2), (80), (80), start speed."""
        error = np.linalg.norm(modes_m - true_m, axis=-1)  # (M, 80)
        for key, (step, across_m, along_m) in HORIZONS.items():
            seen = np.arange(4, step + 1, 5)
            seen = seen[valid[seen]]
            if len(seen):
                self.ade[key].append(float(error[:, seen].mean(1).min()))
            if not valid[step]:
                continue
            self.fde[key].append(float(error[:, step].min()))
            off = modes_m[:, step] - true_m[step]
            cos, sin = np.cos(true_heading_rad[step]), np.sin(true_heading_rad[step])
            factor = speed_factor(speed_mps)
            along = np.abs(off[:, 0] * cos + off[:, 1] * sin) <= along_m * factor
            across = np.abs(off[:, 1] * cos - off[:, 0] * sin) <= across_m * factor
            self.missed[key].append(float(not (along & across).any()))


def auroc(scores: Floats, labels: Bools) -> float | None:
    """Area under the ROC curve; ties count half. None without both kinds."""
    positive, negative = int(labels.sum()), int((~labels).sum())
    if not positive or not negative:
        return None
    values, inverse, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse]
    assert len(values) == len(counts)
    return float((ranks[labels].sum() - positive * (positive + 1) / 2) / (positive * negative))


def average_precision(scores: Floats, labels: Bools) -> float | None:
    """Area under the precision-recall curve (step-wise). None without positives."""
    if not labels.any():
        return None
    order = np.argsort(-scores, kind="stable")
    hits = labels[order]
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    return float(precision[hits].mean())


def mean(values: list[float], digits: int = 3) -> float | None:
    """Rounded mean; None of nothing."""
    return round(float(np.mean(values)), digits) if values else None
