"""Where a difference of hits comes from: which places and kinds have more or fewer of them.

The share of all attacked runs that end in a hit at a place, or of a kind: over all places, or all
kinds, the shares add up to the rate of hits, and their differences to its difference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from deepmf_sumo.errors import UsageError
from deepmf_sumo.gate.rows import Row
from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.results import quantities
from deepmf_sumo.results.findings import said
from deepmf_sumo.results.matching import Matched, answer, match
from deepmf_sumo.results.result import Result, attacked
from deepmf_sumo.risk import attacks

Dimension = Literal["place", "accident", "sector", "worth"]
DIMENSIONS: Final[tuple[Dimension, ...]] = ("place", "accident", "sector", "worth")
_PART: Final = "part"
Tags = Mapping[Dimension, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tagged:
    """An attacked run, and of its hit: place, accident, sector (a number), worth in words."""

    row: Row
    tags: Tags


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Hits of one kind or at one place, before and after.

    Attributes:
        value: the place's title, or the kind; a sector is a number.
        hits: of A and of B. runs: attacked, of A and of B.
        found: the difference of the shares, B minus A.
        state: of that difference, beyond chance. needed: about how many scenes would decide, where
            these do not.
    """

    dimension: Dimension
    value: str
    hits: tuple[int, int]
    runs: tuple[int, int]
    found: Matched
    state: Literal["more", "fewer", "within margin", "cannot tell"]
    needed: int | None = None


def tags(results: Mapping[str, Result], folders: Sequence[Path]) -> Mapping[str, Tags]:
    """Of each hit, by ``OUT/runs/RUN``; places on SUMO networks alone.

    Args:
        results: of `attacks.of_runs`.
        folders: their result folders.
    """
    hits = {key: one for key, one in results.items() if attacked(one) and quantities.hit(one)}
    found = {key: _kinds(one) for key, one in hits.items()}
    try:
        networks = attacks.read(folders)
    except UsageError:  # recorded scenes have no network to name places on
        networks = []
    for network in networks:
        for one in network.attacks:
            if one.hit:
                own = found[f"{one.folder}/runs/{one.run_id}"]
                own.setdefault("place", network.places.site(one.decided) or "elsewhere")
    return found


def _kinds(result: Result) -> dict[Dimension, str]:
    accident, sector = quantities.accident(result), quantities.sector(result)
    worth = quantities.worth(result)
    kinds: dict[Dimension, str] = {}
    if accident is not None:
        kinds["accident"] = ACCIDENT_TYPES[accident].replace("_", " ")
    if sector is not None:
        kinds["sector"] = str(sector)
    if worth is not None:
        kinds["worth"] = said(worth)
    return kinds


def origins(old: Sequence[Tagged], new: Sequence[Tagged], confidence: float) -> list[Origin]:
    """All places and kinds with hits; of each dimension the greatest differences first.

    The intervals of one dimension hold together with ``confidence``.
    """
    table: list[Origin] = []
    for dimension in DIMENSIONS:
        values = sorted({one.tags[dimension] for one in (*old, *new) if dimension in one.tags})
        alone = 1 - (1 - confidence) / max(len(values), 1)
        group = [_origin(dimension, value, old, new, alone) for value in values]
        table += sorted(group, key=lambda one: (-abs(_shift(one)), one.value))
    return table


def _origin(
    dimension: Dimension,
    value: str,
    old: Sequence[Tagged],
    new: Sequence[Tagged],
    confidence: float,
) -> Origin:
    sides = [_marked(side, dimension, value) for side in (old, new)]
    found = match(_PART, sides[1], sides[0], confidence, largest=1.0)
    state, needed = _state(found)
    hits = [round(sum(row.values[_PART] for row in side)) for side in sides]
    return Origin(
        dimension=dimension,
        value=value,
        hits=(hits[0], hits[1]),
        runs=(len(old), len(new)),
        found=found,
        state=state,
        needed=needed,
    )


def _marked(side: Sequence[Tagged], dimension: Dimension, value: str) -> list[Row]:
    """The rows with 1 for a hit of that kind, else 0."""
    return [
        replace(one.row, values={_PART: float(one.tags.get(dimension) == value)}) for one in side
    ]


def _shift(origin: Origin) -> float:
    return origin.found.difference.mean if origin.found.difference else 0.0


def _state(
    found: Matched,
) -> tuple[Literal["more", "fewer", "within margin", "cannot tell"], int | None]:
    """``within margin``: that of rates."""
    state, needed = answer(found, 0.0, quantities.RATE)
    return ("fewer" if state == "less" else state), needed
