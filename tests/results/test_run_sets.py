"""Runs to judge and to compare: of a result folder, and of the file that keeps them."""

import json

import numpy as np
import pandas as pd
import pytest

from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.results import run_sets
from deepmf_sumo.results.quantities import COMPARABLE

from tests.support import gate_doubles


def values(found, run_id):
    """Those of a run that are defined."""
    [row] = found.runs[found.runs["run_id"] == run_id].to_dict("records")
    return {name: row[name] for name in COMPARABLE if not np.isnan(row[name])}


def test_values_of_a_hit_and_of_none(tmp_path):
    out = gate_doubles.write_folder(
        tmp_path / "out",
        [gate_doubles.result("a", hit=True), gate_doubles.result("b")],
    )
    assert values(run_sets.read(out), "made-up--a--0") == {
        "impact_mps": 6,
        "av_collision_rate": 1,
        "collision_rate": 1,
        "avoidable_rate": 1,
        "av_at_fault_rate": 0,
        "ttc_s": 0,
        "min_gap_m": 0,
        "collision_speed_mps": 6,
        "delta_v_mps": 4,
    }
    assert values(run_sets.read(out), "made-up--b--0") == {
        "impact_mps": 0,
        "av_collision_rate": 0,
        "collision_rate": 0,
        "ttc_s": 10,
        "min_gap_m": 2,
    }


def test_a_folder_and_its_file_are_rounded_alike(tmp_path):
    one = gate_doubles.result("a", metrics={"min_gap": {"value": 1.23456789}})
    out = gate_doubles.write_folder(tmp_path / "out", [one])
    assert values(run_sets.read(out), "made-up--a--0")["min_gap_m"] == 1.234568


def test_who_is_judged(tmp_path):
    nobody = {"opponent": None, "metrics": {}}
    other = [{"kind": "av_other", "sector": 0, "relative_mps": 3.0}]
    out = gate_doubles.write_folder(
        tmp_path / "out",
        [
            gate_doubles.result("nobody-there", **nobody),
            gate_doubles.result("no-attack", **nobody, adversary="none", contacts=other),
            gate_doubles.failed("broken"),
        ],
        missing=["made-up--later--7"],
    )
    found = {run.scene: run for run in run_sets.read(out).runs.itertuples()}
    assert [name for name, run in found.items() if run.judged] == ["no-attack"]
    no_attack = values(run_sets.read(out), "made-up--no-attack--0")
    assert no_attack == {"impact_mps": 3, "av_collision_rate": 1}
    assert found["nobody-there"].error == "no vehicle to attack"
    assert (found["broken"].status, found["broken"].error) == ("failed", "SUMO refused")
    assert found["broken"].network == "crossing"
    assert (found["later"].status, found["later"].seed) == ("missing", 7)


def test_a_result_of_an_earlier_batch_is_missing(tmp_path):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()])
    file = out / "manifest.json"
    file.write_text(file.read_text().replace("key of a 0", "another key"))
    assert list(run_sets.read(out).runs["status"]) == ["missing"]


def test_runs_for_figures_do_not_count(tmp_path):
    out = gate_doubles.write_folder(
        tmp_path / "out",
        [gate_doubles.result("a", part="figures"), gate_doubles.result("b", part="main")],
    )
    assert list(run_sets.read(out).runs["run_id"]) == ["made-up--b--0"]


def test_the_file_keeps_all_that_is_compared(tmp_path):
    out = gate_doubles.write_folder(
        tmp_path / "out", [gate_doubles.result(hit=True), gate_doubles.failed("b")]
    )
    found = run_sets.read(out)
    run_sets.write(tmp_path / "first.json", found)
    again = run_sets.read(tmp_path / "first.json")
    assert len(again.runs) == len(found.runs) == 2
    for run_id in found.runs["run_id"]:
        assert values(again, run_id) == values(found, run_id)
    pd.testing.assert_frame_equal(again.runs, found.runs[list(again.runs)])
    assert again.version == found.version
    assert again.attacks == found.attacks
    [setup] = found.attacks.values()
    assert setup.items() >= {"adversary": "deepmf", "adversary.period_s": 1.0}.items()
    run_sets.write(tmp_path / "second.json", again)
    first, second = (tmp_path / f"{name}.json" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()


EMPTY = {
    "kind": "deepmf-sumo results", "format_version": 2, "version": "0", "attacks": {}, "runs": [],
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "no such file or folder"),
        ("{", "is damaged"),
        ("[]", "is damaged"),
        ('{"kind": "deepmf-sumo results", "format_version": 9}', "has format 9"),
        ('{"kind": "deepmf-sumo results", "format_version": 2}', "is damaged"),
        (json.dumps(EMPTY | {"runs": [{}]}), "is damaged"),
        (json.dumps(EMPTY | {"attacks": {"x": 7}}), "is damaged"),
        (json.dumps(EMPTY | {"attacks": [7]}), "is damaged"),
    ],
)
def test_files_that_are_none(tmp_path, text, told):
    file = tmp_path / "b.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(UsageError, match=told) as error:
        run_sets.read(file)
    assert "b.json" in str(error.value)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"tool": "other"}, "is not a manifest"),
        ({"format_version": 2}, "has format 2"),
        ({"runs": None}, "names no runs"),
    ],
)
def test_folders_that_are_none(tmp_path, change, told):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()])
    manifest = json.loads((out / "manifest.json").read_text())
    (out / "manifest.json").write_text(json.dumps(manifest | change))
    with pytest.raises(UsageError, match=told):
        run_sets.read(out)
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="is not a result folder"):
        run_sets.read(tmp_path / "empty")


@pytest.mark.parametrize("values", [None, 7, [1], {"ttc_s": "fast"}, {"ttc_s": None}])
def test_values_that_are_no_numbers(tmp_path, values):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()])
    run_sets.write(tmp_path / "b.json", run_sets.read(out))
    kept = json.loads((tmp_path / "b.json").read_text())
    kept["runs"][0]["values"] = values
    (tmp_path / "b.json").write_text(json.dumps(kept))
    with pytest.raises(UsageError, match=r"b\.json is damaged"):
        run_sets.read(tmp_path / "b.json")


def test_results_that_are_damaged_or_strange(tmp_path):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()])
    file = out / "runs" / "made-up--a--0" / "result.json"
    file.write_text(file.read_text()[:100])
    with pytest.raises(UsageError, match=r"result\.json is damaged"):
        run_sets.read(out)
    file.write_text('{"key": "key of a 0"}')
    with pytest.raises(UsageError, match=r"result\.json is not a result of this version"):
        run_sets.read(out)


def test_a_place_that_cannot_be_written(tmp_path):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()])
    with pytest.raises(OutputError, match="cannot be written"):
        run_sets.write(tmp_path / "no" / "b.json", run_sets.read(out))
