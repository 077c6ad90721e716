import errno
import json
import os

import pytest

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import PluginError, ReaderError, UsageError
from deepmf_sumo.scene import readers
from deepmf_sumo.scene.readers import Refusal, womd
from deepmf_sumo.scene.readers.base import Reader

from tests.support import recordings_by_hand as by_hand


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    (folder / "deep" / ".hidden").mkdir(parents=True)
    by_hand.shard(folder / "b.tfrecord", *(by_hand.scenario(name=name) for name in "xyz"))
    (folder / "deep" / "a.json").write_text(
        json.dumps(by_hand.gpudrive(by_hand.scenario(name="g")))
    )
    (folder / "deep" / ".hidden" / "c.tfrecord").write_text("hidden")
    (folder / "README").write_text("no recording")
    return folder


def names(found):
    return [one.name for one in found if not isinstance(one, Refusal)]


def test_files_of_folders_are_found_sorted_and_once(data):
    found = readers.find([data / "b.tfrecord", data])
    assert [file.name for file in found] == ["b.tfrecord", "README", "a.json"]


def test_a_path_that_does_not_exist_is_an_error_at_once(data):
    with pytest.raises(UsageError, match="nowhere does not exist"):
        readers.scenes([data, data / "nowhere"])


@pytest.mark.sumo
def test_scenes_of_all_formats_and_a_refusal_for_what_is_none(data):
    found = list(readers.scenes([data]))
    assert names(found) == ["x", "y", "z", "g"]
    (refusal,) = [one for one in found if isinstance(one, Refusal)]
    assert refusal.file.endswith("README")
    assert (
        "unknown format; known are argoverse2, gpudrive, npz, scenarionet, womd" in refusal.reason
    )


@pytest.mark.sumo
def test_the_only_file_must_be_a_recording(data):
    with pytest.raises(ReaderError, match="has an unknown format"):
        readers.scenes([data / "README"])


@pytest.mark.sumo
def test_scenes_come_one_at_a_time(tmp_path, monkeypatch):
    read = tmp_path / "read"
    original = womd.records

    def watched(path):
        for record in original(path):
            with read.open("a") as noted:
                noted.write(f"{record.index}\n")
            yield record

    monkeypatch.setattr(womd, "records", watched)
    shard = by_hand.shard(tmp_path / "b.tfrecord", *([by_hand.scenario()] * 50))
    stream = readers.scenes([shard])
    next(stream)
    assert len(read.read_text().split()) < 10  # those that fit into the pipe
    stream.close()


@pytest.mark.sumo
def test_ids_and_scenes_by_id(data, tmp_path):
    assert readers.ids(data) == ["x", "y", "z", "g"]
    for cache in (None, tmp_path / "cache"):
        assert readers.scene(data / "b.tfrecord", "z", cache).source.record == 2
        assert readers.scene(data, "g", cache).name == "g"
    with pytest.raises(ReaderError, match="has no scene 'w'"):
        readers.scene(data, "w")


@pytest.mark.sumo
def test_a_scene_by_id_is_found_again_without_a_search(data, tmp_path, monkeypatch):
    file, cache = data / "b.tfrecord", tmp_path / "cache"
    first = readers.scene(file, "y", cache)
    monkeypatch.setattr(womd, "recordings", lambda path: pytest.fail("searched again"))
    again = readers.scene(file, "y", cache)
    assert again.source == first.source


@pytest.mark.sumo
def test_a_listed_scene_is_read_without_a_search(data, tmp_path, monkeypatch):
    refs = list(readers.records(data, tmp_path / "cache"))
    assert [(ref.name, ref.record, ref.reader) for ref in refs] == [
        ("x", 0, "womd"),
        ("y", 1, "womd"),
        ("z", 2, "womd"),
        ("g", 0, "gpudrive"),
    ]
    assert refs == list(readers.records(data, tmp_path / "cache")) == list(readers.records(data))
    assert all(ref.content is None for ref in refs)  # a scene is not sent to be thrown away
    for search in ("find", "_recordings", "_records"):
        monkeypatch.setattr(readers, search, lambda *_: pytest.fail("searched again"))
    monkeypatch.setattr(womd, "recordings", lambda path: pytest.fail("read the others"))
    assert [readers.read(ref).name for ref in refs] == ["x", "y", "z", "g"]


