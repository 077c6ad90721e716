"""What a metric measures, and how its values are written down."""

from dataclasses import dataclass
from typing import Literal

from deepmf_sumo.datatypes import MetricValue

Better = Literal["lower", "higher", "neither"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A metric's name, unit, and which values are better for the attacker."""

    name: str
    unit: str
    better: Better

    def value(self, number: float) -> MetricValue:
        """A measured value."""
        return MetricValue(name=self.name, value=float(number), unit=self.unit, better=self.better)

    def missing(self, reason: str) -> MetricValue:
        """No value, and why."""
        return MetricValue(
            name=self.name, value=None, unit=self.unit, better=self.better, reason=reason
        )
