"""Result folders -> one row each: rates with their denominators and intervals, means of metrics."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pandas as pd

from deepmf_sumo.benchmark.results import Results, Run
from deepmf_sumo.metrics.statistics import wilson

_NUMBERS: Final = ("contact_time_s", "contact_speed_mps", "generation_s", "cycle_ms_median")
"""Columns of ``runs.csv`` that are averaged."""

MEANS: Final = {
    "opponent_rms_acceleration": "rms_a_mps2",
    "feasible": "feasible",
    "on_road": "on_road",
    "candidate_perplexity": "perplexity",
    "colliding_plans": "colliding_plans",
    "predicted_contact": "predicted_rate",
    "av_ade": "av_ade_m",
}
"""Metrics of ``result.json`` that are averaged over all runs, and their columns."""
_APART: Final = ("planner", "perception", "method", "planner_label", "part")
"""Columns of ``runs.csv`` whose values are never mixed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """The runs of one spec in a result folder, and of a benchmark of one method and planner.

    Attributes:
        runs: rows of ``runs.csv``, with the contacts and metrics of their ``result.json``.
    """

    folder: Path
    spec: str
    runs: pd.DataFrame

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """A mapping a run; ``metrics`` is empty where there is no result."""
        rows = [dict(row) for row in self.runs.to_dict("records")]
        return [
            {str(name): value for name, value in row.items()}
            | {"metrics": row["metrics"] if isinstance(row.get("metrics"), dict) else {}}
            for row in rows
        ]

    @cached_property
    def ok(self) -> list[dict[str, Any]]:
        """The runs that went through."""
        return [row for row in self.rows if row["status"] == "ok"]

    @cached_property
    def attacked(self) -> list[dict[str, Any]]:
        """Of these those in which a vehicle was attacked."""
        return [row for row in self.ok if isinstance(row["opponent"], str)]

    @cached_property
    def hits(self) -> list[dict[str, Any]]:
        """The runs in which the opponent hit the AV."""
        return [row for row in self.ok if row["outcome"] == "av_opponent"]

    @staticmethod
    def fair(row: Mapping[str, Any]) -> bool:
        """Whether the opponent kept to a car's limits, and to the road at >= 95 % of its steps."""
        return bool(row["metric_on_road"] >= 0.95 and row["metric_feasible"] >= 1)

    @property
    def about(self) -> dict[str, str]:
        """Spec, method and part of a benchmark, planner and attack; empty what says no more."""
        planner = self.text("planner_label") or self._joined("planner", "perception")
        method, part = self.text("method"), self.text("part")
        return {
            "spec": self.spec,
            "method": method if method != self.spec else "",
            "part of the plan": part if part != "main" else "",
            "planner": planner,
            "attack": self._joined("adversary", "version"),
        }

    def _joined(self, *names: str) -> str:
        return " ".join(filter(None, map(self.text, names)))

    def text(self, name: str) -> str:
        """A column's text, of the first run; empty where there is none."""
        value = self.runs.iloc[0].get(name)
        return value if isinstance(value, str) else ""


def groups(folders: Sequence[Path]) -> list[Group]:
    """The runs of each folder by spec, method, planner and part of the plan, in their order.

    Raises UsageError for a folder without ``runs.csv``, and where that or a ``result.json`` is
    damaged.
    """
    return [
        Group(folder=folder, spec=str(spec), runs=runs)
        for folder in folders
        for (spec, *_), runs in _grouped(_runs(folder))
    ]


def _grouped(table: pd.DataFrame) -> Iterable[tuple[tuple[Any, ...], pd.DataFrame]]:
    names = ["spec", *(name for name in _APART if name in table)]
    found: Iterable[tuple[tuple[Any, ...], pd.DataFrame]] = table.groupby(
        names, sort=False, dropna=False
    )
    return found


def compare(found: Sequence[Group]) -> pd.DataFrame:
    """One row per group, in the order given.

    Columns: folder, spec, method, planner, perception, version, runs (that went through), attacked
    (those with an opponent), hits and their rate of these with the 95 % Wilson interval, contact
    time and relative speed (means over hits), ``third_party`` (runs in which the opponent hit
    another vehicle before or instead), ``av_other`` (runs in which the AV hit another vehicle),
    ``on_road_hits`` (hits within the limits and with the opponent on the road at >= 95 % of its
    steps), means of the metrics in `MEANS`, generation time a run and the median of a cycle.
    """
    return pd.DataFrame([_row(group) for group in found])


def _runs(folder: Path) -> pd.DataFrame:
    """``runs.csv`` with the contacts and metrics of each run's ``result.json``."""
    runs = Results.of(folder).runs
    table = pd.DataFrame([run.row for run in runs]).replace("", None)
    for name in _NUMBERS:
        table[name] = pd.to_numeric(table[name], errors="coerce")
    return pd.concat([table, pd.DataFrame(map(_details, runs))], axis=1)


def _details(run: Run) -> dict[str, Any]:
    if not run.has_result:
        return {}
    result = run.result
    kinds = {contact["kind"] for contact in result.get("contacts", [])}
    metrics = result.get("metrics", {})
    values = {name: one["value"] for name, one in metrics.items()}
    return {
        "third_party": "opponent_other" in kinds,
        "av_other": "av_other" in kinds,
        **{f"metric_{name}": values.get(name) for name in MEANS},
        "metrics": metrics,
    }


def _row(group: Group) -> dict[str, Any]:
    runs = group.runs
    ok = runs[runs["status"] == "ok"]
    attacked, hits = len(group.attacked), ok[ok["outcome"] == "av_opponent"]
    row: dict[str, Any] = {
        "folder": group.folder.name,
        "spec": group.spec,
        **{name: group.text(name) for name in ("method", "planner", "perception", "version")},
        "runs": len(ok),
        "not_ok": len(runs) - len(ok),
        "attacked": attacked,
        "hits": len(hits),
    }
    if attacked:
        row |= wilson(len(hits), attacked)._asdict()
    if len(ok):
        row |= {
            "time_s": hits["contact_time_s"].mean(),
            "speed_mps": hits["contact_speed_mps"].mean(),
            "third_party": int(ok["third_party"].sum()),
            "av_other": int(ok["av_other"].sum()),
            "on_road_hits": sum(map(Group.fair, group.hits)),
            **{column: ok[f"metric_{name}"].mean() for name, column in MEANS.items()},
            "generation_s": ok["generation_s"].mean(),
            "cycle_ms": ok["cycle_ms_median"].median(),
        }
    return row