@pytest.mark.sumo
def test_a_file_that_changed_after_it_was_listed_is_an_error(tmp_path):
    file = by_hand.shard(tmp_path / "one.tfrecord", *(by_hand.scenario(name=one) for one in "xy"))
    first, second = readers.records(file)
    by_hand.shard(file, by_hand.scenario(name="z"))
    with pytest.raises(ReaderError, match="no longer has the scene 'x' as record 0"):
        readers.read(first)
    with pytest.raises(ReaderError, match="the file ends before it"):
        readers.read(second)


@pytest.mark.sumo
def test_an_index_of_a_plug_in_that_is_not_there_is_made_again(data, tmp_path):
    file, cache = data / "b.tfrecord", tmp_path / "cache"
    expected = list(readers.records(file, cache))
    (entry,) = (cache / "index").iterdir()
    entry.write_text(entry.read_text().replace('"womd"', '"gone"'))
    assert list(readers.records(file, cache)) == expected


@pytest.mark.sumo
def test_a_changed_file_and_a_damaged_index_are_searched_again(data, tmp_path):
    file, cache = data / "b.tfrecord", tmp_path / "cache"
    assert readers.ids(file, cache) == ["x", "y", "z"]
    by_hand.shard(file, by_hand.scenario(name="new"))
    os.utime(file, (1, 1))
    assert readers.ids(file, cache) == ["new"]
    for entry in (cache / "index").iterdir():
        entry.write_text("{")
    assert readers.scene(file, "new", cache).name == "new"


@pytest.mark.sumo
def test_an_index_that_cannot_be_written_hides_no_scene(data, tmp_path):
    expected = list(readers.records(data))
    file = tmp_path / "a file, in which no folder can be made"
    file.write_text("")
    folder = tmp_path / "cache"
    folder.mkdir()
    (folder / "index").write_text("not a folder either")
    for cache in (file, folder):
        assert list(readers.records(data, cache)) == expected
        assert readers.ids(data / "b.tfrecord", cache) == ["x", "y", "z"]
        assert readers.scene(data, "y", cache).name == "y"


