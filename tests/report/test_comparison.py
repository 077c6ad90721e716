"""Result folders side by side, on numbers that can be counted by hand."""

import json

import gate_doubles
import numpy as np
import pytest

from deepmf_sumo.benchmark.result import COLUMNS
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report.comparison import compare


def folder(tmp_path, outcomes, *, opponents=True):
    lines = [",".join(COLUMNS)]
    for number, (status, outcome, on_road) in enumerate(outcomes):
        run = tmp_path / "runs" / f"run{number}"
        run.mkdir(parents=True)
        row = dict.fromkeys(COLUMNS, "")
        row |= {"run_id": run.name, "spec": "s", "planner": "idm", "status": status}
        row |= {"outcome": outcome, "generation_s": "0.5", "cycle_ms_median": "80"}
        row |= {"opponent": "7" if opponents else ""}
        row |= {"contact_time_s": str(2 + number), "contact_speed_mps": "5"} if outcome else {}
        lines.append(",".join(str(row[name]) for name in COLUMNS))
        metrics = {"on_road": {"value": on_road}, "feasible": {"value": 1.0}}
        content = {
            **gate_doubles.result(status=status),
            "contacts": [{"kind": outcome}] if outcome != "none" else [],
            "metrics": metrics,
        }
        (run / "result.json").write_text(json.dumps(content))
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_rates_count_only_runs_that_went_through(tmp_path):
    outcomes = [
        ("ok", "av_opponent", 1.0),
        ("ok", "av_opponent", 0.5),
        ("ok", "opponent_other", 1.0),
        ("ok", "none", 1.0),
        ("failed", "", 1.0),
    ]
    row = compare([folder(tmp_path, outcomes)]).iloc[0]
    assert (row["runs"], row["not_ok"], row["hits"]) == (4, 1, 2)
    assert row["rate"] == pytest.approx(0.5)
    assert row["low"] < 0.5 < row["high"]
    assert row["time_s"] == pytest.approx(2.5)
    assert row["on_road_hits"] == 1
    assert row["third_party"] == 1
    assert row["on_road"] == pytest.approx(0.875)


def test_runs_with_nobody_to_attack_are_no_misses(tmp_path):
    found = compare(
        [
            folder(tmp_path / "some", [("ok", "av_opponent", 1.0), ("ok", "none", 1.0)]),
            folder(tmp_path / "none", [("ok", "none", 1.0)], opponents=False),
        ]
    )
    assert list(found["runs"]) == [2, 1]
    assert list(found["attacked"]) == [2, 0]
    assert found["rate"][0] == 0.5
    assert np.isnan(found["rate"][1])


def test_a_folder_without_results_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"runs\.csv"):
        compare([tmp_path])


def test_a_run_that_is_half_written_is_named(tmp_path):
    made = folder(tmp_path, [("ok", "none", 1.0)])
    file = made / "runs" / "run0" / "result.json"
    file.write_text(file.read_text()[:20])
    with pytest.raises(UsageError, match=r"run0/result\.json is damaged .* --resume"):
        compare([made])
    file.write_text("null")
    with pytest.raises(UsageError, match="it holds no names and values"):
        compare([made])
    (made / "runs.csv").write_text("")
    with pytest.raises(UsageError, match=r"runs\.csv is cut short; .* --resume"):
        compare([made])
