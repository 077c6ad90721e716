"""What was attacked on a network, and what never was: four tables of evidence, and the places.

The tables say in which environment the AV was attacked, in which manoeuvre, in which kind of
conflict, and which rules of the road were at stake. An attack counts in each cell that it belongs
to, from its begin to its contact or end, so that cells do not add up; there is no total, and no
share of cells. A cell without an attack says why.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import Final, Literal, NamedTuple

from deepmf_sumo.judge.conflict_types import DEFINITIONS
from deepmf_sumo.results.risk import elements
from deepmf_sumo.results.risk.attacks import Attacked, Network
from deepmf_sumo.results.risk.driving import MANOEUVRE_OF, MANOEUVRES, NEAR_M, merging
from deepmf_sumo.results.risk.elements import KMH, Element, Site
from deepmf_sumo.results.risk.passing import hours
from deepmf_sumo.results.risk.places import SITES, Kind, Places
from deepmf_sumo.results.risk.table import happened, rate
from deepmf_sumo.results.statistics import Interval

EvidenceTable = Literal["environment", "manoeuvre", "conflict", "rule", "place"]
TABLES: Final[Mapping[EvidenceTable, str]] = {
    "environment": "Environment, where the AV was while it was attacked",
    "manoeuvre": "What the AV did while it was attacked",
    "conflict": "Kind of conflict that it was, or would have been",
    "rule": "Rules of the road that were at stake",
}
"""Titles of the four tables of evidence."""
_NEVER: Final = (
    ("weather", "rain, snow, fog"), ("light", "dusk, night, glare"),
    ("road surface", "wet, icy, damaged"),
)  # fmt: skip
"""What SUMO has not."""
_DENSITY: Final = ((3, "up to 2"), (6, "3 to 5"), (11, "6 to 10"), (inf, "more than 10"))
_SPEEDS_KMH: Final = (0.0, 10.0, 30.0, 50.0, 70.0, 100.0, inf)
"""Bounds of the classes of the AV's speed."""
_RULES: Final[Mapping[str, tuple[str, frozenset[str]]]] = {
    "give way": (
        "signs, or the side that it comes from, tell the AV to give way",
        frozenset({"give way", "right before left", "left before right"}),
    ),
    "priority of the AV": ("others have to give way to it", frozenset({"priority"})),
    "stop": ("it has to stop before it goes on", frozenset({"stop", "all-way stop"})),
    "traffic light": (
        "lights tell it when to go",
        frozenset({"protected", "permissive", "protected and permissive", "signal"}),
    ),
    "give way at green": (
        "it has to let others pass at a green light, e.g. to turn",
        frozenset({"permissive", "protected and permissive"}),
    ),
    "take turns": ("vehicles of two lanes take turns (zipper)", frozenset({"zipper merge"})),
}
"""Rules of the movement: what they are, and `Movement.rule` that asks for them."""
_LIMIT, _DISTANCE, _CHANGE = "speed limit", "keep distance", "change lanes"
_LANE, _PEOPLE = "keep to the lane", "let people cross"
_DRIVEN_RULES: Final = {
    _LIMIT: "it drove with 90 % of the limit, or more",
    _DISTANCE: "it followed another vehicle",
    _CHANGE: "it changed lanes",
    _LANE: "it met a vehicle beside it, or in the opposite direction",
    _PEOPLE: "a person attacked it",
}


_MADE: Final = "made attacker"
_MADE_MEANS: Final = "it is not in the demand: it was put where it could be"


class Subject(NamedTuple):
    """What a cell is about, in one of the tables."""

    table: EvidenceTable
    subject: str
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class EvidenceCell:
    """What is known of attacks of one sort.

    Attributes:
        title: its meaning; of a place its readable name.
        conflicts: hits and near misses, see `table.DEFINITIONS`.
        causes: different ones of the findings, as far as they are known.
        conflict_rate, hit_rate, finding_rate: of the attacks, 95 %; None without any.
        sites: movements and edges of the network that have it; None where it is of no place.
        vehicles_per_hour: that pass them without an attack; None where that is not known.
        reason: why there is no attack; else empty.
    """

    table: EvidenceTable
    subject: str
    name: str
    title: str
    attacks: int
    conflicts: int
    hits: int
    findings: int
    causes: int
    conflict_rate: Interval | None = None
    hit_rate: Interval | None = None
    finding_rate: Interval | None = None
    sites: int | None = None
    vehicles_per_hour: float | None = None
    reason: str = ""


