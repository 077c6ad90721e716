"""Files that change while a sweep runs: no run is made with another planner or network."""

import os
import shutil
import sys

import pytest

from deepmf_sumo import spec
from deepmf_sumo.results import stored
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep import batch, inputs, watch
from deepmf_sumo.study.sweep.workers import Worker

from tests.support import tiny_network

CHANGING = """
from pathlib import Path
from deepmf_sumo import plugins
from deepmf_sumo.scene import Command

class Editor:
    class Settings(plugins.Settings):
        edits: str = ""
    model = None
    build = classmethod(lambda cls, settings: cls(settings))
    def __init__(self, settings): self.edits = settings.edits
    def reset(self, case, rng): self.steps = 0
    def act(self, view):
        self.steps += 1
        if self.edits and self.steps == 2:
            with (Path(__file__).parent / self.edits).open("a") as file: file.write(chr(10))
        return Command(kind="sumo")
"""
PROGRAM = """
import json, sys
for line in sys.stdin:
    asked = json.loads(line)
    answer = {"type": "ready", "protocol": 1}
    if asked["type"] == "view":
        answer = {"type": "command", "step": asked["step"], "kind": "sumo"}
    print(json.dumps(answer), flush=True)
open(__file__, "a").write("# edited\\n")
"""


@pytest.fixture
def here(tiny, tmp_path, monkeypatch):
    folder = shutil.copytree(tiny, tmp_path / "here")
    (folder / "changing_planner.py").write_text(CHANGING)
    (folder / "own_program.py").write_text(PROGRAM)
    (folder / "notes.txt").write_text("of the user")
    monkeypatch.syspath_prepend(str(folder))
    sys.modules.pop("changing_planner", None)  # of another test's folder
    yield folder
    sys.modules.pop("changing_planner", None)


def errors(here, tmp_path, planner, *, resume=False):
    paths = [tiny_network.spec(here, f"run {name}", planner=planner) for name in "ab"]
    options = batch.Options(out=tmp_path / "out", jobs=1, resume=resume)
    return [one["error"] for one in batch.run([spec.load(path) for path in paths], options)]


def editor(edits):
    return f"{{name: 'changing_planner:Editor', edits: {edits}}}"


@pytest.mark.sumo
def test_a_run_after_an_edit_of_the_traffic_is_not_made(here, tmp_path):
    first, second = errors(here, tmp_path, editor("tiny.rou.xml"))
    assert first == ""
    assert second.startswith(f"{here / 'tiny.rou.xml'} has changed since the sweep began")
    keys = stored.keys_of(tmp_path / "out")
    (here / "changing_planner.py").write_text(CHANGING.replace("self.steps == 2", "False"))
    assert errors(here, tmp_path, editor("tiny.rou.xml"), resume=True) == ["", ""]
    assert not set(keys.values()) & set(stored.keys_of(tmp_path / "out").values())


@pytest.mark.sumo
def test_a_program_that_is_edited_drives_no_further_run(here, tmp_path):
    first, second = errors(here, tmp_path, "{name: program, file: own_program.py}")
    assert first == ""
    assert second.startswith(f"{here / 'own_program.py'} has changed")


@pytest.mark.sumo
def test_what_a_worker_has_loaded_and_what_no_run_reads_may_change(here, tmp_path):
    for name in ("changing_planner.py", "notes.txt"):
        assert errors(here, tmp_path / name, editor(name)) == ["", ""]


def test_a_new_worker_does_not_load_edited_code(here):
    path = tiny_network.spec(here, "run", planner=editor("''"))
    [task], _ = inputs.fingerprinted(tasks.plan([spec.load(path)], here))
    begun = watch.watched([task], ())
    file = here / "changing_planner.py"
    assert file in [one.path for one in begun]
    assert watch.changed(task, begun) is None
    os.utime(file, (0, 0))
    assert watch.changed(task, begun) is None
    file.write_text(CHANGING + "# edited\n")
    worker = Worker(_NamesChanged(begun), 60.0, None)
    try:
        assert worker.do(task).reason.endswith(f"changed: {file}")
    finally:
        worker.kill()


class _NamesChanged:
    def __init__(self, begun):
        self.begun = begun

    def __call__(self, task):
        raise RuntimeError(f"changed: {watch.changed(task, self.begun)}")
