"""One sweep a folder, whatever becomes of the sweep."""

import errno
import subprocess
import sys

import pytest

from deepmf_sumo.benchmark import locks, store
from deepmf_sumo.errors import OutputError

HOLDER = """
import sys, time
from pathlib import Path
from deepmf_sumo.benchmark.store import opened
with opened(Path(sys.argv[1]), resume=False) as folder:
    folder.begin([], {})
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
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
    with pytest.raises(OutputError, match=said), store.opened(out, resume=resume):
        pass
    assert (out / "runs" / "kept").is_dir()
    holder.kill()
    holder.wait()
    assert (out / locks.FILE).exists()
    with store.opened(out, resume=True):
        pass
    assert not (out / locks.FILE).exists()


def test_the_folder_is_free_after_an_error(tmp_path):
    with pytest.raises(ZeroDivisionError), locks.held(tmp_path):
        raise ZeroDivisionError
    with locks.held(tmp_path), pytest.raises(OutputError), locks.held(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_was_removed_meanwhile_is_none(tmp_path, monkeypatch):
    lock, times = locks._lock, []

    def removed_first(number):
        if not times:
            (tmp_path / locks.FILE).unlink()
        times.append(number)
        return lock(number)

    monkeypatch.setattr(locks, "_lock", removed_first)
    with locks.held(tmp_path):
        assert (tmp_path / locks.FILE).read_text().startswith("process ")
    assert len(times) == 2


def test_file_systems_without_locks_are_known_and_used_all_the_same(tmp_path, monkeypatch):
    assert locks.known(tmp_path)

    def refuse(number, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(locks.fcntl, "flock", refuse)
    assert not locks.known(tmp_path)
    with locks.held(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []
