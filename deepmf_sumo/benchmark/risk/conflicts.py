"""Which ways conflict: attacks by where the AV and its opponent were when they were decided."""

from collections.abc import Iterable
from dataclasses import dataclass

from deepmf_sumo.benchmark.risk.attacks import Attacked, Network


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """Attacks on an AV at one movement or edge by an opponent at another, or at the same.

    Attributes:
        place, against: titles of the AV's and the opponent's; empty off the lanes.
        avoidable: of the hits that were ``judged``.
    """

    place: str
    against: str
    attacks: int
    hits: int
    avoidable: int
    judged: int


def conflicts(network: Network) -> list[Conflict]:
    """All pairs of places, those with most hits first."""
    groups: dict[tuple[str, str], list[Attacked]] = {}
    for one in network.attacks:
        ends = network.places.site(one.decided), network.places.site(one.against)
        groups.setdefault(ends, []).append(one)
    found = [_conflict(*ends, group) for ends, group in groups.items()]
    return sorted(found, key=lambda one: (-one.hits, -one.attacks, one.place, one.against))


def _conflict(place: str, against: str, group: Iterable[Attacked]) -> Conflict:
    attacks = list(group)
    return Conflict(
        place=place,
        against=against,
        attacks=len(attacks),
        hits=sum(one.hit for one in attacks),
        avoidable=sum(bool(one.avoidable) for one in attacks),
        judged=sum(one.avoidable is not None for one in attacks),
    )
