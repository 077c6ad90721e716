"""The way of a run that docs/developers/architecture.md shows is the one that it goes."""

import importlib
import inspect
import re
import traceback
from pathlib import Path

import pytest

import deepmf_sumo
from deepmf_sumo.cli import main
from deepmf_sumo.study.sweep import workers

from tests.support import tiny_network

PACKAGE = Path(deepmf_sumo.__file__).parent
PAGE = PACKAGE.parent / "docs" / "developers" / "architecture.md"


def listed():
    """Pairs of file and function."""
    [section] = re.findall(r"## The way of a run.*?\n\n(.*?)\n\n", PAGE.read_text(), re.DOTALL)
    return [re.match(r"\d+\. `(.+?):(.+?)`", line).groups() for line in section.splitlines()]


def test_it_has_at_most_ten_hops_which_exist():
    hops = listed()
    assert len(hops) <= 10
    for file, name in hops:
        found = importlib.import_module(f"deepmf_sumo.{file.removesuffix('.py').replace('/', '.')}")
        for part in name.split("."):
            found = getattr(found, part)
        found = inspect.unwrap(getattr(found, "callback", found))
        assert Path(inspect.getsourcefile(found)) == PACKAGE / file


def test_a_run_takes_it(tiny, tmp_path, monkeypatch):
    stack = []

    def seen(*_, **__):
        for frame in traceback.extract_stack():
            path = Path(frame.filename)
            if path.is_relative_to(PACKAGE):
                stack.append((str(path.relative_to(PACKAGE)), frame.name))
        raise KeyboardInterrupt

    monkeypatch.setattr(workers, "run", seen)
    path = tiny_network.spec(tiny, "way")
    assert main.run(["run", str(path), "--out", str(tmp_path / "out")]) == 130
    hops = [(file, name.rpartition(".")[2]) for file, name in listed()]
    begin, end = stack.index(hops[0]), listed().index(("study/sweep/workers.py", "run"))
    assert stack[begin:] == hops[:end]
    assert {file for file, _ in stack[:begin]} == {"cli/main.py"}


@pytest.mark.parametrize("name", ["_serve", "_done"])
def test_the_worker_goes_on(name):
    assert f"{name}(" in inspect.getsource(workers)
