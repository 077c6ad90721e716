import errno
import gzip
import os
import socket

import pytest

from deepmf_sumo import files
from deepmf_sumo.errors import OutputError


@pytest.fixture
def given(tmp_path):
    file = tmp_path / "given.txt"
    file.write_bytes(b"x" * 5000)
    return file


def test_a_regular_file_passes_and_so_does_a_link_to_one(given, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(given)
    for path in (given, link):
        assert files.content(path, 5000) == b"x" * 5000
        assert files.text(path, 5000) == "x" * 5000
        assert b"".join(files.pieces(path, 5000)) == b"x" * 5000
        with files.opened(path) as file:
            assert file.read(3) == b"xxx"


def special(tmp_path, kind):
    path = tmp_path / "special"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(os.path.relpath(path))
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.mark.timeout(10)
@pytest.mark.parametrize("kind", ["pipe", "socket", "folder", "device"])
def test_what_is_no_regular_file_is_refused_without_waiting(kind, tmp_path):
    path = special(tmp_path, kind)
    for use in (
        files.opened,
        lambda one: files.content(one, 10),
        lambda one: files.unpacked(one, 1),
    ):
        with pytest.raises(OSError, match=f"it is a {kind}, not a regular file") as caught:
            use(path)
        assert files.reason(caught.value) == f"it is a {kind}, not a regular file"
        assert caught.value.filename == str(path)


@pytest.mark.parametrize("name", ["missing", "a\0b", "half \ud800"])
def test_what_is_not_there_or_cannot_be_named_is_an_oserror(name, tmp_path):
    with pytest.raises(OSError, match=r"No such file|can have this name") as caught:
        files.content(tmp_path / name, 10)
    assert files.reason(caught.value)


def test_one_byte_too_many_is_refused(given):
    for read in (files.content, files.text, lambda *all_: list(files.pieces(*all_))):
        with pytest.raises(OSError, match="more than the 4999 bytes allowed") as caught:
            read(given, 4999)
        assert caught.value.errno == errno.EFBIG


def test_files_that_do_not_tell_their_size_are_read_and_bounded():
    assert files.content(files.Path("/proc/self/maps"), 2**24)
    with pytest.raises(OSError, match="more than the 10 bytes"):
        files.content(files.Path("/proc/self/maps"), 10)


def test_gzip_is_unpacked_up_to_the_limit(given, tmp_path):
    packed = tmp_path / "packed"
    packed.write_bytes(gzip.compress(b"y" * 2**20))
    with files.unpacked(packed, 2**20) as file:
        assert file.read() == b"y" * 2**20
    with files.unpacked(given, 5000) as file:
        assert file.read() == b"x" * 5000
    with files.unpacked(packed, 2**20 - 1) as file, pytest.raises(OSError, match="more than"):
        file.read()
    packed.write_bytes(packed.read_bytes()[:-20])
    with files.unpacked(packed, 2**20) as file, pytest.raises(OSError, match="damaged"):
        file.read()


@pytest.mark.timeout(10)
def test_link_loops_end_and_each_file_comes_once(tmp_path):
    (tmp_path / "deep").mkdir()
    for name in ("b", "deep/a", ".hidden"):
        (tmp_path / name).write_text(name)
    for name in ("c", "d"):
        (tmp_path / name).symlink_to(".")
        (tmp_path / "deep" / name).symlink_to("..")
    (tmp_path / "e").symlink_to("b")
    (tmp_path / "f").symlink_to("f")
    (tmp_path / "g").symlink_to("/dev/zero")
    found = [str(path.relative_to(tmp_path)) for path in files.inside(tmp_path)]
    assert found == ["b", "deep/a"]


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "made"
    files.write(path, "old")
    with pytest.raises(TypeError), files.whole(path) as file:
        file.writelines([b"half", "no bytes"])
    assert (path.read_text(), [one.name for one in tmp_path.iterdir()]) == ("old", ["made"])
    with files.whole(path) as file:
        file.write(b"new")
        assert path.read_text() == "old"
    assert (path.read_text(), [one.name for one in tmp_path.iterdir()]) == ("new", ["made"])


def test_what_cannot_be_written_is_one_sentence(tmp_path):
    path = tmp_path / "missing" / "made"
    sentence = r"made cannot be written: No such file or directory\."
    with pytest.raises(OutputError, match=sentence), files.writing(path):
        files.write(path, "text")
