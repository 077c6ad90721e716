"""`Results.frame`: rows, columns and missing values of runs, attacks and contacts."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import frames, planned
from deepmf_sumo.results.quantities import BY_NAME, COMPARABLE, QUANTITIES
from deepmf_sumo.results.reader import Results
from deepmf_sumo.results.result import COLUMNS
from deepmf_sumo.results.result import row as row_of_run
from deepmf_sumo.results.stored import NEEDED
from deepmf_sumo.tables import to_csv

from tests.support import gate_doubles

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "python.md"
WHOLE = {
    "perception": "lane", "parameters": None, "version": "S1", "budget": {}, "part": "main",
    "method": "", "opponent_score": None, "timings": {"wall_s": 1.5, "generation_s": 0.25},
}  # fmt: skip
TURNS = [
    {"opponent": "b", "begin_s": 0.0, "end_s": 4.0, "ended": "too_long", "outcome": "none",
     "hit_speed_mps": None, "metrics": {"min_gap": 3.0, "rung": None}},
    {"opponent": "c", "begin_s": 4.5, "end_s": 6.0, "ended": "contact", "outcome": "av_opponent",
     "hit_speed_mps": 5.0, "metrics": {"min_gap": 0.0, "rung": 1.0}},
]  # fmt: skip


def written(out, runs):
    """A result folder with the table of its runs."""
    gate_doubles.write_folder(out, runs)
    (out / "runs.csv").write_text(to_csv(map(row_of_run, runs), COLUMNS, cell=str))
    return Results.open(out)


@pytest.fixture
def results(tmp_path):
    hit = gate_doubles.result("a", hit=True, **WHOLE)
    hit["contacts"] = [
        {"kind": "av_opponent", "sector": 3, "relative_mps": 6.0, "time_s": 1.5, "step": 25,
         "first_id": "av", "second_id": "b"},
    ]  # fmt: skip
    in_turn = gate_doubles.result("b", **WHOLE, turns=TURNS)
    nobody = gate_doubles.result("c", **WHOLE | {"opponent": None, "metrics": {}})
    failed = {**gate_doubles.failed("d"), **WHOLE}
    return written(tmp_path / "out", [hit, in_turn, nobody, failed])


def test_runs(results):
    table = results.frame("runs")
    assert table["scene"].tolist() == ["a", "b", "c", "d"]
    assert table["attacked"].tolist() == [True, True, False, False]
    assert table["hit"].tolist() == [True, False, False, False]
    assert table["worth"].tolist() == ["not judged", None, None, None]
    assert table["method"].tolist() == ["made up"] * 4
    assert table["error"].tolist() == [None, None, None, "SUMO refused"]
    assert table["contact_time_s"].fillna(-1).tolist() == [1.5, -1, -1, -1]
    assert table["impact_mps"].fillna(-1).tolist() == [6, 0, -1, -1]
    assert table["impact_mps"].count() == 2
    assert table.equals(results.frame())


def test_attacks_are_those_of_each_turn(results):
    table = results.frame("attacks")
    assert table["scene"].tolist() == ["a", "b", "b"]
    assert table["turn"].fillna(0).tolist() == [0, 1, 2]
    assert table["opponent"].tolist() == ["b", "b", "c"]
    assert table["hit"].tolist() == [True, False, True]
    assert table["worth"].tolist() == ["not judged", None, "avoidable (B)"]
    assert table[["begin_s", "end_s"]].to_numpy().tolist() == [[0, 4], [0, 4], [4.5, 6]]
    assert table["min_gap"].tolist() == [0.0, 3.0, 0.0]


def test_contacts(results):
    [row] = results.frame("contacts").to_dict("records")
    assert (row["scene"], row["time_s"], row["step"], row["sector"]) == ("a", 1.5, 25, 3)
    assert (row["kind"], row["first_id"], row["striker_id"]) == ("av_opponent", "av", None)
    assert np.isnan(row["delta_v_mps"])


def test_what_tables_of_earlier_versions_lack_is_that_of_the_result(results, tmp_path):
    now = results.frame()
    file = tmp_path / "out" / "runs.csv"
    pd.read_csv(file, dtype=str)[list(NEEDED)].to_csv(file, index=False)
    columns = [name for name in now if name not in {"error", "part"}]
    pd.testing.assert_frame_equal(Results.open(tmp_path / "out").frame()[columns], now[columns])


@pytest.mark.parametrize("runs", [[], [{**gate_doubles.failed(), **WHOLE}]])
@pytest.mark.parametrize("kind", frames.KINDS)
def test_a_folder_without_anything_has_all_columns(tmp_path, results, kind, runs):
    nobody = written(tmp_path / "none", runs).frame(kind)
    assert list(nobody) == list(results.frame(kind))
    assert nobody.dtypes.equals(results.frame(kind).dtypes)


def test_another_kind_is_refused(results):
    with pytest.raises(UsageError, match=r"'run' is not a kind of frame.* 'runs'"):
        results.frame("run")


def test_each_quantity_is_that_of_the_result(results):
    table = results.frame()
    for name, quantity in BY_NAME.items():
        if name in COLUMNS:  # simulations, of runs without an attack, too
            continue
        values = [quantity.of(run.result) for run in results.runs]
        assert table[name].astype(object).where(table[name].notna(), None).tolist() == values


def test_planned_runs_are_those_of_the_table_and_the_missing_ones(results, tmp_path):
    file = tmp_path / "out" / "manifest.json"
    manifest = json.loads(file.read_text())
    manifest["runs"]["made-up--e--3"] = "not begun"
    file.write_text(json.dumps(manifest))
    found = planned.read(tmp_path / "out").frame()
    assert found["status"].tolist() == ["ok", "ok", "ok", "failed", "missing"]
    assert found[["scene", "seed"]].iloc[-1].tolist() == ["e", 3]
    assert found[list(COMPARABLE)].iloc[-1].isna().all()
    pd.testing.assert_frame_equal(found.iloc[:-1], results.frame())


def test_the_page_has_all_columns(results):
    """The reference lists those of runs.csv, quantities and metrics."""
    listed = {*COLUMNS, *plugins.names("metrics"), *(one.name for one in QUANTITIES)}
    named = set(re.findall(r"`([a-z_]+)`", PAGE.read_text()))
    own = {name for kind in ("runs", "attacks") for name in results.frame(kind)} - listed
    assert own <= named
    rows = re.findall(r"^\| (`.+?`) \| (?!each|every)", PAGE.read_text(), re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`([a-z_]+)`", row)} - {*frames.KINDS}
    assert names == {name for name in results.frame() if name not in listed} - {"folder"}
    assert set(frames.CONTACT) <= set(results.frame("contacts"))
