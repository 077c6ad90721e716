"""The public names of the package, and that they do what the command line does."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import deepmf_sumo
from deepmf_sumo.cli import main
from deepmf_sumo.cli.init import lay_out
from deepmf_sumo.errors import OutputError, UsageError

from tests.support import tiny_plan
from tests.support.same_bytes import differences

pytestmark = pytest.mark.sumo

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "scenarios" / "cut_in.yaml"


def test_the_public_names_are_these():
    assert deepmf_sumo.__all__ == [
        "AttackEnv",
        "Attacker",
        "Plan",
        "Results",
        "__version__",
        "attack",
        "load_predictors",
        "read_scenes",
        "run",
    ]
    for name in deepmf_sumo.__all__:
        assert getattr(deepmf_sumo, name).__doc__
    assert dir(deepmf_sumo) == sorted(deepmf_sumo.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'rum'"):
        _ = deepmf_sumo.rum


def test_importing_the_package_loads_nothing_heavy():
    program = "import sys, deepmf_sumo; print({'numpy', 'torch', 'libsumo'} & set(sys.modules))"
    shown = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    assert shown.stdout.strip() == "set()"


def test_run_writes_what_the_command_writes(tmp_path):
    found = deepmf_sumo.run(SCENARIO, tmp_path / "a", sets=["adversary=none"], seeds=[1, 2])
    assert [run.status for run in found.runs] == ["ok", "ok"]
    assert len(found.frame()) == 2
    arguments = [str(SCENARIO), "--set", "adversary=none", "--seeds", "1-2", "--no-pictures"]
    assert main.run(["run", *arguments, "--out", str(tmp_path / "b")]) == 0
    assert differences(tmp_path / "a", tmp_path / "b") == []
    with pytest.raises(OutputError, match="--overwrite"):
        deepmf_sumo.run(SCENARIO, tmp_path / "a", sets=["adversary=none"])


def test_run_takes_a_plan(tiny, tmp_path):
    plan = tiny_plan.write(tiny, name="of_the_api.yaml")
    found = deepmf_sumo.run(plan, tmp_path / "a", resume=True)
    assert len(found.runs) == 8
    command = ["run", str(plan), "--set", "sweep.figures=false", "--out", str(tmp_path / "b")]
    assert main.run(command) == 0
    assert differences(tmp_path / "a", tmp_path / "b") == []
    with pytest.raises(UsageError, match="A plan is run by itself"):
        deepmf_sumo.run([plan, SCENARIO], tmp_path / "c")
    with pytest.raises(UsageError, match="its key 'seeds'"):
        deepmf_sumo.run(plan, tmp_path / "c", seeds=[1])


def test_the_notebook_of_the_docs_runs(monkeypatch, tmp_path):
    """Its cells are executed as they are, in a folder that `init` made."""
    notebook = json.loads((ROOT / "docs" / "quickstart.ipynb").read_text("utf-8"))
    assert notebook["nbformat"] == 4
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert sum(len(cell.splitlines()) for cell in cells) < 30
    assert not any(cell.get("outputs") for cell in notebook["cells"])
    lay_out(tmp_path)
    monkeypatch.chdir(tmp_path)
    names = {}
    for cell in cells:
        exec(compile(cell, "quickstart.ipynb", "exec"), names)
    assert names["table"]["status"].eq("ok").all()
    assert (names["run"].folder / "picture.png").is_file()


def test_attack_writes_what_the_command_writes(tiny, tmp_path):
    config = tiny / "tiny.sumocfg"
    sets = ["adversary=rule"]
    found = deepmf_sumo.attack(config, tmp_path / "a", moments=2, seed=3, sets=sets)
    assert [run.status for run in found.runs] == ["ok", "ok"]
    arguments = ["attack", str(config), "-n", "2", "--set", "sweep.risk=false", "--no-pictures"]
    arguments += ["--set", sets[0], "--seed", "3", "--out", str(tmp_path / "b")]
    assert main.run(arguments) == 0
    assert differences(tmp_path / "a", tmp_path / "b") == []
    moments = [(tmp_path / name / "moments.csv").read_bytes() for name in "ab"]
    assert moments[0] == moments[1]
    with pytest.raises(OutputError, match="--overwrite"):
        deepmf_sumo.attack(config, tmp_path / "a", moments=2, seed=3, sets=sets)


def test_attack_refuses_before_it_simulates(tiny, tmp_path):
    with pytest.raises(UsageError, match="no such vehicle"):
        deepmf_sumo.attack(tiny / "tiny.sumocfg", tmp_path / "a", av="gone")
    for wrong, told in (
        ({"moments": 0}, "should be greater than or equal to 1"),
        ({"at_s": [float("nan")]}, "should be a finite number"),
        ({"junctions": ["c"]}, "--junction c: no such junction is in the network"),
        ({"polygon": tiny / "gone.xml"}, "no such file or folder"),
        ({"until_s": -1.0}, "should be greater than or equal to 0"),
    ):
        with pytest.raises(UsageError, match=told):
            deepmf_sumo.attack(tiny / "tiny.sumocfg", tmp_path / "a", **wrong)
    assert not (tmp_path / "a").exists()


def test_an_attack_without_moments_has_no_runs(tiny, tmp_path):
    found = deepmf_sumo.attack(tiny / "tiny.sumocfg", tmp_path / "a", until_s=1)
    assert found.runs == ()


def test_read_scenes_reads_what_run_wrote(tmp_path):
    arguments = [str(SCENARIO), "--set", "adversary=none", "--scenes", "--no-pictures"]
    assert main.run(["run", *arguments, "--out", str(tmp_path)]) == 0
    [scene] = deepmf_sumo.read_scenes(tmp_path)
    assert scene.tracks.position_m.shape[1] == 91
