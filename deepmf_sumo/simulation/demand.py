"""Vehicles and types that a configuration's files name, read without a simulation."""

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.network.sumo_net import elements
from deepmf_sumo.simulation.sumo_config import Configuration

_VEHICLES: Final = {"vehicle", "trip"}
_TYPES: Final = {"vType", "vTypeDistribution"}
_OPEN: Final = {"calibrator", "include"}
"""Elements that bring vehicles whose names are not in the file."""
_NUMBER: Final = re.compile(r"\.\d+$")
"""SUMO numbers the vehicles of a flow, and the copies that its option ``scale`` makes."""
_MOST_COMPARED: Final = 20_000
"""Names that are looked through for a similar one."""


@dataclass(slots=True)
class Demand:
    """Names of vehicles, flows and types."""

    vehicles: set[str] = field(default_factory=set)
    flows: set[str] = field(default_factory=set)
    types: set[str] = field(default_factory=set)

    def has_vehicle(self, name: str) -> bool:
        """Whether a vehicle may have this name."""
        while name not in self.vehicles and name not in self.flows:
            shorter = _NUMBER.sub("", name)
            if shorter == name:
                return False
            name = shorter
        return True

    def has_type(self, name: str) -> bool:
        """Whether a vehicle may be of this type; SUMO has types of its own, ``DEFAULT_...``."""
        return name in self.types or name.startswith("DEFAULT_")

    def like_vehicle(self, name: str) -> list[str]:
        """Names of vehicles that are similar, else a few of them."""
        return _like(name, self.vehicles | {f"{flow}.0" for flow in self.flows})

    def like_type(self, name: str) -> list[str]:
        """Types that are similar, else a few of them."""
        return _like(name, self.types)


def read(configuration: Configuration) -> Demand | None:
    """What the route files and the additional files name.

    None where vehicles can come from elsewhere (a saved state, a calibrator, a file that includes
    another one), or where a file cannot be read, which SUMO says better.
    """
    if configuration.more_demand:
        return None
    demand = Demand()
    try:
        known = [_add(demand, file) for file in (*configuration.routes, *configuration.additional)]
    except SimulationError:
        return None
    return demand if all(known) else None


def _add(demand: Demand, file: Path) -> bool:
    """Add what a file names; whether that is all that it brings."""
    for element in elements(file, "additional"):
        for one in element.iter():
            name = one.get("id", "")
            if one.tag in _OPEN:
                return False
            if one.tag in _VEHICLES:
                demand.vehicles.add(name)
            elif one.tag == "flow":
                demand.flows.add(name)
            elif one.tag in _TYPES:
                demand.types.update((name, *one.get("vTypes", "").split()))
    return True


def _like(name: str, known: set[str]) -> list[str]:
    names = sorted(known)
    return difflib.get_close_matches(name, names[:_MOST_COMPARED], n=3, cutoff=0.4) or names[:3]


__all__ = ["Demand", "read"]
