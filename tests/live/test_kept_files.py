"""Commands of a client that name a file: where it is, and what passes as it is."""

import struct

import pytest

from deepmf_sumo.live.kept_files import KeptFiles, RefusedError, framed


def string(text):
    return struct.pack("!i", len(text)) + text


def command(number, variable, *values, name=b""):
    return framed(bytes((number, variable)) + string(name) + b"".join(values))


def text(value):
    return b"\x0c" + string(value)


def saved(name):
    return command(0xCB, 0x95, text(name))


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "box").mkdir()
    return KeptFiles(tmp_path / "box")


@pytest.mark.parametrize(
    "given", ["s.xml", "/etc/s.xml", "../../s.xml", r"a\..\s.xml", "./a/s.xml"]
)
def test_a_state_is_saved_in_the_folder_and_loaded_from_there(kept, tmp_path, given):
    place = str(tmp_path / "box" / "s.xml").encode()
    assert kept.moved(saved(given.encode())) == saved(place)
    assert kept.moved(command(0xCB, 0x96, text(given.encode()))) == command(0xCB, 0x96, text(place))
    assert kept.of_load(["--load-state", given]) == ["--load-state", place.decode()]
    assert kept.of_load([f"--load-state={given}"]) == [f"--load-state={place.decode()}"]


def test_two_files_of_one_name_stay_two(kept):
    first, second = (kept.moved(saved(name)) for name in (b"a/s.xml", b"b/s.xml"))
    assert first != second
    assert kept.moved(saved(b"a/../a/s.xml")) == first


def test_what_was_not_saved_here_is_loaded_from_where_it_is(kept, tmp_path):
    (tmp_path / "own.xml").touch()
    load = command(0xCB, 0x96, text(b"own.xml"))
    assert kept.moved(load) == load
    (tmp_path / "box" / "state_300.xml").touch()  # SUMO's own option has saved it
    assert kept.found("state_300.xml") == str(tmp_path / "box" / "state_300.xml")


def test_a_picture_is_saved_in_the_folder(kept, tmp_path):
    size = b"\x09" + struct.pack("!i", 100)
    head = b"\x0f" + struct.pack("!i", 3)
    asked = command(0xCC, 0xA5, head, text(b"/home/user/x.png"), size, size, name=b"View #0")
    place = str(tmp_path / "box" / "x.png").encode()
    assert kept.moved(asked) == command(0xCC, 0xA5, head, text(place), size, size, name=b"View #0")


def test_long_names_have_a_long_length(kept):
    name = b"x" * 250
    moved = kept.moved(saved(b"/tmp/" + name))
    assert moved[0] == 0
    assert struct.unpack_from("!i", moved, 1)[0] == len(moved)
    assert moved.endswith(name)


@pytest.mark.parametrize("name", [b"", b"/", b"..", b"a/..", b"."])
def test_no_file_is_refused(kept, name):
    with pytest.raises(RefusedError, match=r"simulation\.saveState: .* names no file"):
        kept.moved(saved(name))


@pytest.mark.parametrize("cut", range(4, 18))
def test_a_command_that_is_cut_off_is_refused_by_name(kept, cut):
    with pytest.raises(RefusedError, match=r"^simulation\.saveState: "):
        kept.moved(framed(saved(b"ab.xml")[1:cut]))


@pytest.mark.parametrize(
    "content",
    [
        b"\xcb\x95" + string(b"") + b"\x09" + string(b"s.xml"),
        b"\xcb\x95" + string(b"") + b"\x0c" + struct.pack("!i", -4) + b"s.xml",
        b"\xcb\x95" + struct.pack("!i", -1) + b"\x0c" + string(b"s.xml"),
        b"\xcb\x95" + string(b"") + text(b"\xff\xfe"),
    ],
)
def test_what_cannot_be_read_is_refused_by_name(kept, content):
    with pytest.raises(RefusedError, match=r"^simulation\.saveState: "):
        kept.moved(framed(content))


def test_other_commands_do_not_concern_it(kept):
    for number, variable in ((0xCB, 0x7E), (0xCC, 0xA0), (0xAB, 0x95), (0xC4, 0x95)):
        assert not kept.concerns(command(number, variable, text(b"x")))
    assert not kept.concerns(framed(b"\xcb"))
