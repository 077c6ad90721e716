"""Where a difference of hits comes from: which places and kinds have more or fewer of them.

The share of all attacked runs that end in a hit at a place, or of a kind: over all places, or all
kinds, the shares add up to the rate of hits, and their differences to its difference.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import pandas as pd

from deepmf_sumo.errors import UsageError
from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.results.changes import change
from deepmf_sumo.results.findings import NOT_JUDGED
from deepmf_sumo.results.matching import KEYS, Matched
from deepmf_sumo.results.quantities import share
from deepmf_sumo.results.risk import attacks
from deepmf_sumo.results.run_sets import RunSet
from deepmf_sumo.results.stored import result_folders

Dimension = Literal["place", "accident", "sector", "worth"]
DIMENSIONS: Final[tuple[Dimension, ...]] = ("place", "accident", "sector", "worth")
State = Literal["more", "fewer", "within margin", "cannot tell"]
_PART: Final = share("part")


@dataclass(frozen=True, slots=True, kw_only=True)
class HitOrigin:
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
    state: State
    needed: int | None = None


def tagged(side: RunSet) -> pd.DataFrame:
    """The attacked runs, with a column for each dimension: what a hit was, None without one.

    Places are those of SUMO networks alone.
    """
    runs = side.runs[side.runs["collision_rate"].notna()]
    hits, places = runs[runs["hit"]], _places(side)
    keys = zip(hits["folder"], hits["run"], strict=True)
    values: dict[Dimension, list[str | None]] = {
        "place": [places.get(key) for key in keys],
        "accident": [_accident(number) for number in hits["accident_type"]],
        "sector": [_sector(number) for number in hits["impact_sector"]],
        "worth": [None if worth == NOT_JUDGED else worth for worth in hits["worth"]],
    }
    found = pd.DataFrame(values, index=hits.index, dtype=object)
    return runs[list(KEYS)].join(found)


def _places(side: RunSet) -> dict[tuple[str, str], str]:
    """Titles of the places of hits, by folder and run."""
    try:
        networks = attacks.read(result_folders(side.source))
    except UsageError:  # recorded scenes have no network to name places on
        return {}
    found: dict[tuple[str, str], str] = {}
    for network in networks:
        for one in network.attacks:
            if one.hit:
                title = network.places.site(one.decided) or "elsewhere"
                found.setdefault((one.folder, one.run_id), title)
    return found


def _accident(number: float) -> str | None:
    return None if math.isnan(number) else ACCIDENT_TYPES[round(number)].replace("_", " ")


def _sector(number: float) -> str | None:
    return None if math.isnan(number) else str(int(number))


def origins(old: pd.DataFrame, new: pd.DataFrame, confidence: float) -> list[HitOrigin]:
    """All places and kinds with hits; of each dimension the greatest differences first.

    The intervals of one dimension hold together with ``confidence``.

    Args:
        old: attacked runs as of `tagged`.
        new: the same.
        confidence: of all intervals of a dimension.
    """
    table: list[HitOrigin] = []
    for dimension in DIMENSIONS:
        values = sorted({str(one) for side in (old, new) for one in side[dimension].dropna()})
        alone = 1 - (1 - confidence) / max(len(values), 1)
        group = [_origin(dimension, value, old, new, alone) for value in values]
        table += sorted(group, key=lambda one: (-abs(_shift(one)), one.value))
    return table


def _origin(
    dimension: Dimension, value: str, old: pd.DataFrame, new: pd.DataFrame, confidence: float
) -> HitOrigin:
    """A hit of that kind counts as 1, any other run as 0."""
    sides = [
        side.assign(**{_PART.name: (side[dimension] == value).astype(float)}) for side in (old, new)
    ]
    found = change(_PART, sides[1], sides[0], confidence)
    hits = [round(side[_PART.name].sum()) for side in sides]
    return HitOrigin(
        dimension=dimension,
        value=value,
        hits=(hits[0], hits[1]),
        runs=(len(old), len(new)),
        found=found.found,
        state=_STATE.get(found.state, "cannot tell"),
        needed=found.needed,
    )


_STATE: Final[Mapping[str, State]] = {
    "worse": "more", "better": "fewer", "within margin": "within margin",
}  # fmt: skip


def _shift(origin: HitOrigin) -> float:
    return origin.found.difference.mean if origin.found.difference else 0.0
