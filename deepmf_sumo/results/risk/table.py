"""Attacks on a network -> one row per place: how often, how severe, how certain."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any, Final, Literal

from deepmf_sumo.results import statistics
from deepmf_sumo.results.risk.attacks import Attacked, Network
from deepmf_sumo.results.risk.passing import Passing
from deepmf_sumo.results.risk.places import KINDS, SITES, Kind
from deepmf_sumo.results.statistics import Interval, PlaceMean, Units

SEVERE_MPS: Final = 5.0
CONFLICT_S: Final = 1.5
"""Times to collision below are conflicts (Gettman et al., FHWA-HRT-08-051, 2008)."""

Event = Literal["hit", "finding", "severe", "conflict"]
Counted = Literal["decided", "began"]
COUNTED: Final[tuple[Counted, ...]] = ("decided", "began")

_EVENTS: Final[Mapping[Event, tuple[Callable[[Attacked], bool], str]]] = {
    "hit": (lambda one: one.hit, "the opponent touched the AV"),
    "finding": (
        lambda one: one.finding,
        "a hit by an error of the AV, or by one of drivers which a reference driver avoids",
    ),
    "severe": (
        lambda one: one.hit and (one.delta_v_mps or 0.0) >= SEVERE_MPS,
        f"a hit that changed the AV's velocity by {SEVERE_MPS:g} m/s or more",
    ),
    "conflict": (
        lambda one: one.hit or (one.ttc_s is not None and one.ttc_s <= CONFLICT_S),
        f"a hit, or a time to collision of {CONFLICT_S:g} s or less",
    ),
}  # fmt: skip
EVENTS: Final[tuple[Event, ...]] = tuple(_EVENTS)


def happened(one: Attacked, event: Event) -> bool:
    """Whether an attack was such an event."""
    return _EVENTS[event][0](one)


DEFINITIONS: Final[Mapping[Event, str]] = {name: what for name, (_, what) in _EVENTS.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceRow:
    """A place, and the attacks that were decided there, or began there.

    Attributes:
        place: its id.
        title: a readable name of the place.
        events: how many of the attacks were such an event.
        judged: hits whose worth is known. others: attacks in which the AV touched
            another vehicle.
        ttc_s, gap_m: least of all attacks. delta_v_mps, delta_v_most_mps: mean and most of hits.
        hit_rate: of the attacks here alone. finding_share: of judged hits; None without any.
        risk: chance of such an event in an attack here, see `statistics.place_rates`; in rates an
            attack counts for the moments that it was drawn from, see `Attacked.weight`.
        rank: among the places of its kind, by the lower end of the risk; 1 is the worst.
        criticality: mean of the attacks here, see `quantities.criticality`; or None.
        rank_criticality: among the places of its kind, by how far its interval is above the
            typical place.
        passing: vehicles at a movement or an edge without an attack; None where that is not known.
    """

    kind: Kind
    place: str
    title: str
    counted: Counted
    attacks: int
    events: Mapping[Event, int]
    judged: int
    others: int
    ttc_s: float | None
    gap_m: float | None
    delta_v_mps: float | None
    delta_v_most_mps: float | None
    hit_rate: Interval
    finding_share: Interval | None
    risk: Mapping[Event, Interval]
    rank: Mapping[Event, int]
    criticality: PlaceMean | None
    rank_criticality: float | None
    passing: Passing | None = None

    @property
    def hits_per_1000(self) -> float | None:
        """Hits of 1000 passing vehicles, if each was attacked that had another one near.

        The share of these times the risk of a hit; of attacks that began here.
        """
        if self.passing is None or self.counted != "began":
            return None
        return 1000 * self.passing.near_share * self.risk["hit"].rate


def rows(network: Network) -> list[PlaceRow]:
    """All places where something was decided or began; by kind, the worst first.

    Where an attack counts twice, with what it began before and where it was decided, the rows say
    under ``counted`` which of the two they are.
    """
    table: list[PlaceRow] = []
    for counted in COUNTED:
        at = {kind: _by_place(network.attacks, kind, counted) for kind in KINDS}
        for kind in KINDS:
            # movements and edges are compared with each other, so they have one distribution
            alike = SITES if kind in SITES else (kind,)
            groups = {place: group for other in alike for place, group in at[other].items()}
            risks = {event: statistics.place_rates(_units(groups, event)) for event in EVENTS}
            means = statistics.place_means(
                {place: _criticality(group) for place, group in groups.items()}
            )
            table += _of_kind(network, kind, counted, at[kind], risks, means)
    return table


def worst(
    table: Iterable[PlaceRow], event: Event = "hit", counted: Counted = "decided"
) -> list[PlaceRow]:
    """Movements and edges in one list, the worst first: each attack was decided at one of them."""
    sites = [row for row in table if row.kind in SITES and row.counted == counted]
    return sorted(sites, key=lambda row: _order(row.risk[event], row.place))


def columns(row: PlaceRow) -> dict[str, Any]:
    """A row's numbers by name, None where there is none; rates with their 95 % intervals."""
    hit, share = row.hit_rate, row.finding_share or (None, None, None)
    risks = {
        f"{name}_{event}{end}": value
        for event in EVENTS
        for name, end, value in (
            ("risk", "", row.risk[event].rate),
            ("risk", "_lo", row.risk[event].low),
            ("risk", "_hi", row.risk[event].high),
            ("rank", "", row.rank[event]),
        )
    }
    return {
        "kind": row.kind,
        "place": row.place,
        "title": row.title,
        "counted": row.counted,
        "attacks": row.attacks,
        "hits": row.events["hit"],
        "hit_rate": hit.rate,
        "hit_rate_lo": hit.low,
        "hit_rate_hi": hit.high,
        "findings": row.events["finding"],
        "judged": row.judged,
        **dict(zip(("finding_share", "finding_share_lo", "finding_share_hi"), share, strict=True)),
        "severe": row.events["severe"],
        "conflicts": row.events["conflict"],
        "other_contacts": row.others,
        "min_ttc_s": row.ttc_s,
        "min_gap_m": row.gap_m,
        "delta_v_mps": row.delta_v_mps,
        "delta_v_most_mps": row.delta_v_most_mps,
        "criticality": row.criticality and row.criticality.shrunk,
        "criticality_lo": row.criticality and row.criticality.low,
        "criticality_hi": row.criticality and row.criticality.high,
        "rank_criticality": row.rank_criticality,
        "vehicles_per_hour": row.passing and row.passing.per_hour,
        "near_share": row.passing and row.passing.near_share,
        "hits_per_1000_vehicles": row.hits_per_1000,
        **risks,
    }


