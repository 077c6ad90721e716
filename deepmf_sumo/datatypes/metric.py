"""A measured number, or the reason why there is none."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricValue:
    """``value`` is None, with a ``reason``, where the metric is not defined for the rollout."""

    name: str
    value: float | None
    unit: str
    better: Literal["lower", "higher", "neither"]
    reason: str = ""
