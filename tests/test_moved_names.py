"""Plug-ins of the release before import folders by the names that these had."""

import importlib
import importlib.util
import os
import subprocess
import sys

import pytest

from deepmf_sumo import _moved


@pytest.mark.parametrize("old", _moved.MOVED)
def test_an_old_name_is_the_module_of_today(old):
    name = f"deepmf_sumo.{old}"
    sys.modules.pop(name, None)
    new = importlib.import_module(f"deepmf_sumo.{_moved.MOVED[old]}")
    own = new.__spec__
    with pytest.warns(FutureWarning, match=f"{name} is {new.__name__} now"):
        assert importlib.import_module(name) is new
    assert new.__spec__ is own
    assert new.__spec__.name == new.__name__


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_modules_below_and_their_classes_are_the_same():
    for old, new, name in (
        ("datatypes", "scene", "Command"),
        ("geometry", "scene.geometry", "boxes"),
        ("metrics.collision", "judge.metrics.collision", "collision_rate"),
        ("planners.idm", "planners.idm", "build"),
    ):
        one = importlib.import_module(f"deepmf_sumo.{old}")
        two = importlib.import_module(f"deepmf_sumo.{new}")
        assert one is two
        assert getattr(one, name, None) is getattr(two, name, None)


def test_other_names_are_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("deepmf_sumo.nowhere")
    with pytest.warns(FutureWarning), pytest.raises(ModuleNotFoundError, match=r"scene\.nowhere"):
        importlib.import_module("deepmf_sumo.datatypes.nowhere")
    assert importlib.util.find_spec("deepmf_sumo.nowhere") is None


@pytest.mark.sumo
def test_a_planner_of_the_release_before_drives(tmp_path):
    (tmp_path / "keeps.py").write_text(
        """from deepmf_sumo.datatypes import Command
from deepmf_sumo.plugins import Settings as Plain


class Settings(Plain):
    pass


class Keeps:
    Settings = Settings
    model = None

    @classmethod
    def build(cls, settings):
        return cls()

    def reset(self, case, rng):
        pass

    def act(self, view):
        row = view.history.row(view.av_id)
        return Command(kind="speed", speed_mps=float(view.history.speed_mps[row, -1]))
"""
    )
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", "run", "scenarios/cut_in.yaml"]
    command += ["--set", "planner={name: 'keeps:Keeps'}", "--set", "expect={}", "--no-pictures"]
    command += ["--out", str(tmp_path / "out")]
    here = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run(command, env=here, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