def _by_place(
    attacks: Iterable[Attacked], kind: Kind, counted: Counted
) -> dict[str, list[Attacked]]:
    """Attacks by place of a kind; those at none are left out."""
    groups: dict[str, list[Attacked]] = {}
    for one in attacks:
        place = (one.decided if counted == "decided" else one.began).of(kind)
        if place:
            groups.setdefault(place, []).append(one)
    return groups


def _criticality(group: Iterable[Attacked]) -> Units:
    measured = ((one.unit, one.criticality, one.weight) for one in group)
    return statistics.weighted(
        (unit, value, weight) for unit, value, weight in measured if value is not None
    )


def _units(groups: Mapping[str, Sequence[Attacked]], event: Event) -> dict[str, Units]:
    return {
        place: statistics.weighted(
            (one.unit, float(happened(one, event)), one.weight) for one in group
        )
        for place, group in groups.items()
    }


def rate(attacks: Iterable[Attacked], event: Event = "hit") -> Interval:
    """Of all attacks on a network: each counts for the moments that it was drawn from."""
    return statistics.rate_of(_units({"": list(attacks)}, event)[""])


def _happened(group: Sequence[Attacked], event: Event) -> int:
    return sum(_EVENTS[event][0](one) for one in group)


def _of_kind(
    network: Network,
    kind: Kind,
    counted: Counted,
    groups: Mapping[str, Sequence[Attacked]],
    rates: Mapping[Event, Mapping[str, Interval]],
    means: Mapping[str, PlaceMean],
) -> list[PlaceRow]:
    """Rows of one kind, the worst first."""
    risks = {place: {event: rates[event][place] for event in EVENTS} for place in groups}
    rank = {event: _ranks({name: one[event] for name, one in risks.items()}) for event in EVENTS}
    order = sorted(groups, key=lambda place: (rank["hit"][place], place))
    measured = [place for place in groups if means[place].attacks]
    critical = statistics.ranks({place: means[place].surely for place in measured})
    return [
        _row(
            groups[place],
            kind=kind,
            place=place,
            title=network.places.title(kind, place),
            counted=counted,
            risk=risks[place],
            rank={event: rank[event][place] for event in EVENTS},
            criticality=means[place] if means[place].attacks else None,
            rank_criticality=critical.get(place),
            passing=network.traffic.get((kind, place)),
        )
        for place in order
    ]


def _ranks(risks: Mapping[str, Interval]) -> dict[str, int]:
    """Equals have the same rank."""
    order = sorted(risks, key=lambda place: _order(risks[place], place))
    ranks: dict[str, int] = {}
    for number, place in enumerate(order, start=1):
        before = order[number - 2] if number > 1 else place
        equal = _order(risks[before], "") == _order(risks[place], "")
        ranks[place] = ranks.get(before, 1) if equal else number
    return ranks


def _order(risk: Interval, place: str) -> tuple[float, float, str]:
    """By the lower end of the risk, then by the rate, then by name."""
    return -round(risk.low, 9), -round(risk.rate, 9), place


def _row(group: Sequence[Attacked], **named: Any) -> PlaceRow:
    speeds = [one.delta_v_mps for one in group if one.hit and one.delta_v_mps is not None]
    found = statistics.weighted(
        (one.unit, float(one.finding), one.weight) for one in group if one.worth is not None
    )
    return PlaceRow(
        hit_rate=rate(group),
        finding_share=statistics.rate_of(found) if found.values else None,
        attacks=len(group),
        events={event: _happened(group, event) for event in EVENTS},
        judged=sum(one.worth is not None for one in group),
        others=sum(one.other for one in group),
        ttc_s=_least(one.ttc_s for one in group),
        gap_m=_least(one.gap_m for one in group),
        delta_v_mps=fmean(speeds) if speeds else None,
        delta_v_most_mps=max(speeds, default=None),
        **named,
    )


def _least(values: Iterable[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)
