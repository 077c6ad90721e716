"""Vehicles and types that the files of a configuration name, read without a simulation."""

import difflib
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.sumo.network.sumo_net import elements
from deepmf_sumo.sumo.simulation.files_read import pieces, with_named
from deepmf_sumo.sumo.simulation.sumo_config import Configuration

_VEHICLES: Final = {"vehicle", "trip"}
_TYPES: Final = {"vType", "vTypeDistribution"}
_OPEN: Final = {"calibrator", "include"}
"""Elements that add vehicles whose names are not in the file."""
_NUMBER: Final = re.compile(r"\.\d+$")
"""SUMO numbers the vehicles of a flow, and the copies that its option ``scale`` makes."""
_MOST_COMPARED: Final = 20_000
"""Largest number of names among which a similar one is searched."""


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
        """Similar names of vehicles, else a few of them."""
        return _like(name, self.vehicles | {f"{flow}.0" for flow in self.flows})

    def like_type(self, name: str) -> list[str]:
        """Similar types, else a few of them."""
        return _like(name, self.types)


def read(configuration: Configuration) -> Demand | None:
    """The vehicles and types of the route files and the additional files.

    None if vehicles can come from elsewhere (a saved state, a calibrator, a file that includes
    another one), or if a file cannot be read, of which SUMO has a better message.
    """
    if configuration.more_demand:
        return None
    demand = Demand()
    try:
        known = [_add(demand, file) for file in (*configuration.routes, *configuration.additional)]
    except SimulationError:
        return None
    return demand if all(known) else None


def types_of(configuration: Configuration, name: str) -> tuple[str, ...]:
    """The types of a ``<vTypeDistribution>``, which SUMO draws by its seed; else the type itself.

    Of all files that SUMO reads, those included too.
    """
    found: dict[str, None] = {}
    for path in with_named([*configuration.routes, *configuration.additional]):
        if any(b"<vTypeDistribution" in piece for piece in pieces(path)):
            with suppress(SimulationError):  # SUMO says it better
                for one in _distributions(path, name):
                    found |= dict.fromkeys(one.get("vTypes", "").split())
                    found |= dict.fromkeys(each.get("id", "") for each in one.iter("vType"))
    return tuple(found) or (name,)


def _distributions(path: Path, name: str) -> Iterator[Element]:
    for element in elements(path, "additional"):
        yield from (one for one in element.iter("vTypeDistribution") if one.get("id") == name)


def _add(demand: Demand, file: Path) -> bool:
    """Add the names of a file; returns whether it adds no other vehicles."""
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
