"""The wheel, built, and run from an empty folder without the checkout."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pandas as pd
import pytest

from deepmf_sumo.cli import main

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """Folder with the unpacked wheel, which contains Python code and data alone."""
    pytest.importorskip("hatchling", reason="hatchling, which builds the wheel, is not installed")
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=200)
    (wheel,) = folder.glob("deepmf_sumo-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


@pytest.fixture(scope="module")
def empty(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("empty")


@pytest.fixture(scope="module")
def command(installed, empty):
    """Runs `deepmf-sumo` of the wheel in the empty folder; returns what it printed."""

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "deepmf_sumo.cli.main", *arguments],
            cwd=empty,
            check=False,
            env={
                **os.environ,
                "PYTHONPATH": str(installed),
                "DEEPMF_SUMO_HOME": str(empty / "home"),
            },
            capture_output=True,
            text=True,
            timeout=250,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    return run


def test_the_wheel_is_the_package_without_tests_and_studies(installed):
    top = {path.name for path in installed.iterdir()}
    assert {name.partition("-")[0] for name in top} == {"deepmf_sumo"}
    assert not [*installed.rglob("test_*.py")]
    assert (installed / "deepmf_sumo" / "py.typed").is_file()
    assert {"sumo_nets", "scenarios", "suite", "paper.yaml"} <= {
        path.name for path in (installed / "deepmf_sumo" / "starter").iterdir()
    }


def test_init_and_run_of_the_wheel_write_the_results_of_the_checkout(command, empty, tmp_path):
    command("init", "start")
    laid = sorted(path.name for path in (empty / "start" / "scenarios").glob("*.yaml"))
    assert laid == sorted(path.name for path in (ROOT / "scenarios").glob("*.yaml"))
    more = ("--no-pictures", "--set", "duration_s=2.0", "--out")
    command("run", "start/scenarios/cut_in.yaml", *more, "results")
    own = str(tmp_path / "own")
    assert main.run(["run", str(ROOT / "scenarios" / "cut_in.yaml"), *more, own]) == 0
    (ours,) = pd.read_csv(empty / "results" / "runs.csv").to_dict("records")
    (theirs,) = pd.read_csv(tmp_path / "own" / "runs.csv").to_dict("records")
    assert ours["status"] == "ok"
    assert ours["contact_speed_mps"] == theirs["contact_speed_mps"]
    assert ours["contact_time_s"] == theirs["contact_time_s"]
