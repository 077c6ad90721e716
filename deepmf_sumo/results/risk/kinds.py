"""The kinds of conflict that attacks on a network were: how many, how near, how hard."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import Final

from deepmf_sumo.judge.conflict_types import DEFINITIONS, TYPES
from deepmf_sumo.results.risk.attacks import Attacked
from deepmf_sumo.results.risk.table import happened

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
