"""Vehicles that pass the places of a network without an attack, from ``flow.csv``."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results.result import Result
from deepmf_sumo.results.risk.places import Kind, Places


class Passing(NamedTuple):
    """Vehicles of some hours; ``near``: of these had another vehicle near enough to attack them."""

    vehicles: int
    near: int
    hours: float

    @property
    def per_hour(self) -> float | None:
        """None where the time was too short to say."""
        return self.vehicles / self.hours if self.hours else None

    @property
    def near_share(self) -> float:
        """How likely a vehicle that passes can be attacked."""
        return self.near / self.vehicles if self.vehicles else 0.0


Traffic = dict[tuple[Kind, str], Passing]
"""By kind and id of a place."""


def of_result(flows: Sequence[Mapping[str, str]], result: Result) -> list[Mapping[str, str]]:
    """The rows that belong to a run: of its spec, or in a plan of its network."""
    own = [row for row in flows if row["spec"] == result["spec"]]
    return own or [row for row in flows if row.get("network") == result["network"]]


def add(traffic: Traffic, rows: Iterable[Mapping[str, str]], places: Places) -> None:
    """Add the vehicles of rows to what is known. Raises UsageError for what is not a number."""
    known = {edge.id for edge in places.net.edges.values() if not edge.function}
    for row in rows:
        kind: Kind = "movement" if row["following"] else "edge"
        place = row["edge"]
        if row["following"]:
            movement = places.movement(row["edge"], row["following"])
            if movement is None:
                continue
            place = movement.id
        elif place not in known:
            continue
        try:
            new = Passing(int(row["vehicles"]), int(row["near"]), float(row["hours"]))
        except ValueError as error:
            raise UsageError(
                f"flow.csv is damaged ({error}); run it again, or remove it."
            ) from None
        before = traffic.get((kind, place), Passing(0, 0, 0.0))
        traffic[kind, place] = Passing(
            before.vehicles + new.vehicles, before.near + new.near, before.hours + new.hours
        )


def hours(traffic: Traffic) -> float:
    """The longest time that a flow is of: places without a vehicle are not in the tables."""
    return max((one.hours for one in traffic.values()), default=0.0)
