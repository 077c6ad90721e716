"""Figures over many runs: uncertainty of rates, pooled naturalness, diversity."""

from deepmf_sumo.metrics.statistics.pooled import Pooled, pooled
from deepmf_sumo.metrics.statistics.wilson import Interval, wilson

__all__ = ["Interval", "Pooled", "pooled", "wilson"]
