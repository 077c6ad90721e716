"""One row per attack, in the words of a conflict study: ``attacks.csv`` of a risk map.

What conflicts of plain traffic have too (`roadcheck.conflict_places`) has the same name here. An
attack has roles, so that its two road users are ``av`` and ``opponent`` and not first and second.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.results.risk.attacks import Attacked, Network
from deepmf_sumo.results.risk.places import Places, Spot
from deepmf_sumo.sumo.network.sumo_net import going_first

ATTACKED: Final = (
    "attack", "folder", "run_id", "turn", "scene", "seed", "kind", "contact", "other_contact",
    "finding", "rung", "ttc_s", "pet_s", "gap_m", "delta_v_mps", "criticality", "x_m", "y_m",
    "place_kind", "place", "title", "junction", "gives_way", "av", "av_lane", "av_speed_mps",
    "opponent", "opponent_lane", "opponent_title", "began_title",
)  # fmt: skip
"""Columns of ``attacks.csv``."""
_DECIMALS: Final = 4


def attack_rows(network: Network) -> list[dict[str, Any]]:
    """The attacks in the order of their runs; None where something is not known."""
    first_at = going_first(network.places.net)
    return [
        dict(
            zip(
                ATTACKED,
                (number, *map(_rounded, _values(one, network.places, first_at))),
                strict=True,
            )
        )
        for number, one in enumerate(network.attacks, start=1)
    ]


def _rounded(value: Any) -> Any:
    """Coordinates far from the origin keep their decimals, which six digits would not hold."""
    return round(value, _DECIMALS) if isinstance(value, float) else value


def _values(
    one: Attacked, places: Places, first_at: Mapping[str, tuple[str, ...]]
) -> tuple[Any, ...]:
    """The columns after ``attack``."""
    at = one.decided
    where = places.located(at) if at.movement or at.edge or at.junction else ("", "", "")
    return (
        Path(one.folder).resolve().name, one.run_id, one.turn, one.scene, one.seed, one.kind,
        one.hit, one.other, one.finding if one.worth else None,
        one.worth.rung if one.worth else None, one.ttc_s, one.pet_s, one.gap_m, one.delta_v_mps,
        one.criticality,
        *one.place_m, *where, at.junction, _gives_way(one, places, first_at),
        one.av, at.lane, one.speed_mps, one.opponent, one.against.lane,
        places.site(one.against), places.site(one.began),
    )  # fmt: skip


def _gives_way(one: Attacked, places: Places, first_at: Mapping[str, tuple[str, ...]]) -> str:
    """Which of the two the network tells to give way; empty where it does not, or tells both."""
    av, opponent = _lanes(one.decided, places), _lanes(one.against, places)
    waits = [
        any(not first.isdisjoint(first_at.get(lane, ())) for lane in mine)
        for mine, first in ((av, opponent), (opponent, av))
    ]
    if waits[0] == waits[1]:
        return ""
    return "av" if waits[0] else "opponent"


def _lanes(spot: Spot, places: Places) -> frozenset[str]:
    """Those of the spot's movement, else its own."""
    if spot.movement:
        return frozenset(places.movements[spot.movement].lanes)
    return frozenset({spot.lane} - {""})
