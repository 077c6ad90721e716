"""Files that take too much, or end their process: a row each, and the rest goes on."""

import gzip
import json
import os
import pickle
import resource
import signal
import time

import numpy as np
import pytest

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import readers
from deepmf_sumo.scene.readers import Refusal, _bounded, gpudrive, womd
from deepmf_sumo.scene.readers.protos import scenario_pb2 as pb

from tests.support import recordings_by_hand as by_hand

pytestmark = pytest.mark.sumo


def forever():
    yield 1
    while True:
        pass


def large():
    yield 1
    yield len(b"x" * (_bounded.MEMORY_MB + 64) * 2**20)


def crash():
    yield 1
    os.kill(os.getpid(), signal.SIGTERM)


def mistake():
    yield 1
    raise TypeError("x")


def refuse():
    yield 1
    raise ReaderError("no lanes")


def test_an_interrupt_as_the_process_is_reaped_is_passed_on(monkeypatch):
    reap = os.waitpid

    def reap_and_interrupt(pid, options):
        reap(pid, options)
        raise KeyboardInterrupt

    found = _bounded.each(crash)
    assert next(found) == 1
    monkeypatch.setattr(os, "waitpid", reap_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        next(found)


@pytest.mark.parametrize(
    ("work", "reason"),
    [
        (large, "more than 384 MB"),
        (crash, "ended the process .SIG"),
        (mistake, "unexpected TypeError: x"),
        (refuse, "no lanes"),
    ],
)
def test_what_came_before_is_kept_and_the_rest_is_one_error(work, reason):
    found = _bounded.each(work)
    assert next(found) == 1
    with pytest.raises(ReaderError, match=reason) as caught:
        next(found)
    assert isinstance(caught.value, _bounded.EndedError) == (work is not refuse)


def test_reading_without_end_is_ended(monkeypatch):
    # The limit is short here alone: other tests' work may take that long on a slow machine.
    monkeypatch.setattr(_bounded, "CPU_S", 0.3)
    found = _bounded.each(forever)
    assert next(found) == 1
    with pytest.raises(_bounded.EndedError, match="more than 4 s of CPU time"):
        next(found)


def test_arrays_come_back_read_only():
    array = np.arange(5.0)
    array.setflags(write=False)
    (back,) = _bounded.each(lambda: iter([array]))
    assert np.array_equal(back, array)
    assert not back.flags.writeable


def test_closing_ends_the_process():
    def told():
        yield os.getpid()
        time.sleep(60)
        yield 0

    found = _bounded.each(told)
    pid = next(found)
    found.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.fixture
def folder(tmp_path):
    """Good scenes, and a file between them whose reading ends the process."""
    by_hand.shard(tmp_path / "a.tfrecord", by_hand.scenario(name="a"))
    (tmp_path / "b.json").write_text(json.dumps(by_hand.gpudrive(by_hand.scenario(name="b"))))
    by_hand.shard(tmp_path / "c.tfrecord", by_hand.scenario(name="c"))
    return tmp_path


def test_one_file_ends_neither_a_listing_nor_a_sweep(folder, monkeypatch):
    recordings = gpudrive.recordings

    def ending(root):
        return os.kill(os.getpid(), signal.SIGKILL) if root.name == "b.json" else recordings(root)

    monkeypatch.setattr(gpudrive, "recordings", ending)
    first, bad, last = readers.scenes([folder])
    assert (first.name, last.name) == ("a", "c")
    assert isinstance(bad, Refusal)
    assert bad.file == str(folder / "b.json")
    assert "b.json: reading it ended the process" in bad.reason
    cache = folder / ".cache"
    assert readers.ids(folder, cache) == ["a", "b.json record 0", "c"]
    assert readers.scene(folder, "c", cache).name == "c"
    with pytest.raises(ReaderError, match=r"b\.json: reading it ended the process"):
        readers.scene(folder, "b.json record 0", cache)


def test_a_scene_whose_reading_ends_the_process_is_listed(folder, monkeypatch):
    monkeypatch.setattr(gpudrive, "load", lambda _: os.kill(os.getpid(), signal.SIGKILL))
    assert readers.ids(folder) == ["a", "b", "c"]
    with pytest.raises(ReaderError, match=r"b\.json: reading it ended the process"):
        readers.scene(folder, "b")


def peak_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def empty_states(count):
    message = pb.Scenario(scenario_id="x", tracks=[pb.Track(id=1)])
    states = b"\x1a\x00" * count  # field 3 of a track: states
    track = b"\x08\x01" + states
    size, length = len(track), b""
    while size > 127:
        length, size = length + bytes([size & 127 | 128]), size >> 7
    del message.tracks[:]
    return message.SerializeToString() + b"\x12" + length + bytes([size]) + track


@pytest.mark.parametrize("count", [3_000_000, 12_000_000])
def test_some_kilobytes_that_become_gigabytes_are_a_refusal(count, tmp_path):
    file = tmp_path / "x.tfrecord.gz"
    good = by_hand.scenario(name="after").SerializeToString()
    content = womd.framed(empty_states(count)) + womd.framed(good)
    file.write_bytes(gzip.compress(content, 1))
    before = peak_mb()
    bad, after = readers.scenes([file])
    assert isinstance(bad, Refusal)
    assert after.name == "after"
    assert peak_mb() - before < 200


def test_records_without_end_that_cannot_be_used_are_given_up(tmp_path):
    file = tmp_path / "x.tfrecord.gz"
    file.write_bytes(gzip.compress(womd.framed(b"") * 20_000, 1))
    found = list(readers.scenes([file]))
    assert len(found) == 1001
    assert "the rest of it was not read" in found[-1].reason
    assert len(readers.ids(file)) == 1001


def nested(depth, width):
    inner = ["x"]
    for _ in range(depth):
        inner = [inner] * width
    return inner


def itself():
    held = []
    held.append(held)
    return held


def in_scene(key, value):
    """A scene's pickle with such a value in one of its places."""
    described = by_hand.scenarionet(by_hand.scenario())
    places = {
        "id": (described["metadata"], "scenario_id"),
        "type": (described["tracks"]["7"], "type"),
        "x": (described["tracks"]["7"]["state"], "position"),
        "lane": (described["map_features"]["100"], "exit_lanes"),
        "metadata": (described, "metadata"),
        "rate": (described["metadata"], "sample_rate"),
    }
    del described["metadata"]["ts"]
    place, name = places[key]
    place[name] = value
    return pickle.dumps(described, 4)


def of_one_hash(count):
    """A pickled dict of such keys, which takes too long to make."""
    keys = (pickle.encode_long(key * (2**61 - 1)) for key in range(1, count))
    pairs = (b"\x8a" + len(key).to_bytes() + key + b"K\x00" for key in keys)
    return b"\x80\x04}(" + b"".join(pairs) + b"u."


PLACES = ("id", "type", "x", "lane", "metadata")
HOSTILE = {
    **{f"{key} unfolds": lambda key=key: in_scene(key, nested(24, 2)) for key in PLACES},
    **{f"{key} holds itself": lambda key=key: in_scene(key, itself()) for key in PLACES},
    # a type of road users that is new is no fault, however long
    "long type": lambda: in_scene("type", "x" * 2**24),
    "long rate": lambda: in_scene("rate", "x" * 2**24),
    "deep": lambda: b"\x80\x04" + b"]" * 100_000 + b"a" * 99_999 + b".",
    "many lists": lambda: b"\x80\x04" + b"]0" * 1_500_000 + b"N.",
    "memo entry 2**31": lambda: b"\x80\x04r\xff\xff\xff\x7f.",
    "room for 4 GB": lambda: b"\x80\x05\x96" + b"\xff" * 4 + b"\x00" * 4 + b".",
    "keys of one hash": lambda: of_one_hash(20_000),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_pickles_that_unfold_without_end_are_a_refusal(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(_bounded, "CPU_S", 0.3)
    (tmp_path / "x.pkl").write_bytes(HOSTILE[kind]())
    before = peak_mb()
    (found,) = readers.scenes([tmp_path / "x.pkl"])
    assert isinstance(found, Refusal) or kind == "long type"
    said = found.reason if isinstance(found, Refusal) else " ".join(found.repairs)
    assert 20 < len(said) < 3000
    assert peak_mb() - before < 100


@pytest.mark.timeout(30)
def test_devices_pipes_and_link_loops(folder):
    os.mkfifo(folder / "pipe")
    (folder / "zero").symlink_to("/dev/zero")
    (folder / "loop").symlink_to(".")
    (folder / "again").symlink_to(".")
    (folder / "other.tfrecord").symlink_to("c.tfrecord")
    assert [file.name for file in readers.find([folder, folder / "loop"])] == [
        "a.tfrecord",
        "b.json",
        "c.tfrecord",
    ]
    for name, kind in (("pipe", "a pipe"), ("zero", "a device")):
        with pytest.raises(
            ReaderError, match=f"{name} cannot be read: it is {kind}, not a regular"
        ):
            readers.scenes([folder / name])


NAMES = ["[/x]", "[red]", "a\x1b[2Jb\x07", "\ud800x", "\x9b2J", "a\u202eb", "x" * 300, "a\nb"]


@pytest.mark.parametrize("name", NAMES)
def test_ids_that_cannot_be_shown_are_refused_and_markup_is_kept(name, tmp_path):
    described = by_hand.gpudrive(by_hand.scenario()) | {"scenario_id": name}
    (tmp_path / "x.json").write_text(json.dumps(described))
    (found,) = readers.scenes([tmp_path / "x.json"])
    if name in {"[/x]", "[red]"}:
        assert found.name == name
    else:
        assert "the name of the scene" in found.reason
        assert found.name == "x"  # that of the file
        assert found.reason.isprintable()


def test_ids_of_other_types_are_refused(tmp_path):
    described = by_hand.scenarionet(by_hand.scenario())
    described["metadata"]["scenario_id"] = ["a", ["b"]]
    (tmp_path / "x.pkl").write_bytes(pickle.dumps(described))
    (found,) = readers.scenes([tmp_path / "x.pkl"])
    assert "an id is neither text nor a number, but of type list" in found.reason


def test_ids_of_lanes_and_agents_are_checked_too(tmp_path):
    lane = by_hand.gpudrive(by_hand.scenario())
    lane["roads"][0]["id"] = "\x1b]0;x\x07"
    agent = by_hand.gpudrive(by_hand.scenario())
    agent["objects"][0]["id"] = "\x1b]0;x\x07"
    for described, what in ((lane, "id on the map"), (agent, "id of an agent")):
        (tmp_path / "x.json").write_text(json.dumps(described))
        (found,) = readers.scenes([tmp_path / "x.json"])
        assert f"the {what}" in found.reason


def test_a_file_whose_name_cannot_be_shown_is_refused(folder):
    (folder / "b.json").rename(folder / os.fsdecode(b"b\xff\x1b.json"))
    first, bad, last = readers.scenes([folder])
    assert (first.name, last.name) == ("a", "c")
    assert "rename it" in bad.reason
    assert len(readers.ids(folder)) == 3


def test_ids_of_what_cannot_be_read_say_why(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ReaderError, match="pipe cannot be read: it is a pipe"):
        readers.ids(tmp_path / "pipe")
