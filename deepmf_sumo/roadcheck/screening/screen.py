"""A network against a guideline: all rules, and what attacks found at the same junctions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.results.risk import table
from deepmf_sumo.roadcheck import conflict_places as traffic_conflicts
from deepmf_sumo.roadcheck.screening import alignment, right_of_way, signals
from deepmf_sumo.roadcheck.screening.findings import COLUMNS, Finding, Judged, grouped
from deepmf_sumo.roadcheck.screening.guidelines import Guideline
from deepmf_sumo.roadcheck.screening.roads import SignalledNetwork, opened

BESIDE: Final = traffic_conflicts.BESIDE
"""Columns of the risk map that stand beside a finding with ``--beside``."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Screened:
    """What was found.

    Attributes:
        findings: the worst first.
        not_judged: how many things could not be judged, by reason.
        programs, movements: how many were looked at.
    """

    roads: SignalledNetwork
    findings: tuple[Finding, ...]
    not_judged: Mapping[str, int]
    programs: int
    movements: int


def screen(file: Path, book: Guideline) -> Screened:
    """Hold a .net.xml, .net.xml.gz or .sumocfg against a guideline; nothing is simulated.

    Raises UsageError where the file is none of them, or is damaged.
    """
    roads = opened(file)
    found = Judged()
    for subject in (signals, right_of_way, alignment):
        subject.judge(roads, book, found)
    titles = {name: roads.places.title("junction", name) for name in roads.places.junctions}
    return Screened(
        roads=roads,
        findings=tuple(grouped(found.cases, titles)),
        not_judged={why: count for why, count in sorted(found.not_judged.items()) if count},
        programs=len(roads.programs),
        movements=len(roads.places.movements),
    )


def beside(folder: Path, screened: Screened) -> dict[str, Mapping[str, Any]]:
    """Columns of the risk map of a result folder, by junction.

    Raises UsageError where its attacks are on another network.
    """
    network = traffic_conflicts.beside(folder, screened.roads.places)
    return {
        row.place: table.columns(row)
        for row in table.rows(network)
        if row.kind == "junction" and row.counted == "decided"
    }


def columns(
    findings: Sequence[Finding], risk: Mapping[str, Mapping[str, Any]] | None = None
) -> list[dict[str, Any]]:
    """The rows of ``screen.csv``; with attacks beside them where ``risk`` is given."""
    rows = []
    for one in findings:
        row = one.columns()
        if risk is not None:
            known = risk.get(one.worst.junction, {})
            row |= {name: known.get(name) for name in BESIDE}
            row |= {name: known.get(name, 0) for name in ("attacks", "hits")}
        rows.append(row)
    return rows


__all__ = ["BESIDE", "COLUMNS", "Screened", "beside", "columns", "screen"]
