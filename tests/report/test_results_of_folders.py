"""`Results`: runs of one folder or several, and as one table."""

import json
import subprocess
import sys

import pytest

import deepmf_sumo
from deepmf_sumo.errors import UsageError
from deepmf_sumo.results.reader import Results

from tests.support.result_folders import Folder


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path_factory.mktemp("home")))


@pytest.fixture
def folder(tmp_path):
    folder = Folder(tmp_path)
    folder.add("one", metrics={"min_gap": 1.25})
    folder.add("two", method="S4", hit=False, metrics={"ttc_min": 0.5})
    folder.add("two", method="S1 front", part="figures", sector=4)
    folder.add("two", method="S1 (8)", part="budgets")
    folder.fail("three")
    return folder


def test_runs_come_in_the_order_of_the_table(folder):
    found = Results.open(folder.out)
    assert [(run.scene, run.method, run.status) for run in found.runs] == [
        ("one", "S1", "ok"),
        ("two", "S4", "ok"),
        ("two", "S1 front", "ok"),
        ("two", "S1 (8)", "ok"),
        ("three", "S1", "failed"),
    ]
    assert [run.method for run in found.done] == ["S1", "S4"]
    assert [run.method for run in found.steered] == ["S1 front"]
    assert (found.methods, found.planners) == (("S1", "S4"), ("replay",))


def test_what_a_run_did_is_read_when_it_is_asked_for(folder):
    first, second, *_, failed = Results.open(folder.out).runs
    assert (first.hit, first.attacked, first.sector, first.metric("min_gap")) == (
        True,
        True,
        0,
        1.25,
    )
    assert (second.hit, second.sector, second.metric("min_gap")) == (False, None, None)
    assert "trials" not in first.result["search"]
    assert (first.recorded, first.has_result) == (True, True)
    assert (failed.recorded, failed.has_result) == (False, False)
    with pytest.raises(UsageError, match=r"result\.json cannot be read: No such file"):
        _ = failed.result


def test_a_folder_of_folders_is_all_of_them(folder, tmp_path):
    manifest = {"tool": "deepmf-sumo", "format_version": 1, "runs": {"00-one": "k", "09-lost": "k"}}
    (folder.out / "manifest.json").write_text(json.dumps(manifest))
    all_of_them = Results.open(tmp_path)
    assert all_of_them.folders == (folder.out,)
    assert len(all_of_them.runs) == 5
    assert all_of_them.missing == ("09-lost",)
    assert len(Results.open(folder.out, str(folder.out)).runs) == 10
    with pytest.raises(UsageError, match="is not a result folder, and contains none"):
        Results.open(tmp_path / "out" / "runs")


def test_a_damaged_result_is_one_sentence(folder):
    (folder.out / "runs" / "00-one" / "result.json").write_text("{")
    with pytest.raises(UsageError, match=r"result\.json is damaged .*--resume"):
        Results.open(folder.out).frame()


@pytest.mark.sumo
def test_it_is_imported_when_it_is_asked_for():
    assert deepmf_sumo.Results is Results
    code = "import sys, deepmf_sumo; sys.exit('pandas' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
