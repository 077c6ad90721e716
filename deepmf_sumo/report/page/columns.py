"""The columns of the tables on a page: what they are called, and how their values are shown."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np

from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.report.table import OUTCOMES, SECTORS
from deepmf_sumo.results.frames import run_row as run_row_of
from deepmf_sumo.results.quantities import QUANTITIES, Quantity
from deepmf_sumo.results.reader import Run
from deepmf_sumo.results.result import Result, first_contact

SPEEDS_MPS: Final = (2.0, 5.0, 10.0)
"""Bounds between the speed classes."""
SPEED_CLASSES: Final = (
    *(f"{low:g} to {high:g} m/s" for low, high in pairwise((0.0, *SPEEDS_MPS))),
    f"{SPEEDS_MPS[-1]:g} m/s and more",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of a table on a page.

    Attributes:
        name: of the value in a row.
        heading: with the unit; empty: the value has no column, but a filter.
        kind: of its values. A share is from 0 to 1 and shown in per cent, a flag is 0 or 1 and
            shown as yes or no.
        digits: after the decimal point, of numbers and shares.
        filter: label of its filter; empty: there is none.
        optional: shown only when the reader asks for all columns.
        ascending: the first click on the heading sorts upwards.
    """

    name: str
    heading: str = ""
    kind: Literal["text", "number", "share", "flag"] = "text"
    digits: int = 0
    filter: str = ""
    optional: bool = False
    ascending: bool = True

    def as_json(self) -> dict[str, Any]:
        """What differs from the defaults."""
        plain = asdict(Column(name=self.name))
        changed = {key: value for key, value in asdict(self).items() if value != plain[key]}
        return {"name": self.name, **changed}


_MEASURED: Final = tuple(quantity for quantity in QUANTITIES if quantity.label)
_OF_CONTACT: Final = {
    "collision_time_s": "time_s", "collision_speed_mps": "relative_mps",
    "delta_v_mps": "delta_v_mps",
}  # fmt: skip
"""Quantities that a page shows of every contact that an outcome names, not of hits alone."""


def _measured(quantity: Quantity) -> Column:
    kind: Literal["number", "flag"] = "flag" if quantity.rate else "number"
    return Column(name=quantity.name, heading=quantity.heading, kind=kind, digits=1)


def _filtered(name: str, heading: str) -> Column:
    return Column(name=name, heading=heading, filter=heading)


RUN_COLUMNS: Final = (
    Column(name="run", heading="run"),
    _filtered("status", "status"),
    _filtered("outcome", "outcome"),
    _filtered("method", "method"),
    _filtered("planner", "planner"),
    Column(name="scene", filter="scene"),
    Column(name="part", filter="part of the plan"),
    Column(name="seed", heading="seed", kind="number"),
    *map(_measured, _MEASURED),
    _filtered("sector", "AV hit at"),
    _filtered("worth", "worth"),
    _filtered("accident", "accident"),
    _filtered("element", "road element"),
    _filtered("edge", "edge at the start"),
    _filtered("turn", "AV's next turn"),
    Column(name="speed", filter="contact speed"),
    Column(name="opponent", heading="opponent"),
    Column(name="score", heading="score", kind="number", digits=2),
    Column(name="note", heading="note"),
)


def run_row(run: Run, result: Result | None, element: str, note: str) -> list[Any]:
    """Values in the order of `RUN_COLUMNS`, None where there is none.

    Args:
        run: with its row of ``moments.csv``, where there is one.
        result: the content of ``result.json``; None where it is not there, or cannot be read.
        element: of the road, where the AV was hit; else empty.
        note: why the run has no result, or cannot be replayed.
    """
    row = run_row_of(run, result)
    done = result if result and run.status == "ok" else None
    contact: Mapping[str, Any] = (first_contact(done) if done else None) or {}
    hit = bool(contact) and run.outcome.startswith("av")
    known = {
        "run": run.run_id,
        "status": run.status,
        "outcome": OUTCOMES.get(run.outcome, run.outcome or None),
        "method": run.method,
        "planner": run.planner,
        "scene": run.scene,
        "part": run.row.get("part") or None,
        "seed": run.seed,
        **{one.name: _value(one, row, contact) for one in _MEASURED},
        "sector": SECTORS[contact["sector"]] if hit else None,
        "worth": row["worth"] if done else None,
        "accident": _accident(row.get("accident_type")),
        "element": element or None,
        "edge": _edge(run.row),
        "turn": run.row.get("turn") or None,
        "speed": speed_class(contact.get("relative_mps")) if hit else None,
        "opponent": (row["opponent"] or None) if done else None,
        "score": done.get("opponent_score") if done else None,
        "note": note or None,
    }
    return [short(known[column.name]) for column in RUN_COLUMNS]


def speed_class(speed_mps: float | None) -> str | None:
    """Name of the class that a contact's relative speed lies in."""
    if speed_mps is None:
        return None
    return SPEED_CLASSES[int(np.searchsorted(SPEEDS_MPS, speed_mps, side="right"))]


def short(value: Any) -> Any:
    """A number as it is stored in a page: more digits are never shown."""
    return round(value, 4) if isinstance(value, float) else value


def _value(quantity: Quantity, row: Mapping[str, Any], contact: Mapping[str, Any]) -> float | None:
    if quantity.name in _OF_CONTACT:
        return contact.get(_OF_CONTACT[quantity.name])
    return row.get(quantity.name)


def _accident(number: float | None) -> str | None:
    if number is None:
        return None
    name = ACCIDENT_TYPES[round(number)]
    return "T-bone" if name == "t_bone" else name.replace("_", " ")


def _edge(table: Mapping[str, str]) -> str | None:
    """With the street's name, where the network has one."""
    edge, street = table.get("edge"), table.get("street")
    return f"{street} ({edge})" if street else edge or None
