"""Uncertainty of figures over many runs."""

from deepmf_sumo.metrics.statistics.wilson import Interval, wilson

__all__ = ["Interval", "wilson"]
