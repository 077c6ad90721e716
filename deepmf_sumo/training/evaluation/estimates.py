"""Means with standard errors, rounded for tables."""

from collections.abc import Sequence

import numpy as np


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
