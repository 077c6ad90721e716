"""The planner that docs/howto/planners.md shows drives as it says."""

import csv
import gzip
import re
import sys
from pathlib import Path

import pytest

from deepmf_sumo.cli import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto" / "planners.md"


@pytest.fixture
def attack(tiny, tmp_path, monkeypatch):
    """Attack a car of the tiny network, planners lying in the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])

    def call(planner, *more):
        fixed = ["--av", "leader", "--at", "2", "--set", "duration_s=1", "--no-pictures"]
        first = ["attack", str(tiny / "tiny.sumocfg"), "--set", "adversary=none", "--out", "out"]
        return main.run([*first, *fixed, "--planner", planner, *more])

    return call


def test_the_class_of_the_page_drives(attack, tmp_path):
    [code] = re.findall(r"```python title=.my_planner.py.\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / "planner_of_the_page.py").write_text(code)
    cruise = ("--set", "planner.cruise_mps=6")
    assert attack("planner_of_the_page:MyPlanner", *cruise) == 0
    [tracks] = (tmp_path / "out" / "runs").glob("*/tracks.csv.gz")
    with gzip.open(tracks, "rt") as lines:
        rows = [row for row in csv.DictReader(lines) if row["id"] == "leader"]
    assert float(rows[-1]["speed_mps"]) == pytest.approx(6.0, abs=0.1)


def test_a_class_without_build_is_refused_before_anything_runs(attack, tmp_path, capsys):
    (tmp_path / "planner_without_build.py").write_text(
        "from deepmf_sumo.plugins import Settings\nclass MyPlanner:\n    Settings = Settings\n"
    )
    assert attack("planner_without_build:MyPlanner") == 2
    assert "planner_without_build:MyPlanner has no 'build'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
