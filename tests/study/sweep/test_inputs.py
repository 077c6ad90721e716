"""What runs read, told from what else lies beside it."""

import shutil
import sys
from importlib import metadata

import pytest

from deepmf_sumo import plugins, spec
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep.inputs import fingerprinted

from tests.support import tiny_network

pytestmark = pytest.mark.sumo


def read(path, sets=()):
    (task,), inputs = fingerprinted(tasks.plan([spec.load(path, sets)], path.parent))
    return task.inputs, {one.path.name for one in inputs}


def test_content_counts_and_neither_place_nor_neighbours(tiny, tmp_path):
    path = tiny_network.spec(tiny, "one")
    first, names = read(path)
    assert {"tiny.sumocfg", "tiny.net.xml", "tiny.rou.xml"} <= names
    copy = shutil.copytree(path.parent, tmp_path / "copy")
    (copy / "notes.txt").write_text("beside it")
    assert read(copy / path.name)[0] == first
    (copy / "tiny.net.xml").write_text((copy / "tiny.net.xml").read_text() + "<!-- x -->")
    assert read(copy / path.name)[0] != first


def test_weights_count_but_not_their_curves(tiny, tmp_path):
    weights = tmp_path / "mine"
    weights.mkdir()
    (weights / "marginal.safetensors").write_bytes(b"1")
    path = tiny_network.spec(tiny, "one")

    def key():
        return read(path, [f"weights={weights}"])[0]

    first = key()
    (weights / "card.md").write_text("about them")
    assert key() == first
    (weights / "marginal.safetensors").write_bytes(b"2")
    assert key() != first


@pytest.mark.parametrize("kind", ["json", "onnx", "safetensors"])
def test_every_kind_of_weights_counts(tiny, tmp_path, kind):
    """The light installation has graphs (.onnx) alone."""
    weights = tmp_path / "mine"
    weights.mkdir()
    (weights / f"marginal.{kind}").write_bytes(b"1")
    path = tiny_network.spec(tiny, "one")
    sets = [f"weights={weights}"]
    first, names = read(path, sets)
    assert f"marginal.{kind}" in names
    (weights / f"marginal.{kind}").write_bytes(b"2")
    second, _ = read(path, sets)
    assert dict(first).keys() == {"source", "weights"}
    assert dict(first)["source"] == dict(second)["source"]
    assert dict(first)["weights"] != dict(second)["weights"]


PLANNERS = {
    "a class": "{name: mine_planner:Mine}",
    "apart": "{name: isolated, planner: mine_planner:Mine}",
    "a program": "{name: program, file: FOLDER/mine_planner.py}",
    "a command": "{name: program, command: [python3, FOLDER/mine_planner.py]}",
}


@pytest.mark.parametrize("planner", PLANNERS)
def test_what_a_planner_imports_counts_however_it_is_started(tiny, tmp_path, monkeypatch, planner):
    for name in ("mine_helper", "mine_planner"):  # of another test's folder
        sys.modules.pop(name, None)
    (tmp_path / "mine_helper.py").write_text("CRUISE = 12")
    (tmp_path / "mine_planner.py").write_text(
        "from deepmf_sumo.planners.idm import Settings, build as base\n"
        "import mine_helper\n"
        "class Mine:\n    Settings = Settings\n    build = staticmethod(base)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    path = tiny_network.spec(tiny, "one")
    sets = [f"planner={PLANNERS[planner].replace('FOLDER', str(tmp_path))}"]
    first, names = read(path, sets)
    assert {"mine_planner.py", "mine_helper.py"} <= names
    (tmp_path / "mine_helper.py").write_text("CRUISE = 1")
    second, _ = read(path, sets)
    assert {use for use in dict(first) if dict(first)[use] != dict(second)[use]} == {"planner"}


def test_code_of_installed_plug_ins_counts(tiny, tmp_path, monkeypatch):
    """A metric is measured in each run; an adversary is named by the spec."""
    (tmp_path / "mine_plugin.py").write_text(
        "from deepmf_sumo.attacks.none import Settings, build\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    known = plugins._entry_points

    def points(kind):
        point = metadata.EntryPoint("mine", "mine_plugin", f"deepmf_sumo.{kind}")
        return (*known(kind), *([point] if kind in {"adversaries", "metrics"} else []))

    monkeypatch.setattr(plugins, "_entry_points", points)
    path = tiny_network.spec(tiny, "one")
    first, names = read(path, ["adversary=mine"])
    assert "mine_plugin.py" in names
    with (tmp_path / "mine_plugin.py").open("a") as file:
        file.write("# another\n")
    second, _ = read(path, ["adversary=mine"])
    changed = {use for use in dict(first) if dict(first)[use] != dict(second)[use]}
    assert changed == {"adversary", "others"}


def test_the_table_that_an_opponent_drives_counts(tiny, tmp_path):
    table = tmp_path / "drive.csv"
    table.write_text("step,x_m,y_m,heading_rad\n0,0,0,0\n")
    path = tiny_network.spec(tiny, "one")
    sets = ["adversary={name: trajectory, agent: other}", f"adversary.file={table}"]
    first, names = read(path, sets)
    assert "drive.csv" in names
    table.write_text("step,x_m,y_m,heading_rad\n0,1,0,0\n")
    assert read(path, sets)[0] != first


def test_files_count_however_sumo_is_told_of_them(tiny, tmp_path, monkeypatch):
    monkeypatch.setenv("DEMAND", "more")
    monkeypatch.chdir(tmp_path)
    folder = shutil.copytree(tiny, tmp_path / "copy")
    (folder / "more.rou.xml").write_text("<routes/>")
    (folder / "sumo.log").write_text("of an earlier run")
    (folder / "saved.xml").write_text("<snapshot/>")
    (tmp_path / "stops.add.xml").write_text("<additional/>")
    config = folder / "tiny.sumocfg"
    more = '<route-files value="${DEMAND}.rou.xml"/><load-state value="saved.xml"/>'
    written = '<log-file value="sumo.log"/>'
    config.write_text(
        config.read_text().replace("</configuration>", f"{more}{written}</configuration>")
    )
    path = tiny_network.spec(folder, "one")
    _, names = read(path, ["source.sumo_options=[--additional-files=stops.add.xml]"])
    assert {"more.rou.xml", "saved.xml", "stops.add.xml"} <= names
    assert "sumo.log" not in names
    assert "stops.add.xml" in read(path, ["source.sumo_options=[-a, stops.add.xml]"])[1]
    assert "stops.add.xml" not in read(path, ["source.sumo_options=[stops.add.xml]"])[1]


def test_a_run_is_the_same_wherever_its_files_lie(tiny, tmp_path):
    def key(folder):
        weights = folder / "mine"
        weights.mkdir(exist_ok=True)
        (weights / "marginal.safetensors").write_bytes(b"1")
        path = tiny_network.spec(folder, "one")
        (task,), _ = fingerprinted(tasks.plan([spec.load(path, [f"weights={weights}"])], tmp_path))
        return task.key

    moved = shutil.copytree(tiny, tmp_path / "moved")
    assert key(moved) == key(tiny)
    (moved / "tiny.rou.xml").write_text((moved / "tiny.rou.xml").read_text() + "<!-- x -->")
    assert key(moved) != key(tiny)
