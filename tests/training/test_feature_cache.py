import errno
import os

import numpy as np
import pytest

from deepmf_sumo.errors import OutputError, ReaderError, RunError
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.training.samples import feature_cache
from deepmf_sumo.training.samples.feature_cache import Data, Features

from tests.support.synthetic import scene

pytestmark = pytest.mark.sumo


def samples(scene):
    """Two small samples a scene that moves; at the top of the module, for other processes."""
    speed = scene.tracks.speed_mps[0, 10]
    if speed > 0:
        yield {"speed": np.float32([speed])}
        yield {"speed": np.float32([-speed])}


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "scenes"
    made.mkdir()
    for number in range(6):
        npz.write(scene(shift=number, av_speed=1.0 + number), made / f"{number}.npz")
    return made


def make(folder, tmp_path, *, jobs=1, lines=None, settings=""):
    report = lines.append if lines is not None else lambda _: None
    data = Data(path=folder, weight=2.0)
    features = Features(kind="tiny", settings=settings, of=samples)
    return feature_cache.open_or_build(features, data, tmp_path / "c", report, jobs)


def test_samples_are_those_of_the_scenes_in_order(folder, tmp_path):
    source = make(folder, tmp_path)
    assert source.arrays["speed"][:4, 0].tolist() == [1.0, -1.0, 2.0, -2.0]
    assert source.scene.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert source.scenes[1] == "crossing-1"
    assert source.weight == 2.0
    assert source.name == "scenes"


def test_several_processes_make_the_same_files(folder, tmp_path):
    make(folder, tmp_path)
    make(folder, tmp_path / "two", jobs=2)
    one, two = sorted((tmp_path / "c").rglob("*")), sorted((tmp_path / "two/c").rglob("*"))
    assert [path.name for path in one] == [path.name for path in two]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(one[1:], two[1:], strict=True))


def test_records_that_cannot_be_used_are_counted_and_named(folder, tmp_path):
    for number in range(4):
        (folder / f"broken-{number}.npz").write_bytes(b"PK\x03\x04 nothing")
    (folder / "notes.txt").write_text("no recording")
    lines = []
    source = make(folder, tmp_path, lines=lines)
    assert len(source.refused) == 5
    assert len(source.scenes) == 6
    assert lines[-1].startswith("scenes: 5 record(s) cannot be used and are left out: broken-0")
    assert lines[-1].endswith("; and 2 more")
    again = []
    make(folder, tmp_path, lines=again)
    assert again == lines[-1:]


def test_a_file_that_cannot_be_read_is_counted_and_read_once_it_can_be(folder, tmp_path):
    gone = tmp_path / "not mounted" / "7.npz"
    (folder / "7.npz").symlink_to(gone)
    source = make(folder, tmp_path)
    assert (len(source.scenes), list(source.refused)) == (6, ["7.npz: record 0"])
    gone.parent.mkdir()
    npz.write(scene(shift=7, av_speed=8.0), gone)
    assert len(make(folder, tmp_path).scenes) == 7


def test_an_empty_folder_is_named(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ReaderError, match="empty contains no files"):
        make(empty, tmp_path)


def test_a_folder_of_broken_records_alone_is_refused_with_a_reason(tmp_path):
    broken = tmp_path / "broken"
    broken.mkdir()
    for number in range(2):
        (broken / f"{number}.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(ReaderError, match=r"No record of .*broken can be used \(.+\)"):
        make(broken, tmp_path)


def test_scenes_without_moving_vehicles_are_refused(tmp_path):
    still = tmp_path / "still"
    still.mkdir()
    npz.write(scene(av_speed=0.0), still / "0.npz")
    with pytest.raises(ReaderError, match=r"None of the 1 scenes of .*still gives a sample"):
        make(still, tmp_path)


def test_an_interrupted_cache_is_resumed(folder, tmp_path, monkeypatch):
    real, read = feature_cache._scenes, []

    def broken(file):
        if file.name == "3.npz":
            raise KeyboardInterrupt
        return real(file)

    monkeypatch.setattr(feature_cache, "_scenes", broken)
    with pytest.raises(KeyboardInterrupt):
        make(folder, tmp_path)
    monkeypatch.setattr(feature_cache, "_scenes", lambda file: read.append(file.name) or real(file))
    source = make(folder, tmp_path)
    assert read == ["3.npz", "4.npz", "5.npz"]
    assert source.arrays["speed"][::2, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert len(list((tmp_path / "c").iterdir())) == 1


def test_changed_recordings_are_read_again_and_the_old_cache_is_mentioned(folder, tmp_path):
    make(folder, tmp_path)
    npz.write(scene(av_speed=9.0), folder / "9.npz")
    lines = []
    assert len(make(folder, tmp_path, lines=lines).scenes) == 7
    assert "contains features of an earlier state of scenes" in lines[0]
    make(folder, tmp_path, lines=lines)
    assert len(list((tmp_path / "c").iterdir())) == 2


def test_a_copy_of_the_recordings_is_the_same_data(folder, tmp_path):
    make(folder, tmp_path)
    for file in folder.iterdir():
        os.utime(file, (1.0, 1.0))
    lines = []
    make(folder, tmp_path, lines=lines)
    assert lines == []
    (folder / "0.npz").write_bytes((folder / "1.npz").read_bytes())
    make(folder, tmp_path, lines=lines)
    assert len(list((tmp_path / "c").iterdir())) == 2


def odd(scene):
    raise ValueError("an odd map")


def test_a_scene_whose_features_fail_is_named(folder, tmp_path):
    with pytest.raises(RunError, match=r"scene crossing-0 of .*0.npz .*ValueError: an odd map"):
        feature_cache.open_or_build(
            Features(kind="tiny", settings="", of=odd), Data(path=folder), tmp_path / "c", print
        )


def test_remains_of_a_killed_process_with_the_same_id_are_no_obstacle(folder, tmp_path):
    source = make(folder, tmp_path)
    (made,) = (tmp_path / "c").iterdir()
    left = tmp_path / "d" / "c" / f"{made.name}.{os.getpid()}"
    left.mkdir(parents=True)
    (left / "speed.bin").write_bytes(b"half")
    again = make(folder, tmp_path / "d")
    assert again.arrays["speed"].tolist() == source.arrays["speed"].tolist()


def test_a_full_disk_is_named(folder, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(feature_cache, "_append", full)
    with pytest.raises(OutputError, match=r"cannot be written to .*No space left"):
        make(folder, tmp_path)
