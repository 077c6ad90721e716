"""Differences between two methods on the same scenes, with bootstrap intervals over scenes.

Scenes are drawn anew with replacement (Efron, 1979; percentiles), all seeds of a scene together:
attacks on one scene are not independent of each other.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any, Final

import numpy as np

from deepmf_sumo.benchmark.quantities import COLUMNS, Quantity, counted
from deepmf_sumo.benchmark.result import Result

RESAMPLES: Final = 10_000
CONFIDENCE: Final = 0.95
_SEED: Final = 20241217


def differences(
    methods: Mapping[str, Sequence[Result]], baseline: str, planner: str
) -> list[dict[str, Any]]:
    """A row a quantity and method: method minus baseline, over runs where both have a value.

    Args:
        methods: runs on one planner, by method.
        baseline: one of the methods.
        planner: label for the rows.
    """
    return [
        _difference(column, method, baseline, planner, methods)
        for column in COLUMNS
        if column.paired
        for method in methods
        if method != baseline
    ]


def _difference(
    column: Quantity,
    method: str,
    baseline: str,
    planner: str,
    methods: Mapping[str, Sequence[Result]],
) -> dict[str, Any]:
    ours, theirs = _values(column, methods[method]), _values(column, methods[baseline])
    both = [key for key in ours if key in theirs]
    by_scene: dict[str, list[float]] = defaultdict(list)
    for scene, seed in both:
        by_scene[scene].append(ours[scene, seed] - theirs[scene, seed])
    # from one scene nothing is known of how scenes differ
    low, high = interval(list(by_scene.values())) if len(by_scene) > 1 else (None, None)
    row = {
        "planner": planner,
        "quantity": column.name,
        "unit": column.unit,
        "method": method,
        "baseline": baseline,
        "pairs": len(both),
        "method_mean": fmean(ours[key] for key in both) if both else None,
        "baseline_mean": fmean(theirs[key] for key in both) if both else None,
        "difference": fmean(ours[key] - theirs[key] for key in both) if both else None,
        "difference_lo": low,
        "difference_hi": high,
    }
    row["method_only"] = row["baseline_only"] = None
    if column.rate:
        row["method_only"] = sum(ours[key] > theirs[key] for key in both)
        row["baseline_only"] = sum(ours[key] < theirs[key] for key in both)
    return row


def interval(by_scene: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Percentile interval of the mean difference; ``by_scene`` holds a scene's differences."""
    sums = np.array([sum(values) for values in by_scene])
    counts = np.array([len(values) for values in by_scene])
    drawn = np.random.default_rng(_SEED).integers(len(sums), size=(RESAMPLES, len(sums)))
    means = sums[drawn].sum(1) / counts[drawn].sum(1)
    tail = 100 * (1 - CONFIDENCE) / 2
    low, high = np.percentile(means, [tail, 100 - tail])
    return float(low), float(high)


def _values(column: Quantity, results: Sequence[Result]) -> dict[tuple[str, int], float]:
    return {
        (one["scene"], one["seed"]): value
        for one in results
        if counted(column, one) and (value := column.value(one)) is not None
    }
