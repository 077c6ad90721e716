"""`deepmf-sumo export`, and `--export` of a sweep: what is written, left out and refused."""

import shutil

import numpy as np
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.exporters import scene as scene_format
from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import readers

from tests.support import tiny_network, worth_doubles
from tests.support.result_folders import Folder


def call(*arguments):
    return main.run([str(one) for one in arguments])


@pytest.fixture
def made(tmp_path):
    """Runs of recordings: a contrived hit, a finding, a miss, a failed one, one without tracks."""
    folder = Folder(tmp_path)
    folder.add("one", metrics=worth_doubles.metrics("C"))
    folder.add("two", metrics=worth_doubles.metrics("B"))
    folder.add("three", hit=False)
    folder.fail("four")
    folder.add("five")
    (folder.out / "runs" / "04-five" / "tracks.csv.gz").unlink()
    (folder.out / "manifest.json").write_text('{"runs": {}}')
    return folder.out


def files_below(folder):
    return sorted(str(one.relative_to(folder)) for one in folder.rglob("*") if one.is_file())


def test_each_run_is_written_beside_its_tracks_and_the_rest_is_counted(made, capsys):
    assert call("export", made, "--to", "scene") == 0
    said = capsys.readouterr().out.splitlines()
    assert said == [
        "scene: 3 of 5 runs written",
        f"{made}/runs/00-one/scene.npz and 2 more",
        "left out: 1 run: it has no result (failed): 03-four",
        "left out: 1 run: it has no tracks.csv.gz: 04-five",
    ]
    [scene] = readers.scenes([made / "runs" / "00-one" / "scene.npz"])
    run = Results.open(made).runs[0]
    tracks = run.rollout.tracks
    assert scene.tracks.ids == tracks.ids
    assert np.abs(scene.tracks.position_m[:, : tracks.steps] - tracks.position_m).max() < 1e-6
    assert scene.source.dataset == "rollout"
    assert scene.road.lanes.keys() == run.road()[0].lanes.keys()


@pytest.mark.parametrize(
    ("only", "ids"), [("hits", ["00-one", "01-two"]), ("findings", ["01-two"])]
)
def test_failures_alone_below_another_folder(made, tmp_path, only, ids, capsys):
    place = tmp_path / "elsewhere"
    before = files_below(made)
    assert call("export", made, "--to", "scene", "--only", only, "--out", place) == 0
    assert files_below(place) == [f"runs/{one}/scene.npz" for one in ids]
    assert files_below(made) == before
    assert f"scene: {len(ids)} of 5 runs written" in capsys.readouterr().out


def test_one_run_and_several_folders(made, tmp_path):
    place = tmp_path / "elsewhere"
    assert call("export", made / "runs" / "01-two", "--to", "scene", "--out", place) == 0
    assert files_below(place) == ["01-two/scene.npz"]
    other = shutil.copytree(made, tmp_path / "other")
    assert call("export", made, other, "--to", "scene", "--only", "findings", "--out", place) == 0
    assert files_below(place)[1:] == ["other/runs/01-two/scene.npz", "out/runs/01-two/scene.npz"]


def test_nothing_is_replaced_without_being_asked_to(made, capsys):
    file = made / "runs" / "01-two" / "scene.npz"
    file.write_text("mine")
    assert call("export", made, "--to", "scene") == 2
    assert f"{file} is there already (1 of 5 runs)" in capsys.readouterr().err
    assert not (made / "runs" / "00-one" / "scene.npz").exists()
    assert call("export", made, "--to", "scene", "--overwrite") == 0
    first = file.read_bytes()
    assert call("export", made, "--to", "scene", "--overwrite") == 0
    assert file.read_bytes() == first != b"mine"


