"""Bad input by the command line: one sentence, the documented code, and nobody else's run lost."""

import csv
import gzip
import math
import os
import pickle
import shutil
import sys
from collections import Counter

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.scene.readers import womd

from tests.support import tiny_network
from tests.support.recordings_by_hand import scenario


def record(message):
    return womd.framed(message.SerializeToString())


def without_lanes():
    message = scenario(name="no-lanes")
    others = [one for one in message.map_features if one.WhichOneof("feature_data") != "lane"]
    del message.map_features[:]
    message.map_features.extend(others)
    return message


def without_av():
    message = scenario(name="no-av")
    for state in message.tracks[2].states:
        state.valid = False
    return message


def with_nan():
    message = scenario(name="nan")
    for step in (30, 31):
        message.tracks[0].states[step].center_x = math.nan
    return message


def unbuildable():
    message = scenario(name="a-point")
    for feature in message.map_features:
        if feature.WhichOneof("feature_data") == "lane":
            points = feature.lane.polyline
            for point in points:
                point.x, point.y = points[0].x, points[0].y
    return message


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """A folder of damaged files, with one good scene after each damage that can be passed."""
    folder = tmp_path_factory.mktemp("recordings")
    wrong = bytearray(record(scenario(name="wrong")))
    wrong[500] ^= 0xFF
    shard = [without_lanes(), without_av(), with_nan(), unbuildable(), scenario(name="good")]
    (folder / "a.tfrecord").write_bytes(b"".join(map(record, shard)))
    (folder / "b.tfrecord").write_bytes(bytes(wrong) + record(scenario(name="after")))
    (folder / "c.tfrecord").write_bytes(record(scenario(name="cut"))[:-3000])
    packed = gzip.compress(record(scenario(name="packed")))
    (folder / "d.tfrecord.gz").write_bytes(packed[:-500])
    (folder / "e.pkl").write_bytes(pickle.dumps({"id": "x", "tracks": Counter("ab")}))
    (folder / "f.txt").write_text("no recording")
    return folder


def rows(out):
    return {
        row["scene"]: row for row in csv.DictReader((out / "runs.csv").read_text().splitlines())
    }


def test_damaged_records_are_rows_and_the_others_run(recordings, tmp_path, capsys):
    spec = tmp_path / "spec.yaml"
    spec.write_text(
        f"version: 1\nname: x\nsource: {{recording: {recordings}}}\nduration_s: 0.5\n"
        "planner: replay\nadversary: none\n"
    )
    out = tmp_path / "out"
    assert main.run(["run", str(spec), "--out", str(out), "--no-pictures"]) == 3
    assert "Traceback" not in "".join(capsys.readouterr())
    found = rows(out)
    assert {name for name, row in found.items() if row["status"] == "ok"} == {
        *("nan", "good", "after")
    }
    reasons = {
        "no-lanes": ("skipped", "a.tfrecord record 0: the record has no lanes"),
        "no-av": ("skipped", "a.tfrecord record 1: the AV (12) has no valid state"),
        "a-point": ("failed", "a.tfrecord: scene a-point has no lane with a length"),
        "b.tfrecord record 0": ("skipped", "the checksum of its content is wrong"),
        "c.tfrecord record 0": ("skipped", "is cut off"),
        "d.tfrecord.gz record 0": ("skipped", "cannot be read"),
        "e": ("skipped", "names 'collections.Counter', which is not plain data"),
    }
    for name, (status, reason) in reasons.items():
        assert found[name]["status"] == status, name
        assert reason in found[name]["error"], name
    assert len(found) == 10


def test_scenes_convert_and_run_agree_on_what_is_no_recording(recordings, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "nil.tfrecord").touch()
    for name, why in (("empty", "There is no scene in"), ("nil.tfrecord", "contains no scene")):
        for more in (["data", "list"], ["data", "convert", "--out", str(tmp_path / "nets")]):
            assert main.run([*more, str(tmp_path / name)]) == 3
            said = " ".join("".join(capsys.readouterr()).split())
            assert why in said
            assert str(tmp_path / name) in said
    assert main.run(["data", "list", str(recordings / "f.txt")]) == 3
    assert "f.txt has an unknown format" in capsys.readouterr().err


