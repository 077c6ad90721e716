"""The runner itself: what it must notice."""

import os
import signal
import time

import pytest

from deepmf_sumo.errors import ReaderError

from tests.fuzz import mutators, runner

pytestmark = pytest.mark.sumo


def make(folder):
    (folder / "input").write_bytes(b"abc")
    return folder / "input"


def refuse(path, out):
    raise ReaderError("no.")


def spin(path, out):
    end = time.process_time() + runner.CPU_S + 0.2
    while time.process_time() < end:
        pass


def grow(path, out):
    return len(b"x" * (runner.MEMORY_MB + 50) * 2**20)


def escape(path, out):
    (out / ".." / ".." / "escaped").write_text("")


def harm(path, out):
    path.unlink()


@pytest.mark.parametrize(
    ("use", "result"),
    [
        (lambda path, out: (out / "fine").write_text(""), "accepted"),
        (refuse, "refused"),
        (lambda path, out: 1 / 0, "traceback"),
        (lambda path, out: print("unexpected TypeError: x"), "traceback"),
        (lambda path, out: os.kill(os.getpid(), signal.SIGTERM), "killed"),
        (spin, "hang"),
        (grow, "memory"),
        (escape, "outside"),
        (harm, "outside"),
        (lambda path, out: runner.command("no-such-command"), "refused"),
    ],
)
def test_each_way_to_fail_is_told(use, result, tmp_path, monkeypatch):
    if use is spin:
        monkeypatch.setattr(runner, "CPU_S", 1.0)
    kind = runner.Kind("one", make, lambda rng, path: None, use)
    (found,) = runner.run(kind, 1, seed=1, keep=tmp_path)
    assert found.result == result, found
    assert (tmp_path / "one" / "0").exists() == (result in runner.BAD)


def test_an_input_of_a_number_is_the_same_whatever_the_count():
    def show(path, out):
        print(path.read_bytes())

    kind = runner.Kind("one", make, mutators.file, show)
    few, many = ([one.said for one in runner.run(kind, count, seed=3)] for count in (3, 6))
    assert many[:3] == few
    assert len(set(many)) > 2
