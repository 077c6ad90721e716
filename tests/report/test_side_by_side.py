"""Result folders side by side, on numbers that can be counted by hand."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepmf_sumo import tables
from deepmf_sumo.cli import main
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report.side_by_side import compare, groups, side_by_side
from deepmf_sumo.results.result import COLUMNS

from tests.support import gate_doubles


def folder(tmp_path, outcomes, *, opponents=True, planners=("idm",), reason="never met"):
    lines = [",".join(COLUMNS)]
    for number, (status, outcome, on_road) in enumerate(outcomes):
        run = tmp_path / "runs" / f"run{number}"
        run.mkdir(parents=True)
        row = dict.fromkeys(COLUMNS, "")
        planner = planners[number % len(planners)]
        row |= {"run_id": run.name, "spec": "s", "planner": planner, "status": status, "seed": "0"}
        row |= {"outcome": outcome, "generation_s": "0.5", "cycle_ms_median": "80"}
        row |= {"opponent": "7" if opponents else ""}
        row |= {"contact_time_s": str(2 + number), "contact_speed_mps": "5"} if outcome else {}
        lines.append(",".join(str(row[name]) for name in COLUMNS))
        metrics = {"on_road": {"value": on_road}, "feasible": {"value": 1.0}}
        if outcome == "av_opponent":
            metrics |= {
                "ttc_min": {"value": 0.04, "unit": "s"},
                "finding": {"value": 1.0},
                "rung": {"value": 1.0},
            }
            metrics |= {"accident_type": {"value": 1.0, "unit": "number"}}
        else:
            none = {"value": None, "unit": "s", "reason": reason}
            metrics |= {"ttc_min": none, "min_gap": none, "pet": none}
        content = {
            **gate_doubles.result(status=status),
            "contacts": [{"kind": outcome}] if outcome != "none" else [],
            "metrics": metrics,
        }
        (run / "result.json").write_text(json.dumps(content))
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_rates_count_only_successful_runs(tmp_path):
    outcomes = [
        ("ok", "av_opponent", 1.0),
        ("ok", "av_opponent", 0.5),
        ("ok", "opponent_other", 1.0),
        ("ok", "none", 1.0),
        ("failed", "", 1.0),
    ]
    row = compare(groups([folder(tmp_path, outcomes)])).iloc[0]
    assert (row["runs"], row["not_ok"], row["hits"]) == (4, 1, 2)
    assert row["rate"] == pytest.approx(0.5)
    assert row["low"] < 0.5 < row["high"]
    assert row["time_s"] == pytest.approx(2.5)
    assert row["on_road_hits"] == 1
    assert row["third_party"] == 1
    assert row["on_road"] == pytest.approx(0.875)


def test_the_profile_is_said_and_runs_of_two_are_not_mixed(tmp_path):
    out = folder(tmp_path, [("ok", "none", 1.0)] * 3)
    with (out / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row, profile in zip(rows, ("fair", "any", "any"), strict=True):
        row |= {"profile": profile, "constraints": "on_road" if profile == "any" else ""}
    (out / "runs.csv").write_text(tables.to_csv(rows, COLUMNS))
    [line] = [one for one in side_by_side(groups([out])).about if one.label == "profile"]
    assert line.cells == ("fair (no constraints)", "any (on_road)")


def test_runs_without_an_opponent_are_not_misses(tmp_path):
    found = compare(
        groups(
            [
                folder(tmp_path / "some", [("ok", "av_opponent", 1.0), ("ok", "none", 1.0)]),
                folder(tmp_path / "none", [("ok", "none", 1.0)], opponents=False),
            ]
        )
    )
    assert list(found["runs"]) == [2, 1]
    assert list(found["attacked"]) == [2, 0]
    assert found["rate"][0] == 0.5
    assert np.isnan(found["rate"][1])


def test_a_folder_without_results_is_named(tmp_path):
    with pytest.raises(UsageError, match="is not a result folder"):
        groups([tmp_path])


def test_a_run_that_is_half_written_is_named(tmp_path):
    made = folder(tmp_path, [("ok", "none", 1.0)])
    file = made / "runs" / "run0" / "result.json"
    file.write_text(file.read_text()[:20])
    with pytest.raises(UsageError, match=r"run0/result\.json is damaged .* --resume"):
        groups([made])
    file.write_text("null")
    with pytest.raises(UsageError, match="it is not a mapping"):
        groups([made])
    (made / "runs.csv").write_text("")
    with pytest.raises(UsageError, match=r"runs\.csv is cut short; .* --resume"):
        groups([made])


HIT_AND_MISS = [("ok", "av_opponent", 1.0), ("ok", "none", 1.0), ("failed", "", 1.0)]


def cells(found, number=0):
    return {line.label.strip(): line.cells[number] for line in (*found.key, *found.more)}


def test_quantities_have_units_few_digits_and_their_number_of_runs(tmp_path):
    found = cells(side_by_side(groups([folder(tmp_path, HIT_AND_MISS)])))
    assert found["runs that succeeded"] == "2 of 3, 1 failed"
    assert found["AV hit by the opponent, runs"] == "1"
    assert found["rate (95 % interval)"] == "50 % (1 to 99)"
    assert found["of these findings"] == "1 of 1 (1 avoidable)"
    assert found["contrived or unavoidable, no findings"] == "0 contrived, 0 unavoidable"
    assert found["relative speed at the hit, mean, m/s"] == "5.0"
    assert found["least TTC, mean, s"] == "0.0 (1 of 2)"
    assert found["least gap of AV and opponent, mean, m"] == "-"


def test_reasons_for_missing_values_stand_together(tmp_path):
    out = folder(tmp_path, HIT_AND_MISS)
    assert side_by_side(groups([out])).missing == ("never met: 1 of 2 (least TTC, least gap)",)
    both = side_by_side(groups([out, out]), everything=True)
    runs = f"1 of 2 of {out}, 1 of 2 of {out}"
    assert both.missing == (f"never met: {runs} (least TTC, least gap, pet)",)


def test_all_metrics_are_shown_when_asked_for_and_names_are_counted(tmp_path):
    made = groups([folder(tmp_path, HIT_AND_MISS)])
    assert not side_by_side(made).more
    found = cells(side_by_side(made, everything=True))
    assert found["accident_type"] == "1 rear end"
    assert found["on_road"] == "1"
    assert "pet, s" not in found


def test_planners_of_one_spec_are_not_mixed(tmp_path):
    out = folder(tmp_path, HIT_AND_MISS[:2], planners=("idm", "sumo"))
    found = side_by_side(groups([out]))
    assert {line.label: line.cells for line in found.about}["planner"] == ("idm", "sumo")
    assert [cells(found, number)["AV hit by the opponent, runs"] for number in (0, 1)] == ["1", "0"]
    assert list(compare(groups([out]))["hits"]) == [1, 0]


@pytest.mark.parametrize("folders", [1, 2, 12])
def test_the_table_is_readable_however_many_results(tmp_path, capsys, folders):
    made = [folder(tmp_path / f"out{number}", HIT_AND_MISS) for number in range(folders)]
    assert main.run(["show", *map(str, made)]) == 0
    told = capsys.readouterr().out
    assert "planner idm" in told
    assert told.count("50 % (1 to 99)") == folders
    assert "never met: 1 of 2" in told
    assert ("--all shows all quantities" in told) == (folders == 12)
    assert main.run(["show", "--format", "csv", *map(str, made)]) == 0
    assert capsys.readouterr().out.count("\n") == folders + 1
    assert main.run(["show", "--all", *map(str, made)]) == 0
    assert capsys.readouterr().out.count("1 rear end") == folders


def test_simulated_episodes_are_shown_where_a_run_made_more_than_one(tmp_path):
    made = folder(tmp_path, [("ok", "none", 1.0)] * 2)
    assert "episodes" not in _short(made)
    frame = pd.read_csv(made / "runs.csv", dtype=str).assign(simulations=["1", "5"])
    frame.to_csv(made / "runs.csv", index=False)
    assert _short(made)["episodes"] == ("3.0",)


@pytest.mark.parametrize("cell", ["\n", "fast"])
def test_a_cell_that_is_not_a_number_is_named(tmp_path, capsys, cell):
    made = folder(tmp_path, [("ok", "none", 1.0)])
    frame = pd.read_csv(made / "runs.csv", dtype=str).assign(generation_s=cell)
    frame.to_csv(made / "runs.csv", index=False)
    assert main.run(["show", str(made)]) == 2
    said = capsys.readouterr().err
    assert "runs.csv is damaged: generation_s of run0 is" in said
    assert "unexpected" not in said


def _short(made):
    return {line.short: line.cells for line in side_by_side(groups([made])).key}


def test_folders_of_one_name_are_told_apart(tmp_path, monkeypatch, capsys):
    for place in ("a/x", "b/x", "b/y", "c/b/y"):
        (tmp_path / place).mkdir(parents=True)
        folder(tmp_path / place, [("ok", "none", 1.0)])
    every = [tmp_path / place for place in ("a/x", "b/x", "b/y", "c/b/y")]
    assert list(compare(groups(every[:2]))["folder"]) == ["a/x", "b/x"]
    assert list(compare(groups(every[:1]))["folder"]) == ["x"]
    last = f"{tmp_path.name}/b/y"
    assert list(compare(groups(every))["folder"]) == ["a/x", "b/x", last, "c/b/y"]
    monkeypatch.chdir(tmp_path / "b")
    assert list(compare(groups([tmp_path / "a/x", Path("x")]))["folder"]) == ["a/x", "b/x"]


def test_a_folder_of_result_folders_is_shown_as_these(tmp_path, capsys):
    for place in ("seeds/1", "seeds/2"):
        (tmp_path / place).mkdir(parents=True)
        folder(tmp_path / place, [("ok", "none", 1.0)])
        (tmp_path / place / "manifest.json").write_text('{"tool": "deepmf-sumo", "runs": {}}')
    assert main.run(["show", str(tmp_path / "seeds"), "--format", "json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["folder"] for row in rows] == ["1", "2"]
