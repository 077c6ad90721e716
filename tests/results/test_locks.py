"""One sweep a folder, whatever becomes of the sweep."""

import errno
import fcntl
import subprocess
import sys

import pytest

from deepmf_sumo import system
from deepmf_sumo.errors import OutputError
from deepmf_sumo.results import folder

HOLDER = """
import sys, time
from pathlib import Path
from deepmf_sumo.results.folder import opened
with opened(Path(sys.argv[1]), resume=False) as folder:
    folder.manifest({}, {})
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path, starts_sumo):
    """Another process that fills ``tmp_path / "out"``."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.mark.parametrize("resume", [False, True])
def test_the_second_is_refused_and_a_kill_frees_the_folder(holder, tmp_path, resume):
    out = tmp_path / "out"
    (out / "runs" / "kept").mkdir()
    said = rf"out is being written by process {holder.pid} of .*: wait .* --out"
    with pytest.raises(OutputError, match=said), folder.opened(out, resume=resume):
        pass
    assert (out / "runs" / "kept").is_dir()
    holder.kill()
    holder.wait()
    assert (out / folder.FILE).exists()
    with folder.opened(out, resume=True):
        pass
    assert not (out / folder.FILE).exists()


def test_the_folder_is_free_after_an_error(tmp_path):
    with pytest.raises(ZeroDivisionError), folder.held(tmp_path):
        raise ZeroDivisionError
    with folder.held(tmp_path), pytest.raises(OutputError), folder.held(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_was_removed_meanwhile_is_none(tmp_path, monkeypatch):
    lock, times = system.lock, []

    def removed_first(number):
        if not times:
            (tmp_path / folder.FILE).unlink()
        times.append(number)
        return lock(number)

    monkeypatch.setattr(system, "lock", removed_first)
    with folder.held(tmp_path):
        assert (tmp_path / folder.FILE).read_text().startswith("process ")
    assert len(times) == 2


def test_file_systems_without_locks_are_known_and_used_all_the_same(tmp_path, monkeypatch):
    assert folder.known(tmp_path)

    def refuse(number, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert not folder.known(tmp_path)
    with folder.held(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_no_lock_behind(tmp_path, monkeypatch):
    def full(number, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(folder.os, "write", full)
        with pytest.raises(OSError, match="No space left"), folder.held(tmp_path):
            pass
    with folder.held(tmp_path):
        pass
