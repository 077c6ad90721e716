"""``deepmf-sumo data record``: many networks, given and generated."""

import json
from pathlib import Path

import pytest

from deepmf_sumo.cli import data, main
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene.readers import npz, read_by
from deepmf_sumo.study.sweep import workers
from deepmf_sumo.training import generated
from deepmf_sumo.training.recording import many

GENERATE = ["--generate", "junctions", "--scenes", "3", "--set", "avs=2", "--set", "start_s=15"]


def contents(folder):
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*.npz")
        if file.is_file()
    }


def test_kinds_are_those_of_the_generator():
    assert data.KINDS == generated.KINDS


def test_the_same_files_whatever_the_jobs_and_a_cut_off_command_goes_on(tmp_path, capsys):
    one, two = tmp_path / "one", tmp_path / "two"
    command = ["data", "record", *GENERATE, "--networks", "2", "--seed", "3"]
    assert main.run([*command, "--out", str(one)]) == 0
    assert "6 scenes of 2 networks" in capsys.readouterr().out
    assert main.run([*command, "--out", str(two), "--jobs", "2"]) == 0
    files = contents(one)
    assert len(files) == 6
    assert contents(two) == files
    scenes = [scene for file in sorted(one.rglob("*.npz")) for scene in read_by(npz, file)]
    assert [scene.tracks.steps for scene in scenes] == [91] * 6
    assert len({(scene.name, scene.source.sha256) for scene in scenes}) == 6

    lost = two / "junctions-3-001"
    for file in lost.iterdir():
        file.unlink()
    lost.rmdir()
    assert main.run([*command, "--out", str(two)]) == 0
    assert contents(two) == files
    assert main.run([*command, "--set", "every_s=20", "--out", str(two)]) == 2
    assert "another command" in capsys.readouterr().err
    assert contents(two) == files


def here(work, tasks, *, jobs, timeout_s):  # as `workers.run`, in this process
    for index, task in enumerate(tasks):
        try:
            work(task)
        except Exception as error:  # noqa: BLE001
            yield workers.Finished(index=index, status="raised", reason=str(error))
        else:
            yield workers.Finished(index=index, status="done")


def test_a_network_that_fails_is_skipped_counted_and_named(tmp_path, monkeypatch, capsys):
    make = generated.generate

    def generate(kind, seed, number, folder):
        if number == 1:
            raise ConversionError("netgenerate failed: Error: no")
        return make(kind, seed, number, folder)

    monkeypatch.setattr(generated, "generate", generate)
    monkeypatch.setattr(workers, "run", here)
    command = [
        "data",
        "record",
        *GENERATE,
        "--networks",
        "2",
        "--seed",
        "3",
        "--out",
        str(tmp_path / "o"),
    ]
    assert main.run(command) == 0
    shown = capsys.readouterr().out
    assert "junctions-3-001: 0 scenes (netgenerate failed: Error: no)" in shown
    assert "3 scenes of 1 networks" in shown
    assert "1 skipped: junctions-3-001" in shown
    assert not list((tmp_path / "o").glob(".junctions*"))


def test_a_configuration_that_gives_nothing_is_an_error(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(workers, "run", here)
    broken = tmp_path / "broken.sumocfg"
    broken.write_text("<configuration><input/></configuration>")
    assert main.run(["data", "record", str(broken), "--out", str(tmp_path / "out")]) == 3
    shown = capsys.readouterr()
    assert "broken-0 gave no scene" in shown.err
    assert "names no network" in shown.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--generate", "moebius"], "moebius"),
        (["--generate", "grid", "--networks", "0"], "--networks"),
        (["--generate", "grid", "--jobs", "0"], "--jobs"),
        (["--generate", "grid", "--set", "avs=-1"], "avs"),
        (["--generate", "grid", "--set", "start_s=.inf"], "start_s"),
        (["missing.sumocfg"], "missing.sumocfg"),
        ([], "nothing to record"),
    ],
)
def test_bad_arguments(tmp_path, capsys, arguments, said):
    out = tmp_path / "out"
    assert main.run(["data", "record", *arguments, "--out", str(out)]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_folders_that_are_not_for_it(tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    assert main.run(["data", "record", *GENERATE, "--out", str(mine)]) == 2
    assert "not empty" in capsys.readouterr().err
    (mine / many.MANIFEST).write_text("{")
    assert main.run(["data", "record", *GENERATE, "--out", str(mine)]) == 2
    assert sorted(file.name for file in mine.iterdir()) == [many.MANIFEST, "letter.txt"]


def test_two_configurations_of_one_name(tmp_path, capsys):
    files = []
    for folder in ("a", "b"):
        file = tmp_path / folder / "net.sumocfg"
        file.parent.mkdir()
        file.write_text("<configuration/>")
        files.append(str(file))
    assert main.run(["data", "record", *files, "--out", str(tmp_path / "out")]) == 2
    assert "net-0" in capsys.readouterr().err
    assert not Path(tmp_path / "out").exists()


def test_the_manifest_says_what_was_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "run", here)
    out = tmp_path / "out"
    assert main.run(["data", "record", *GENERATE, "--networks", "1", "--out", str(out)]) == 0
    described = json.loads((out / many.MANIFEST).read_text())
    assert (described["kind"], described["networks"], described["scenes"]) == ("junctions", 1, 3)
