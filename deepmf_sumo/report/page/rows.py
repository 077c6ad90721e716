"""The rows of the page's table: a run each, with the kind of its failure."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np

from deepmf_sumo.benchmark.result import Result, first_contact
from deepmf_sumo.metrics.collision import ACCIDENT_TYPES
from deepmf_sumo.report.table import OUTCOMES, SECTORS

COLUMNS: Final = (
    "run", "status", "outcome", "method", "planner", "scene", "part", "seed", "time_s", "speed_mps",
    "delta_v_mps", "sector", "accident", "element", "edge", "turn", "speed", "min_ttc_s",
    "min_gap_m", "avoidable", "opponent", "score", "note",
)  # fmt: skip
SPEEDS_MPS: Final = (2.0, 5.0, 10.0)
"""Bounds between the kinds of speed."""
SPEED_KINDS: Final = (
    *(f"{low:g} to {high:g} m/s" for low, high in pairwise((0.0, *SPEEDS_MPS))),
    f"{SPEEDS_MPS[-1]:g} m/s and more",
)


def row(table: Mapping[str, str], result: Result | None, element: str, note: str) -> list[Any]:
    """Values in the order of `COLUMNS`, null where there is none.

    Args:
        table: the row of ``runs.csv``, and of ``moments.csv`` where there is one.
        result: the content of ``result.json``; None where it is not there.
        element: of the road, where the AV was hit; else empty.
        note: why the run has no result, or cannot be replayed.
    """
    found: Any = result or {}
    outcome = found.get("outcome") or table.get("outcome") or None
    contact = (first_contact(found) if outcome else None) or {}
    hit = bool(contact) and str(outcome).startswith("av")
    metrics = found.get("metrics", {})
    speed = contact.get("relative_mps")
    known = {
        "run": table["run_id"],
        "status": table["status"],
        "outcome": OUTCOMES.get(str(outcome), outcome),
        "method": table.get("method") or table["spec"],
        "planner": table.get("planner_label") or table["planner"],
        "scene": table["scene"],
        "part": table.get("part") or None,
        "seed": int(table["seed"]) if table.get("seed") else None,
        "time_s": contact.get("time_s"),
        "speed_mps": speed,
        "delta_v_mps": contact.get("delta_v_mps"),
        "sector": SECTORS[contact["sector"]] if hit else None,
        "accident": _accident(_metric(metrics, "accident_type")),
        "element": element or None,
        "edge": _edge(table),
        "turn": table.get("turn") or None,
        "speed": speed_kind(speed) if hit else None,
        "min_ttc_s": _metric(metrics, "ttc_min"),
        "min_gap_m": _metric(metrics, "min_gap"),
        "avoidable": _metric(metrics, "avoidable"),
        "opponent": found.get("opponent") or None,
        "score": found.get("opponent_score"),
        "note": note or None,
    }
    return [_short(known[name]) for name in COLUMNS]


def speed_kind(speed_mps: float | None) -> str | None:
    """Name of the band that a contact's relative speed lies in."""
    if speed_mps is None:
        return None
    return SPEED_KINDS[int(np.searchsorted(SPEEDS_MPS, speed_mps, side="right"))]


def _accident(number: float | None) -> str | None:
    if number is None:
        return None
    name = ACCIDENT_TYPES[int(number)]
    return "T-bone" if name == "t_bone" else name.replace("_", " ")


def _edge(table: Mapping[str, str]) -> str | None:
    """With the street's name, where the network has one."""
    edge, street = table.get("edge"), table.get("street")
    return f"{street} ({edge})" if street else edge or None


def _metric(metrics: Mapping[str, Any], name: str) -> float | None:
    value: float | None = metrics.get(name, {}).get("value")
    return value


def _short(value: Any) -> Any:
    return round(value, 3) if isinstance(value, float) else value
