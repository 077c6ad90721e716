"""Result folders -> one row each: rates with their denominators and intervals, means of metrics."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from deepmf_sumo.benchmark import stored
from deepmf_sumo.metrics.statistics.wilson import wilson
from deepmf_sumo.report.run_table import runs_of

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


def compare(folders: Sequence[Path]) -> pd.DataFrame:
    """One row per folder and spec, in the order given.

    Columns: folder, spec, planner, perception, version, runs (that went through), attacked (those
    with an opponent), hits and their rate of these with the 95 % Wilson interval, contact time and
    relative speed (means over hits), ``third_party`` (runs in which the opponent hit somebody else
    before or instead), ``av_other`` (runs in which the AV hit somebody else), ``on_road_hits``
    (hits within the limits and with the opponent on the road at >= 95 % of its steps), means of the
    metrics in `MEANS`, generation time a run and the median of a cycle. Raises UsageError for a
    folder without ``runs.csv``, and where that or a ``result.json`` is damaged.
    """
    return pd.DataFrame(
        [
            _row(folder, str(spec), group)
            for folder in folders
            for spec, group in _runs(folder).groupby("spec", sort=False)
        ]
    )


def _runs(folder: Path) -> pd.DataFrame:
    """``runs.csv`` with the contacts and metrics of each run's ``result.json``."""
    table = pd.DataFrame(runs_of(folder)).replace("", None)
    for name in _NUMBERS:
        table[name] = pd.to_numeric(table[name], errors="coerce")
    details = [_details(folder, run_id) for run_id in table["run_id"]]
    return pd.concat([table, pd.DataFrame(details)], axis=1)


def _details(folder: Path, run_id: str) -> dict[str, Any]:
    file = stored.run_folder(folder, run_id, "runs.csv") / "result.json"
    if not file.is_file():
        return {}
    result = stored.result_of(file)
    kinds = {contact["kind"] for contact in result.get("contacts", [])}
    values = {name: one["value"] for name, one in result.get("metrics", {}).items()}
    return {
        "third_party": "opponent_other" in kinds,
        "av_other": "av_other" in kinds,
        **{f"metric_{name}": values.get(name) for name in MEANS},
    }


def _row(folder: Path, spec: str, runs: pd.DataFrame) -> dict[str, Any]:
    ok = runs[runs["status"] == "ok"]
    attacked = int(ok["opponent"].notna().sum())
    hits = ok[ok["outcome"] == "av_opponent"]
    first = runs.iloc[0]
    row: dict[str, Any] = {
        "folder": folder.name,
        "spec": spec,
        "planner": first["planner"],
        "perception": first["perception"] if isinstance(first["perception"], str) else "",
        "version": first["version"] if isinstance(first["version"], str) else "",
        "runs": len(ok),
        "not_ok": len(runs) - len(ok),
        "attacked": attacked,
        "hits": len(hits),
    }
    if attacked:
        row |= wilson(len(hits), attacked)._asdict()
    if len(ok):
        fair = (hits["metric_on_road"] >= 0.95) & (hits["metric_feasible"] >= 1)
        row |= {
            "time_s": hits["contact_time_s"].mean(),
            "speed_mps": hits["contact_speed_mps"].mean(),
            "third_party": int(ok["third_party"].sum()),
            "av_other": int(ok["av_other"].sum()),
            "on_road_hits": int(fair.sum()),
            **{column: ok[f"metric_{name}"].mean() for name, column in MEANS.items()},
            "generation_s": ok["generation_s"].mean(),
            "cycle_ms": ok["cycle_ms_median"].median(),
        }
    return row