class _Entry(NamedTuple):
    """A cell to be filled: where the network has it, or None; why there is none at all."""

    key: Subject
    title: str
    sites: frozenset[Site] | None
    never: str = ""


def coverage(network: Network) -> list[EvidenceCell]:
    """All cells of the four tables; then all movements and edges of road vehicles."""
    groups: dict[Subject, list[Attacked]] = defaultdict(list)
    for one in network.attacks:
        for key in _of(one):
            groups[key].append(one)
    entries = _entries(network.places)
    made = [_Entry(key, _MADE_MEANS, None) for key in sorted(groups) if key.subject == _MADE]
    return [_cell(network, entry, groups[entry.key]) for entry in (*entries, *made)]


def _of(one: Attacked) -> Iterator[Subject]:
    """The cells that an attack belongs to."""
    for element in one.driven.elements:
        yield Subject("environment", *element)
    density = next(name for below, name in _DENSITY if one.driven.near < below)
    yield Subject("environment", _AROUND, density)
    for manoeuvre in one.driven.manoeuvres:
        yield Subject("manoeuvre", "manoeuvre", manoeuvre)
    yield Subject("manoeuvre", _SPEED, _speed(one.speed_mps))
    if one.kind:
        yield Subject("conflict", "kind of conflict", one.kind)
    if one.made:
        yield Subject("conflict", _MADE, f"made {one.opponent_kind}")
    for rule in _at_stake(one):
        yield Subject("rule", "rule", rule)
    yield Subject("place", "movement", one.began.movement)
    yield Subject("place", "edge", one.began.edge)


_AROUND: Final = f"road users within {NEAR_M:g} m at the start"
_SPEED: Final = "speed at the start"


def _at_stake(one: Attacked) -> Iterator[str]:
    yield from (name for name, (_, asks) in _RULES.items() if one.driven.rules & asks)
    if one.driven.at_limit:
        yield _LIMIT
    if "follows" in one.driven.manoeuvres:
        yield _DISTANCE
    if "lane change" in one.driven.manoeuvres:
        yield _CHANGE
    if one.kind in {"head-on", "lane change"}:
        yield _LANE
    if one.opponent_kind == "pedestrian":
        yield _PEOPLE


def _speed(speed_mps: float) -> str:
    """The class of a speed, e.g. ``30 to 50 km/h``."""
    return next(name for high, name in _SPEED_NAMES if speed_mps * KMH < high - 1e-9)


_SPEED_NAMES: Final = tuple(
    (high, f"{low:g} km/h and more" if high == inf else f"{low:g} to {high:g} km/h")
    for low, high in pairwise(_SPEEDS_KMH)
)


def _entries(places: Places) -> Iterator[_Entry]:
    """All cells, in the order of the tables."""
    for element, sites in elements.everywhere(places).items():
        yield _Entry(Subject("environment", *element), "", sites)
    for _, name in _DENSITY:
        yield _Entry(Subject("environment", _AROUND, name), "", None)
    for subject, name in _NEVER:
        yield _Entry(Subject("environment", subject, name), "", None, "never: SUMO has none")
    found = _Where.of(places)
    for manoeuvre, meaning in MANOEUVRES.items():
        key = Subject("manoeuvre", "manoeuvre", manoeuvre)
        yield _Entry(key, meaning, found.manoeuvres.get(manoeuvre))
    for _, name in _SPEED_NAMES:
        yield _Entry(Subject("manoeuvre", _SPEED, name), "", None)
    for kind, meaning in DEFINITIONS.items():
        key = Subject("conflict", "kind of conflict", kind)
        yield _Entry(key, meaning, found.conflicts.get(kind))
    for rule, meaning in _meanings().items():
        yield _Entry(Subject("rule", "rule", rule), meaning, found.rules.get(rule))
    yield from _places(places)


