"""The public names of the package, and that they do what the command line does."""

import subprocess
import sys
from pathlib import Path

import pytest

import deepmf_sumo
from deepmf_sumo.cli import main
from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.plans.compare import differences

pytestmark = pytest.mark.sumo

SCENARIO = Path(__file__).resolve().parents[1] / "scenarios" / "cut_in.yaml"


def test_the_public_names_are_these():
    assert deepmf_sumo.__all__ == [
        "AttackEnv",
        "Attacker",
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
    assert main._run(["run", *arguments, "--out", str(tmp_path / "b")]) == 0
    assert differences(tmp_path / "a", tmp_path / "b") == []
    with pytest.raises(OutputError, match="--overwrite"):
        deepmf_sumo.run(SCENARIO, tmp_path / "a", sets=["adversary=none"])


def test_attack_writes_what_the_command_writes(tiny, tmp_path):
    config = tiny / "tiny.sumocfg"
    sets = ["adversary=rule"]
    found = deepmf_sumo.attack(config, tmp_path / "a", moments=2, seed=3, sets=sets)
    assert [run.status for run in found.runs] == ["ok", "ok"]
    arguments = ["attack", str(config), "-n", "2", "--no-risk", "--no-pictures"]
    arguments += ["--set", sets[0], "--seed", "3", "--out", str(tmp_path / "b")]
    assert main._run(arguments) == 0
    assert differences(tmp_path / "a", tmp_path / "b") == []
    moments = [(tmp_path / name / "moments.csv").read_bytes() for name in "ab"]
    assert moments[0] == moments[1]
    with pytest.raises(OutputError, match="--overwrite"):
        deepmf_sumo.attack(config, tmp_path / "a", moments=2, seed=3, sets=sets)


def test_attack_refuses_before_it_simulates(tiny, tmp_path):
    with pytest.raises(UsageError, match="no such vehicle"):
        deepmf_sumo.attack(tiny / "tiny.sumocfg", tmp_path / "a", av="gone")
    for wrong in ({"moments": 0}, {"at_s": [float("nan")]}, {"until_s": -1.0}):
        with pytest.raises(UsageError, match="give"):
            deepmf_sumo.attack(tiny / "tiny.sumocfg", tmp_path / "a", **wrong)
    assert not (tmp_path / "a").exists()


def test_an_attack_without_moments_has_no_runs(tiny, tmp_path):
    found = deepmf_sumo.attack(tiny / "tiny.sumocfg", tmp_path / "a", until_s=1)
    assert found.runs == ()


def test_read_scenes_reads_what_run_wrote(tmp_path):
    arguments = [str(SCENARIO), "--set", "adversary=none", "--scenes", "--no-pictures"]
    assert main._run(["run", *arguments, "--out", str(tmp_path)]) == 0
    [scene] = deepmf_sumo.read_scenes(tmp_path)
    assert scene.tracks.position_m.shape[1] == 91