def test_a_batch_of_which_nothing_can_be_read_is_no_success(recordings, tmp_path):
    spec = tmp_path / "spec.yaml"
    spec.write_text(
        f"version: 1\nname: x\nsource: {{recording: {recordings / 'c.tfrecord'}}}\n"
        "planner: replay\nadversary: none\n"
    )
    assert main.run(["run", str(spec), "--out", str(tmp_path / "out"), "--no-pictures"]) == 3


def test_configurations_that_do_not_load(tiny, tmp_path, capsys):
    good = (tiny / "tiny.sumocfg").read_text()
    routes = (tiny / "tiny.rou.xml").read_text()
    lost = '<vehicle id="lost" depart="1"><route edges="nowhere"/></vehicle></routes>'
    (tiny / "lost.rou.xml").write_text(routes.replace("</routes>", lost))
    (tiny / "half.net.xml").write_text((tiny / "tiny.net.xml").read_text()[:900])
    begin = '<time><begin value="20"/></time></configuration>'
    variants = {
        "no-net": (good.replace("tiny.net.xml", "none.net.xml"), "none.net.xml"),
        "half-net": (good.replace("tiny.net.xml", "half.net.xml"), "half.net.xml cannot be read"),
        "half-xml": (good[: len(good) // 2], "half-xml.sumocfg' cannot be read"),
        "no-routes": (good.replace("tiny.rou.xml", "none.rou.xml"), "none.rou.xml"),
        "route": (
            good.replace("tiny.rou.xml", "lost.rou.xml"),
            "route.sumocfg': The edge 'nowhere' within the route for vehicle 'lost'",
        ),
        "begin": (good.replace("</configuration>", begin), "begins at 20 s"),
    }
    specs = [tiny_network.spec(tiny, "good")]
    for name, (text, _) in variants.items():
        (tiny / f"{name}.sumocfg").write_text(text)
        source = f"{{network: {name}.sumocfg, start_s: 2.0, av: {{vehicle: av}}}}"
        specs.append(tiny_network.spec(tiny, name, source=source))
    out = tmp_path / "out"
    command = ["run", *map(str, specs), "--out", str(out), "--no-pictures"]
    assert main.run(command) == 3
    assert "Traceback" not in "".join(capsys.readouterr())
    found = rows(out)
    assert found["tiny"]["status"] == "ok"
    for name, (_, reason) in variants.items():
        assert found[name]["status"] == "failed"
        assert reason in found[name]["error"], name


@pytest.mark.parametrize(
    "command",
    [
        ["run", "good.yaml", "--out", "file/out"],
        ["data", "record", "tiny.sumocfg", "--scenes", "1", "--out", "file/out"],
        ["init", "file/out"],
        ["data", "record", "tiny.sumocfg", "--set", "every_s=.nan", "--out", "out"],
    ],
)
def test_where_nothing_can_be_written(tiny, monkeypatch, capsys, command):
    tiny_network.spec(tiny, "good")
    (tiny / "file").write_text("mine")
    monkeypatch.chdir(tiny)
    assert main.run(command) == 2
    shown = capsys.readouterr().err
    assert "file/out" in shown or "every_s" in shown
    assert "Traceback" not in shown
    assert "unexpected" not in shown
    assert not (tiny / "out").exists()


def test_a_trajectory_lies_beside_its_spec(tiny, tmp_path, monkeypatch):
    (tiny / "path.csv").write_text("step,x_m,y_m,heading_rad\n11,62,-4.8,0\n12,63,-4.8,0\n")
    adversary = "{name: trajectory, agent: leader, file: path.csv}"
    spec = tiny_network.spec(tiny, "path", adversary=adversary)
    monkeypatch.chdir(tmp_path)
    assert main.run(["run", str(spec), "--out", "out", "--no-pictures"]) == 0


@pytest.mark.skipif(
    not (shutil.which("xvfb-run") or os.environ.get("DISPLAY")), reason="no display, no xvfb-run"
)
def test_sumo_gui_shows_the_same_episode(tiny, tmp_path):
    import subprocess

    from tests.support import same_bytes

    spec = tiny_network.spec(tiny, "seen")
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", "run", str(spec), "--no-pictures"]
    screen = [] if os.environ.get("DISPLAY") else ["xvfb-run", "-a"]
    for start, name, more in (([], "plain", []), (screen, "gui", ["--set", "sweep.gui=true"])):
        done = subprocess.run(
            [*start, *command, "--out", str(tmp_path / name), *more],
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert same_bytes.differences(tmp_path / "plain", tmp_path / "gui") == []