def test_a_run_that_cannot_be_written_does_not_lose_the_others(made, capsys):
    (made / "runs" / "00-one" / "tracks.csv.gz").write_bytes(b"cut")
    (made / "runs" / "01-two" / "result.json").write_text("{}")
    assert call("export", made, "--to", "scene") == 3
    said = capsys.readouterr()
    assert "scene: 1 of 5 runs written" in said.out
    assert "failed: 1 run: " in said.err
    assert "00-one cannot be exported" in said.err
    assert "01-two/result.json" in said.err
    assert not list(made.rglob(".*part*"))


@pytest.mark.parametrize("to", ["scene", "fcd"])
def test_a_failed_export_leaves_nothing(made, tmp_path, to, capsys):
    tracks = made / "runs" / "00-one" / "tracks.csv.gz"
    tracks.write_bytes(tracks.read_bytes()[:60])
    assert call("export", made, "--to", to, "--out", tmp_path / "elsewhere") == 3
    assert "00-one cannot be exported" in capsys.readouterr().err
    assert not (tmp_path / "elsewhere" / "runs" / "00-one").exists()
    assert not [
        one for one in (tmp_path / "elsewhere").rglob("*") if one.is_dir() and not [*one.iterdir()]
    ]


def test_a_run_whose_recording_and_network_are_gone_fails(made, capsys):
    for file in made.parent.glob("*.npz"):
        file.unlink()
    assert call("export", made, "--to", "scene", "--only", "findings") == 3
    assert "holds no net.net.xml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--to", "scenes"), "No plug-in 'scenes' in exporters. Did you mean 'scene'?"),
        (("--to", "scene", "--set", "digits=3"), "unknown key 'digits'"),
        (("--to", "scene", "--set", "digits"), "must be key=value"),
        (("--to", "scene", "--only", "misses"), "misses"),
        (("--to", "scene", "--set", "without_av=true"), "without_av"),
        (("--to", "geopackage", "--only", "hits"), "one map of all runs; it takes --out alone"),
        ((), "--to"),
    ],
)
def test_what_is_wrong_is_refused_before_anything_is_written(made, arguments, words, capsys):
    before = files_below(made)
    assert call("export", made, *arguments) == 2
    assert words in capsys.readouterr().err
    assert files_below(made) == before


def test_what_is_no_result_folder_is_refused(tmp_path, capsys):
    assert call("export", tmp_path, "--to", "scene") == 2
    assert "is not a result folder" in capsys.readouterr().err


@pytest.mark.sumo
def test_a_sweep_writes_what_export_would(tiny, tmp_path, capsys, monkeypatch):
    out, place = tmp_path / "out", tmp_path / "place"
    specs = [tiny_network.spec(tiny, f"part {n}", seed=str(n), duration_s="0.5") for n in (0, 1)]
    arguments = ("run", *specs, "--no-pictures", "--out", out, "--export", "scene")
    assert call(*arguments, "--export", "fcd", "--export", "scene") == 0
    said = capsys.readouterr().out
    assert "scene: 2 of 2 runs written" in said
    assert "fcd: 2 of 2 runs written" in said
    assert call("export", out, "--to", "scene", "--out", place) == 0
    for run_id in stored.keys_of(out):
        first = (out / "runs" / run_id / "scene.npz").read_bytes()
        assert (place / "runs" / run_id / "scene.npz").read_bytes() == first
        (out / "runs" / run_id / "scene.npz").unlink()

    def refused(*_):
        raise RuntimeError("no room")

    monkeypatch.setattr(scene_format, "write", refused)
    assert call(*arguments, "--resume") == 3
    said = capsys.readouterr()
    assert "scene: 0 of 2 runs written" in said.out
    assert said.err.count("is not written as scene") == 2
    monkeypatch.undo()
    assert call(*arguments, "--resume") == 0


@pytest.mark.sumo
def test_a_sweep_begins_with_formats_that_exist(tiny, tmp_path, capsys):
    path = tiny_network.spec(tiny, "never")
    assert call("run", path, "--out", tmp_path / "out", "--export", "xosc") == 2
    assert "No plug-in 'xosc' in exporters" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