@pytest.mark.sumo
def test_an_index_that_cannot_be_completed_leaves_no_part(data, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    assert readers.ids(data / "b.tfrecord", tmp_path / "cache") == ["x", "y", "z"]
    assert list((tmp_path / "cache" / "index").iterdir()) == []


@pytest.mark.sumo
def test_a_refused_scene_asked_for_by_id_is_an_error_with_the_reason(tmp_path):
    message = by_hand.scenario(name="bad")
    del message.map_features[:]
    file = by_hand.shard(tmp_path / "one.tfrecord", message)
    assert readers.ids(file) == ["bad"]
    with pytest.raises(ReaderError, match="no lanes"):
        readers.scene(file, "bad")


class Failing:
    """A file on a disk that fails after some bytes."""

    def __init__(self, file, after):
        self.file, self.left = file, after

    def read(self, count=-1):
        if count < 0 or count > self.left:
            raise OSError(errno.EIO, "Input/output error")
        self.left -= count
        return self.file.read(count)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()

    def __getattr__(self, name):
        return getattr(self.file, name)


def fails(monkeypatch, name, *, after):
    """The file of this name cannot be opened (``after`` is None), or not read farther."""
    opened = readers.files.opened

    def failing(path):
        if path.name == name and after is None:
            raise OSError(errno.EIO, "Input/output error", str(path))
        return Failing(opened(path), after) if path.name == name else opened(path)

    monkeypatch.setattr(readers.files, "opened", failing)


@pytest.mark.sumo
@pytest.mark.parametrize("after", [None, 0, 2000])
def test_a_file_that_cannot_be_read_keeps_its_place_in_a_folder(data, tmp_path, monkeypatch, after):
    by_hand.shard(data / "c.tfrecord", *(by_hand.scenario(name=name) for name in "uvw"))
    fails(monkeypatch, "c.tfrecord", after=after)
    for cache in (None, tmp_path / "cache", tmp_path / "cache"):
        *good, lost, g = readers.records(data, cache)
        assert [ref.name for ref in (*good, g)] == ["x", "y", "z", "g"]
        assert lost.name == "c.tfrecord record 0"
        with pytest.raises(ReaderError, match=r"c.tfrecord.*Input/output error"):
            readers.read(lost)


@pytest.mark.sumo
def test_a_file_whose_start_cannot_be_read_is_not_of_another_format(data, monkeypatch):
    by_hand.shard(data / "c", by_hand.scenario(name="u"))  # known by its content alone
    fails(monkeypatch, "c", after=0)
    names = [ref.name for ref in readers.records(data)]
    assert names == ["x", "y", "z", "c record 0", "g"]


@pytest.mark.sumo
def test_the_only_file_that_cannot_be_read_is_an_error(data, monkeypatch):
    fails(monkeypatch, "b.tfrecord", after=None)
    with pytest.raises(ReaderError, match=r"b.tfrecord cannot be read: Input/output error"):
        readers.ids(data / "b.tfrecord")


@pytest.mark.sumo
@pytest.mark.parametrize("name", ["s.tfrecord", "s.json", "s.pkl", "s.npz"])
@pytest.mark.parametrize("content", [b"", b'{"name": "cut off', b"\x00" * 40])
def test_what_is_left_of_a_recording_keeps_its_place_in_a_folder(data, name, content):
    (data / name).write_bytes(content)
    refs = [ref for ref in readers.records(data) if ref.file.name == name]
    refusals = [one for one in readers.scenes([data]) if isinstance(one, Refusal)]
    (refusal,) = [one for one in refusals if one.file.endswith(name)]
    assert len(refs) == 1
    assert refusal.reason
    with pytest.raises(ReaderError, match=name):
        readers.read(refs[0])


@pytest.mark.sumo
def test_a_link_to_nowhere_keeps_its_place_in_a_folder(data):
    (data / "c.tfrecord").symlink_to(data / "unmounted" / "c.tfrecord")
    lost = [ref for ref in readers.records(data) if ref.file.name == "c.tfrecord"]
    assert [ref.name for ref in lost] == ["c.tfrecord record 0"]
    with pytest.raises(ReaderError, match=r"c.tfrecord cannot be read: No such file"):
        readers.read(lost[0])


@pytest.mark.sumo
def test_json_that_is_no_recording_is_left_out(data):
    (data / "package.json").write_text('{"name": "another program"}')
    assert readers.ids(data) == ["x", "y", "z", "g"]


def test_a_folder_of_scenarionet_is_found_without_its_overviews(data):
    for name in ("dataset_summary.pkl", "dataset_mapping.pkl", "sd_1.pkl"):
        (data / "deep" / name).touch()
    found = [file.name for file in readers.find([data])]
    assert found == ["README", "b.tfrecord", "a.json", "sd_1.pkl"]
    overview = data / "deep" / "dataset_summary.pkl"
    assert readers.find([overview]) == [overview]


@pytest.mark.parametrize("name", plugins.names("readers"))
def test_every_reader_keeps_the_contract(name, tmp_path):
    reader: Reader = plugins.load("readers", name)
    for content in (b"", b"x", b"\x00" * 64):
        file = tmp_path / "noise.bin"
        file.write_bytes(content)
        assert list(reader.recordings(file)) == []
    assert list(reader.recordings(tmp_path / "missing")) == []
    assert list(reader.recordings(tmp_path)) == []


class OldReader:
    def accepts(self, path):
        return True

    def scenes(self, path):
        yield None


def test_a_reader_of_the_old_contract_is_refused_with_a_sentence(data, monkeypatch):
    load = plugins.load
    monkeypatch.setattr(plugins, "names", lambda kind: ["old", "womd"])
    monkeypatch.setattr(
        plugins, "load", lambda kind, name: OldReader if name == "old" else load(kind, name)
    )
    with pytest.raises(PluginError, match="Reader 'old' has no 'recordings'; a reader has"):
        readers.ids(data)


def test_a_folder_of_results_gives_the_scenes_of_its_runs_alone(tmp_path):
    study = tmp_path / "attacks" / "lane"
    for name in ("one", "two"):
        run = study / "runs" / name
        run.mkdir(parents=True)
        for file in ("scene.npz", "plans.npz", "result.json"):
            (run / file).touch()
    (study / "runs" / "without").mkdir()
    (study / "runs.csv").touch()
    (tmp_path / "attacks" / "mine.npz").touch()
    found = [path.relative_to(tmp_path).as_posix() for path in readers.find([tmp_path])]
    assert found == [
        "attacks/lane/runs/one/scene.npz",
        "attacks/lane/runs/two/scene.npz",
        "attacks/mine.npz",
    ]
