import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.sumo,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc"),
]

PROGRAM = """
import sys, time
from pathlib import Path
from tests.training.test_processes import begun
from deepmf_sumo.training import processes
if __name__ == "__main__":
    with processes.pool(2) as pool:
        list(pool.map(begun, [(Path(sys.argv[1]), number) for number in range(4)]))
"""


def begun(given):
    """Work that lasts, and removes what it has begun however it ends."""
    folder, number = given
    part = folder / f"part-{number}"
    part.write_text(str(os.getpid()))
    try:
        time.sleep(60)
    finally:
        part.unlink()


@pytest.mark.parametrize("everybody", [True, False], ids=["its group", "it alone"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_processes_end_with_their_command_and_leave_no_part(tmp_path, number, everybody):
    program, parts = tmp_path / "program.py", tmp_path / "parts"
    program.write_text(PROGRAM)
    parts.mkdir()
    process = subprocess.Popen(
        [sys.executable, program, parts],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    ids = ids_of(parts, 2)
    (os.killpg if everybody else os.kill)(process.pid, number)
    _, said = process.communicate(timeout=30)
    end = time.monotonic() + 10
    while any(map(alive, ids)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(alive, ids))
    killed = number == signal.SIGKILL and everybody
    assert killed or not list(parts.iterdir())
    assert "SpawnProcess" not in said  # a process's own traceback


def ids_of(parts, count):
    end = time.monotonic() + 60
    while time.monotonic() < end:
        found = [one.read_text() for one in parts.iterdir()]
        if len(found) == count and all(found):
            return list(map(int, found))
        time.sleep(0.05)
    raise AssertionError("the work has not begun")


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_one_that_leaves_within_a_callback_says_nothing():
    code = """if True:
        import os, signal, weakref
        from deepmf_sumo.training import processes
        signal.signal(signal.SIGTERM, processes._leave)
        class Thing: pass
        thing = Thing()
        watched = weakref.ref(thing, lambda _: os.kill(os.getpid(), signal.SIGTERM))
        del thing
    """
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stderr == ""
