import ast
import errno
import gzip
import hashlib
import os
import socket
import threading
from pathlib import Path

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


@pytest.mark.timeout(60)
def test_of_two_writers_each_file_is_whole(tmp_path):
    """Each reader sees all bytes of one writer, and no writer fails."""
    path, size, failed = tmp_path / "made.txt", 100_000, []

    def write(letter):
        for _ in range(30):
            try:
                files.write(path, letter * size)
            except OSError as error:
                failed.append(error)

    writers = [threading.Thread(target=write, args=(letter,)) for letter in "abc"]
    for one in writers:
        one.start()
    seen = set()
    while any(one.is_alive() for one in writers):
        if path.exists():
            seen.add(path.read_bytes())
    for one in writers:
        one.join()
    assert failed == []
    assert {len(text) for text in seen} == {size}
    assert all(len(set(text)) == 1 for text in seen)
    assert [one.name for one in tmp_path.iterdir()] == ["made.txt"]


@pytest.mark.timeout(60)
def test_of_two_writers_each_folder_is_whole(tmp_path):
    failed = []

    def write(letter):
        for _ in range(20):
            try:
                with files.whole_folder(tmp_path / "made") as folder:
                    for name in ("one", "two"):
                        (folder / name).write_text(letter)
            except OSError as error:
                failed.append(error)

    writers = [threading.Thread(target=write, args=(letter,)) for letter in "abc"]
    for one in writers:
        one.start()
    for one in writers:
        one.join()
    assert failed == []
    assert len({(tmp_path / "made" / name).read_text() for name in ("one", "two")}) == 1
    assert [one.name for one in tmp_path.iterdir()] == ["made"]


def test_a_folder_takes_the_place_of_a_file_or_a_link(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "kept").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    for name in ("file", "link"):
        with files.whole_folder(tmp_path / name) as folder:
            (folder / "x").write_text("")
        assert [one.name for one in (tmp_path / name).iterdir()] == ["x"]
    assert list((tmp_path / "kept").iterdir()) == []


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path):
    path = tmp_path / ("n" * 250)
    files.write(path, "x")
    assert path.read_text() == "x"


def test_what_a_killed_writer_left_is_removed_and_nothing_else(tmp_path):
    for name in (".runs.csv.0a.part", "runs.part", ".hidden", "mine.csv"):
        (tmp_path / name).write_text("")
    files.remove_parts(tmp_path)
    assert {one.name for one in tmp_path.iterdir()} == {"runs.part", ".hidden", "mine.csv"}


def test_what_is_made_of_files_is_kept_until_one_changes(tmp_path):
    """Files may be missing; other arguments tell results apart, too."""
    calls = []

    @files.while_unchanged(4)
    def joined(first, *others, end):
        calls.append(first)
        return "".join(one.read_text() if one.exists() else "-" for one in (first, *others)) + end

    a, b = tmp_path / "a", tmp_path / "b"
    a.write_text("1")
    assert [joined(a, b, end="."), joined(a, b, end="."), joined(a, b, end="!")] == [
        "1-.", "1-.", "1-!",
    ]  # fmt: skip
    assert len(calls) == 2
    b.write_text("2")
    assert joined(a, b, end=".") == "12."
    os.utime(b, ns=(1, 1))
    b.write_text("3")
    assert joined(a, b, end=".") == "13."


def test_copies_and_digests(given, tmp_path):
    files.copy(given, tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == given.read_bytes()
    assert files.sha256(given) == hashlib.sha256(b"x" * 5000).hexdigest()


ROOT = Path(files.__file__).parent
OURS = {
    "training/samples/feature_cache.py": "samples that training keeps in the cache",
    "training/run.py": "/proc",
    "system.py": "/proc",
    "study/sweep/streams.py": "the log of a run's own folder",
    "study/sweep/spawn.py": "questions and answers of its own processes",
    "study/sweep/ray_cluster.py": "archives in memory",
    "cli/main.py": "the null device",
    "cli/doctor.py": "/proc and /sys",
    "live/connection.py": "/proc",
    "scene/readers/_bounded.py": "pipes of its own process",
    "report/page/document.py": "styles and scripts of the package",
    "training/generated/street_graph.py": "what netgenerate wrote a moment ago",
    "training/generated/layout.py": "input of netconvert in a folder of its own",
    "training/generated/demand.py": "files of a folder that is made whole",
    "sumo/network/conversion.py": "what netconvert wrote a moment ago",
    "sumo/network/plain_net.py": "input of netconvert in a folder of its own",
    "sumo/network/mapping.py": "files of a folder that is made whole",
    "exporters/fcd.py": "files of a folder that is made whole",
    "exporters/ssam.py": "files of a folder that is made whole",
    "exporters/openodd.py": "files of a folder that is made whole",
    "exporters/openscenario.py": "files of a folder that is made whole",
    "exporters/womd.py": "files of a folder that is made whole",
    "exporters/osi.py": "files of a folder that is made whole",
    "roadcheck/conflicts.py": "answers of its own processes",
    "training/recording/driver_population.py": "a file for SUMO in a folder of its own",
    "study/moments/search.py": "answers of its own processes",
    "roadcheck/countermeasures/building.py": "what SUMO wrote a moment ago",
    "sumo/simulation/sumo_api.py": "a file for SUMO in a folder of its own",
    "sumo/simulation/sumo_config.py": "a file for SUMO in a folder of its own",
    "sumo/simulation/sumo_words.py": "messages of SUMO in a folder of its own",
    "results/folder.py": "the lock of a result folder",
}
"""Modules that open files themselves, none of which a user names, and what these are."""
OPENING = {"read_bytes", "read_text", "write_bytes", "write_text", "load_file", "safe_open"}


def opens(tree):
    """Calls that open a file by its path."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
        owner = getattr(getattr(function, "value", None), "id", "")
        parses = (owner, name) == ("ET", "parse") and not isinstance(node.args[0], ast.Name)
        opened = name == "open" and owner not in {"files", "Results", "cls"}
        if name in OPENING or opened or parses:
            yield node


def test_every_file_that_a_user_names_is_opened_in_one_place():
    found = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if path.name != "files.py" and any(opens(ast.parse(path.read_text())))
    }
    assert found - OURS.keys() == set(), "read and write by deepmf_sumo.files"
    assert OURS.keys() - found == set(), "does not open files any more"


def test_a_folder_that_cannot_be_written_is_told_before_any_work(tmp_path, given):
    files.check_writable(tmp_path / "new" / "deep")
    assert list(tmp_path.iterdir()) == [given]
    for folder in (given / "out", Path("/proc/self/task")):
        with pytest.raises(OutputError, match=f"^{folder} cannot be written: "):
            files.check_writable(folder)
