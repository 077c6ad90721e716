"""What the attacks on a network were, and what was never attacked: kinds, movements, speeds."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from statistics import fmean, median
from typing import Final, Literal

from deepmf_sumo.judge.conflict_types import DEFINITIONS, TYPES
from deepmf_sumo.risk.attacks import Attacked, Network
from deepmf_sumo.risk.passing import Passing, hours
from deepmf_sumo.risk.places import SITES
from deepmf_sumo.risk.table import happened

_KMH: Final = 3.6
_SPEEDS_KMH: Final = (0.0, 10.0, 30.0, 50.0, 70.0, 100.0, inf)
"""Bounds of the classes of the AV's speed."""
NO_CONFLICT: Final = "no conflict"
MEANINGS: Final = {str(kind): meaning for kind, meaning in DEFINITIONS.items()} | {
    NO_CONFLICT: "no hit, and no time to collision of 1.5 s or less"
}
"""By kind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TypeRow:
    """Attacks that were conflicts of one kind.

    Attributes:
        kind: `NO_CONFLICT` for attacks without one.
        judged: hits whose worth is known.
        least_ttc_s, median_ttc_s: least and median of the attacks' least times; None without any.
        delta_v_mps, delta_v_most_mps: mean and most of hits.
    """

    kind: str
    attacks: int
    hits: int
    findings: int
    judged: int
    least_ttc_s: float | None
    median_ttc_s: float | None
    least_pet_s: float | None
    median_pet_s: float | None
    delta_v_mps: float | None
    delta_v_most_mps: float | None


def by_type(attacks: Iterable[Attacked]) -> list[TypeRow]:
    """A row for each kind of conflict, those without an attack too, and one for all others.

    An attack is a conflict if it hit, or came within a time to collision of 1.5 s.
    """
    groups: dict[str, list[Attacked]] = {kind: [] for kind in (*TYPES, NO_CONFLICT)}
    for one in attacks:
        groups[_kind(one)].append(one)
    return [_type_row(kind, group) for kind, group in groups.items()]


def _kind(one: Attacked) -> str:
    return one.kind if one.kind and happened(one, "conflict") else NO_CONFLICT


def _type_row(kind: str, group: Sequence[Attacked]) -> TypeRow:
    ttc = [one.ttc_s for one in group if one.ttc_s is not None]
    pet = [one.pet_s for one in group if one.pet_s is not None]
    speeds = [one.delta_v_mps for one in group if one.hit and one.delta_v_mps is not None]
    return TypeRow(
        kind=kind,
        attacks=len(group),
        hits=sum(one.hit for one in group),
        findings=sum(one.finding for one in group),
        judged=sum(one.worth is not None for one in group),
        least_ttc_s=min(ttc, default=None),
        median_ttc_s=median(ttc) if ttc else None,
        least_pet_s=min(pet, default=None),
        median_pet_s=median(pet) if pet else None,
        delta_v_mps=fmean(speeds) if speeds else None,
        delta_v_most_mps=max(speeds, default=None),
    )


Of = Literal["movement", "edge", "turn", "right of way", "conflict", "speed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Covered:
    """How often something was attacked; 0 where it never was.

    Attributes:
        name: its id, or a word. title: a readable name.
        attacks: of movements and edges those that began there.
        vehicles_per_hour: that pass it without an attack; None where that is not known.
    """

    of: Of
    name: str
    title: str
    attacks: int
    hits: int
    vehicles_per_hour: float | None = None


def coverage(network: Network) -> list[Covered]:
    """What was attacked how often: movements, edges, turns, rights of way, conflicts, speeds.

    All movements and edges of the network that vehicles may use are there, with their flows.
    """
    return [_with_flow(network, one) for one in _rows(network)]


def _with_flow(network: Network, one: Covered) -> Covered:
    if one.of not in SITES or not network.traffic:
        return one
    passing = network.traffic.get((one.of, one.name), Passing(0, 0, hours(network.traffic)))
    return replace(one, vehicles_per_hour=passing.per_hour)


def _rows(network: Network) -> Iterator[Covered]:
    places, attacks = network.places, network.attacks
    of_movement = {name: places.title("movement", name) for name in places.movements}
    yield from _counted("movement", of_movement, [(a.began.movement, a.hit) for a in attacks])
    normal = [edge.id for edge in places.net.edges.values() if not edge.function]
    of_edge = {name: places.title("edge", name) for name in normal}
    yield from _counted("edge", of_edge, [(a.began.edge, a.hit) for a in attacks])
    ahead = [(places.movements.get(one.began.movement), one.hit) for one in attacks]
    turns = {one.turn: one.turn for one in places.movements.values() if one.turn}
    rules = {one.rule: one.rule for one in places.movements.values() if one.rule}
    yield from _counted("turn", turns, [(one.turn if one else "", hit) for one, hit in ahead])
    yield from _counted(
        "right of way", rules, [(one.rule if one else "", hit) for one, hit in ahead]
    )
    kinds = {kind: kind for kind in (*TYPES, NO_CONFLICT)}
    yield from _counted("conflict", kinds, [(_kind(one), one.hit) for one in attacks])
    speeds = {_speed(low / _KMH): _speed(low / _KMH) for low in _SPEEDS_KMH[:-1]}
    yield from _counted("speed", speeds, [(_speed(one.speed_mps), one.hit) for one in attacks])


def _speed(speed_mps: float) -> str:
    """The class of a speed, e.g. ``30 to 50 km/h``."""
    for low, high in pairwise(_SPEEDS_KMH):
        if speed_mps * _KMH < high - 1e-9:
            return f"{low:g} km/h and more" if high == inf else f"{low:g} to {high:g} km/h"
    raise ValueError(f"a speed of {speed_mps} m/s")


def _counted(
    of: Of, titles: dict[str, str], attacks: Sequence[tuple[str, bool]]
) -> Iterator[Covered]:
    times, hits = (
        Counter(name for name, _ in attacks),
        Counter(name for name, hit in attacks if hit),
    )
    for name, title in titles.items():
        yield Covered(of=of, name=name, title=title, attacks=times[name], hits=hits[name])