def _meanings() -> dict[str, str]:
    return {name: meaning for name, (meaning, _) in _RULES.items()} | _DRIVEN_RULES


def _places(places: Places) -> Iterator[_Entry]:
    for kind in SITES:
        for name in places.driven[kind]:
            yield _place(kind, name, places)


def _place(kind: Kind, name: str, places: Places) -> _Entry:
    return _Entry(Subject("place", kind, name), places.title(kind, name), frozenset({(kind, name)}))


class _Where(NamedTuple):
    """Where the network has what manoeuvres, kinds of conflict and rules need; else anywhere."""

    manoeuvres: Mapping[str, frozenset[Site]]
    conflicts: Mapping[str, frozenset[Site]]
    rules: Mapping[str, frozenset[Site]]

    @classmethod
    def of(cls, places: Places) -> "_Where":
        """In a network."""
        found = elements.everywhere(places)
        several = _with(found, "2 lanes", "3 lanes and more")
        by_turn: dict[str, set[Site]] = defaultdict(set)
        by_rule: dict[str, set[Site]] = defaultdict(set)
        over = elements.over_junctions(places)
        for one in (places.movements[name] for name in places.movements if name in over):
            by_turn[one.turn].add(("movement", one.id))
            for rule in one.rule.split(" / "):
                by_rule[rule].add(("movement", one.id))
        turns = {str(name): frozenset(by_turn[turn]) for turn, name in MANOEUVRE_OF.items()}
        return cls(
            manoeuvres={
                **turns,
                "merge": frozenset(("movement", name) for name in merging(places)),
                "along a road": _with(found, elements.BETWEEN),
                "lane change": several,
            },
            conflicts={
                "left turn across path": turns["left turn"],
                "right turn across path": turns["right turn"],
                "crossing": frozenset(("movement", name) for name in over),
                "lane change": several,
            },
            rules={
                **{
                    name: frozenset().union(*(by_rule[rule] for rule in asks))
                    for name, (_, asks) in _RULES.items()
                },
                _CHANGE: several,
                _PEOPLE: _with(found, elements.CROSSINGS),
            },
        )


def _with(found: Mapping[Element, frozenset[Site]], *names: str) -> frozenset[Site]:
    """Where any of these elements is."""
    return frozenset(site for one, sites in found.items() if one.name in names for site in sites)


def _cell(network: Network, entry: _Entry, attacks: Sequence[Attacked]) -> EvidenceCell:
    hits = [one for one in attacks if one.hit]
    judged = [one for one in attacks if one.worth is not None or not one.hit]
    return EvidenceCell(
        **entry.key._asdict(),
        title=entry.title,
        attacks=len(attacks),
        conflicts=sum(happened(one, "conflict") for one in attacks),
        hits=len(hits),
        findings=sum(one.finding for one in hits),
        causes=len({one.cause for one in hits if one.cause}),
        conflict_rate=rate(attacks, "conflict") if attacks else None,
        hit_rate=rate(attacks, "hit") if attacks else None,
        finding_rate=rate(judged, "finding") if judged else None,
        sites=None if entry.sites is None else len(entry.sites),
        vehicles_per_hour=_per_hour(network, entry.sites),
        reason="" if attacks else entry.never or _reason(network, entry.sites),
    )


def _per_hour(network: Network, sites: frozenset[Site] | None) -> float | None:
    """Of vehicles at sites of one kind; of several kinds some would count twice."""
    if not sites or not network.traffic or len({kind for kind, _ in sites}) > 1:
        return None
    time = hours(network.traffic)
    passed = sum(network.traffic[site].vehicles for site in sites if site in network.traffic)
    return passed / time if time else None


def _reason(network: Network, sites: frozenset[Site] | None) -> str:
    """Why nothing was attacked."""
    if sites is not None and not sites:
        return "no such place in the network"
    passing = [network.traffic[site] for site in sites or () if site in network.traffic]
    if sites and network.traffic:
        if not any(one.vehicles for one in passing):
            return "no traffic there while moments were chosen"
        if not any(one.near for one in passing):
            return "no vehicle there had another one near it"
    count = len(network.attacks)
    return f"not reached in {count} attack{'s' * (count != 1)}"
