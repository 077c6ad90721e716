"""Conflicts of plain traffic at the places of the network: what happens, beside what could happen.

Places, and kinds of conflicts, are those of the risk map.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo.errors import UsageError
from deepmf_sumo.judge.conflict_types import Course, conflict_type
from deepmf_sumo.judge.metrics.traffic_conflicts import SSAM_TYPES
from deepmf_sumo.results.risk import table
from deepmf_sumo.results.risk.attacks import Network, read
from deepmf_sumo.results.risk.places import Kind, Places
from deepmf_sumo.roadcheck.conflicts import Observation, Observed, Side
from deepmf_sumo.scene import RoadMap, agent_ids
from deepmf_sumo.sumo.network.sumo_net import going_first

BESIDE: Final = (
    "attacks", "hits", "hit_rate", "risk_hit", "risk_hit_lo", "risk_hit_hi", "rank_hit",
    "criticality", "criticality_lo", "criticality_hi", "rank_criticality",
)  # fmt: skip
"""Columns of the risk map that stand beside the conflicts."""
_SIDE: Final = ("{}", "{}_type", "{}_lane", "{}_speed_mps", "{}_delta_v_mps")
LISTED: Final = (
    "conflict", "begin_s", "end_s", "type", "kind", "contact", "ttc_s", "ttc_at_s", "pet_s",
    "max_s_mps", "delta_s_mps", "max_d_mps2", "max_delta_v_mps", "angle_deg", "x_m", "y_m",
    "place_kind", "place", "title", "junction", "gives_way",
    *(name.format(side) for side in ("first", "second") for name in _SIDE),
)  # fmt: skip
"""Columns of ``conflicts.csv``."""
_OF_PLACE: Final = (
    "kind", "place", "title", "conflicts", *(name.replace(" ", "_") for name in SSAM_TYPES),
    "contacts", "min_ttc_s", "min_pet_s", "max_delta_v_mps", "vehicles", "conflicts_per_hour",
    "conflicts_per_1000_vehicles",
)  # fmt: skip


def place_columns(*, beside: bool) -> tuple[str, ...]:
    """Columns of ``places.csv``, without or with attacks beside the conflicts."""
    return (*_OF_PLACE, *BESIDE) if beside else _OF_PLACE


def listed(seen: Observation, places: Places, road: RoadMap) -> list[dict[str, Any]]:
    """One row for each conflict, by time: the columns of ``conflicts.csv``.

    ``road``: the map of the same network.
    """
    first_at = going_first(places.net)
    return [
        {"conflict": number, **_row(one, places, road, first_at)}
        for number, one in enumerate(seen.conflicts, start=1)
    ]


def _row(
    one: Observed, places: Places, road: RoadMap, first_at: Mapping[str, tuple[str, ...]]
) -> dict[str, Any]:
    spots = places.spot(one.first.lane), places.spot(one.second.lane)
    kind, place, title = places.located(spots[0])
    courses = _course(one.first, road), _course(one.second, road)
    on_foot = any(agent_ids.person_of(side.id) is not None for side in (one.first, one.second))
    row: dict[str, Any] = {
        "begin_s": one.begin_s,
        "end_s": one.end_s,
        "type": one.type,
        "kind": conflict_type(*courses, road, on_foot=on_foot),
        "contact": one.ttc_s == 0.0,
        "ttc_s": one.ttc_s,
        "ttc_at_s": one.ttc_at_s,
        "pet_s": one.pet_s,
        "max_s_mps": one.max_s_mps,
        "delta_s_mps": one.delta_s_mps,
        "max_d_mps2": one.max_d_mps2,
        "max_delta_v_mps": max(one.first.delta_v_mps, one.second.delta_v_mps),
        "angle_deg": one.angle_deg,
        "x_m": one.place_m[0],
        "y_m": one.place_m[1],
        "place_kind": kind,
        "place": place,
        "title": title,
        "junction": spots[0].junction,
        "gives_way": _gives_way(one, first_at),
    }
    for name, side in (("first", one.first), ("second", one.second)):
        row |= {
            name: side.id,
            f"{name}_type": side.type,
            f"{name}_lane": side.lane,
            f"{name}_speed_mps": side.speed_mps,
            f"{name}_delta_v_mps": side.delta_v_mps,
        }
    return row


def _course(side: Side, road: RoadMap) -> Course:
    x, y, heading, length, width = side.pose
    lanes = side.lanes if side.lane in side.lanes else (*side.lanes, side.lane)
    return Course.on_lanes(road, lanes, np.array([x, y]), heading, np.array([length, width]))


def _gives_way(one: Observed, first_at: Mapping[str, tuple[str, ...]]) -> str:
    """Which of the two the network tells to give way; empty where it does not, or tells both."""
    waits = [
        any(not set(first_at.get(lane, ())).isdisjoint(other.lanes) for lane in side.lanes)
        for side, other in ((one.first, one.second), (one.second, one.first))
    ]
    if waits[0] == waits[1]:
        return ""
    return "first" if waits[0] else "second"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceConflicts:
    """The conflicts at a place.

    Attributes:
        types: number of each of SSAM's types. contacts: conflicts in which the boxes overlapped.
        vehicles: road users that were there. hours: that were looked at.
        beside: columns of the risk map; empty where no attack was decided there, None without one.
    """

    kind: Kind
    place: str
    title: str
    types: Mapping[str, int]
    contacts: int
    ttc_s: float | None
    pet_s: float | None
    delta_v_mps: float | None
    vehicles: int
    hours: float
    beside: Mapping[str, Any] | None = None

    @property
    def conflicts(self) -> int:
        """Of all types."""
        return sum(self.types.values())

    @property
    def per_hour(self) -> float:
        """Conflicts per hour."""
        return self.conflicts / self.hours

    @property
    def per_1000(self) -> float | None:
        """Conflicts per 1000 road users at the place; None where there were none."""
        return 1000 * self.conflicts / self.vehicles if self.vehicles else None

    def columns(self) -> dict[str, Any]:
        """By name, as in ``places.csv``."""
        values: dict[str, Any] = {
            "kind": self.kind,
            "place": self.place,
            "title": self.title,
            "conflicts": self.conflicts,
            **{name.replace(" ", "_"): count for name, count in self.types.items()},
            "contacts": self.contacts,
            "min_ttc_s": self.ttc_s,
            "min_pet_s": self.pet_s,
            "max_delta_v_mps": self.delta_v_mps,
            "vehicles": self.vehicles,
            "conflicts_per_hour": self.per_hour,
            "conflicts_per_1000_vehicles": self.per_1000,
        }
        if self.beside is not None:
            values |= {name: self.beside.get(name) for name in BESIDE}
            values["attacks"] = self.beside.get("attacks", 0)
            values["hits"] = self.beside.get("hits", 0)
        return values


def by_place(
    seen: Observation,
    rows: Sequence[Mapping[str, Any]],
    places: Places,
    attacked: Network | None = None,
) -> list[PlaceConflicts]:
    """The places with a conflict, or an attack; those with most conflicts per hour first.

    Args:
        seen: the traffic.
        rows: of `listed`.
        places: of its network.
        attacked: the same network's attacks, see `beside`.
    """
    groups: dict[tuple[Kind, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["place_kind"], row["place"]), []).append(row)
    risk: dict[tuple[Kind, str], Mapping[str, Any]] | None = None
    if attacked is not None:
        risk = {(row.kind, row.place): table.columns(row) for row in table.worst(
            table.rows(attacked)
        )}  # fmt: skip
        groups |= {key: [] for key in risk if key not in groups}
    there = _vehicles(seen, places)
    hours = (seen.until_s - seen.begin_s) / 3600
    found = [
        _place(key, group, places, len(there.get(key, ())), hours,
               None if risk is None else risk.get(key, {}))
        for key, group in groups.items()
    ]  # fmt: skip
    return sorted(found, key=_worst_first)


def _worst_first(one: PlaceConflicts) -> tuple[float, float, float, str]:
    risky = (one.beside or {}).get("risk_hit_lo") or 0.0
    return -one.conflicts, one.ttc_s if one.ttc_s is not None else np.inf, -risky, one.title


def _place(
    key: tuple[Kind, str],
    group: Sequence[Mapping[str, Any]],
    places: Places,
    vehicles: int,
    hours: float,
    beside: Mapping[str, Any] | None,
) -> PlaceConflicts:
    return PlaceConflicts(
        kind=key[0],
        place=key[1],
        title=places.title(*key),
        types={name: sum(row["type"] == name for row in group) for name in SSAM_TYPES},
        contacts=sum(row["contact"] for row in group),
        ttc_s=min((row["ttc_s"] for row in group), default=None),
        pet_s=min((row["pet_s"] for row in group), default=None),
        delta_v_mps=max((row["max_delta_v_mps"] for row in group), default=None),
        vehicles=vehicles,
        hours=hours,
        beside=beside,
    )


def _vehicles(seen: Observation, places: Places) -> dict[tuple[Kind, str], set[int]]:
    """The road users that were at each place; at a junction, also the users of its movements."""
    found: dict[tuple[Kind, str], set[int]] = {}
    for lane, users in seen.driven.items():
        spot = places.spot(lane)
        kind, place, _ = places.located(spot)
        found.setdefault((kind, place), set()).update(users)
        if spot.junction and kind != "junction":
            found.setdefault(("junction", spot.junction), set()).update(users)
    return found


def beside(folder: Path, places: Places) -> Network:
    """The attacks of a result folder on the network with these places.

    Raises UsageError where there are none.
    """
    networks = read([folder])
    same = [one for one in networks if _ids(one.places) == _ids(places)]
    if not same:
        names = ", ".join(one.name for one in networks)
        raise UsageError(
            f"--beside {folder}: its attacks are on another network ({names}); give results of"
            " `deepmf-sumo attack` with this configuration."
        )
    if len(same) > 1:
        raise UsageError(
            f"--beside {folder}: it holds {len(same)} networks with these edges; give one result"
            " folder."
        )
    return same[0]


def _ids(places: Places) -> tuple[set[str], set[str]]:
    return set(places.movements), set(places.net.edges)


def counts(rows: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """Conflicts by SSAM's type, all of them named."""
    chosen = [row["type"] for row in rows]
    return {name: chosen.count(name) for name in SSAM_TYPES}
