import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deepmf_sumo.errors import RunError
from deepmf_sumo.study.sweep import workers

pytestmark = [pytest.mark.sumo, pytest.mark.usefixtures("spawned_workers")]

KEPT = []


def do(task):
    """What a test's task says."""
    kind, value = task
    if kind == "write":
        Path(value).write_text(os.environ["OMP_NUM_THREADS"])
    elif kind == "kill":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif kind == "exit":
        os._exit(7)
    elif kind == "raise":
        raise ValueError(value)
    elif kind == "eat":
        held = bytearray(value * 2**20)
        time.sleep(60)
        del held
    elif kind == "keep":
        KEPT.append(b"x" * (value * 2**20))
    elif kind == "rest":
        time.sleep(value)
    elif kind == "child":
        child = subprocess.Popen(["sleep", "60"])
        Path(value).write_text(str(child.pid))
        time.sleep(60)
    elif kind == "orphan":
        child = subprocess.Popen(["sleep", "60"])
        Path(value).write_text(str(child.pid))
        os._exit(7)
    elif kind == "deaf":
        os.closerange(3, 64)
        time.sleep(60)


class NeverStarts:
    def __call__(self, task):
        pass

    def __reduce__(self):
        return (os._exit, (3,))


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_crash_costs_one_task(tmp_path, jobs):
    tasks = [
        ("write", tmp_path / "a"),
        ("kill", None),
        ("write", tmp_path / "b"),
        ("exit", None),
        ("raise", "no"),
        ("write", tmp_path / "c"),
    ]
    endings = {one.index: one for one in workers.run(do, tasks, jobs=jobs, timeout_s=60)}
    assert [endings[i].status for i in range(6)] == [
        "done", "crashed", "done", "crashed", "raised", "done",
    ]  # fmt: skip
    assert "SIGSEGV" in endings[1].reason
    assert "exit code 7" in endings[3].reason
    assert endings[4].reason == "ValueError: no"
    assert {(tmp_path / name).read_text() for name in "abc"} == {"1"}


def test_time_limit_kills_the_worker_and_its_children(tmp_path):
    pid_file = tmp_path / "pid"
    tasks = [("child", pid_file), ("write", tmp_path / "after")]
    endings = list(workers.run(do, tasks, jobs=1, timeout_s=1.0))
    assert [one.status for one in endings] == ["timeout", "done"]
    assert endings[0].reason == "longer than 1 s"
    assert _gone(int(pid_file.read_text()))


def test_children_do_not_outlive_a_worker_that_crashes(tmp_path):
    pid_file = tmp_path / "pid"
    (ending,) = workers.run(do, [("orphan", pid_file)], jobs=1, timeout_s=60)
    assert ending.status == "crashed"
    assert "exit code 7" in ending.reason
    assert _gone(int(pid_file.read_text()))


def test_a_worker_whose_parent_hangs_up_in_the_middle_of_a_word_ends_quietly():
    """A connection that is closed with something unread is reset."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    flag = context.RawArray("b", 1)
    worker = context.Process(target=workers._serve, args=(theirs, do, os.getpid(), flag))
    worker.start()
    theirs.close()
    assert ours.poll(60)
    ours.close()
    worker.join(60)
    assert worker.exitcode == 0


def test_a_worker_that_hangs_up_costs_one_task(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "_LAST_WORDS_S", 0.1)
    tasks = [("deaf", None), ("write", tmp_path / "after")]
    endings = list(workers.run(do, tasks, jobs=1, timeout_s=20))
    assert [one.status for one in endings] == ["crashed", "done"]
    assert "SIGTERM" in endings[0].reason  # it was ended


def test_ctrl_c_at_the_start_of_a_worker_is_the_parents_alone(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import sys, signal; sys.path[:0] = sys.argv[1:3]\n"
        "import test_pool\n"
        "from deepmf_sumo.study.sweep import workers\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, lambda *_: None)\n"
        "    print('starts', flush=True)\n"
        "    endings = workers.run(test_pool.do, [('write', sys.argv[3])], jobs=1, timeout_s=20)\n"
        "    print([one.status for one in endings])\n"
    )
    here = Path(__file__).resolve()
    parent = subprocess.Popen(
        [sys.executable, program, here.parents[3], here.parent, tmp_path / "written"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert parent.stdout.readline() == "starts\n"
    while parent.poll() is None:  # to all of the terminal's group, as a terminal does
        os.killpg(parent.pid, signal.SIGINT)
        time.sleep(0.05)
    said, errors = parent.communicate()
    assert (said, errors) == ("['done']\n", "")


def test_memory_limit_costs_one_task(tmp_path):
    tasks = [("eat", 400), ("write", tmp_path / "after")]
    begin = time.monotonic()
    endings = list(workers.run(do, tasks, jobs=1, timeout_s=60, memory_mb=300))
    assert [one.status for one in endings] == ["memory", "done"]
    assert endings[0].reason == "more than 300 MB of memory"
    assert time.monotonic() - begin < 30


def test_what_many_tasks_left_behind_is_not_held_against_the_next():
    tasks = [("keep", 3)] * 149 + [("rest", 0.5)]  # 450 MB in one worker, long enough to be seen
    endings = list(workers.run(do, tasks, jobs=1, timeout_s=60, memory_mb=400))
    assert [one.index for one in endings] == list(range(150))
    assert {one.status for one in endings} == {"done"}


def test_no_task_is_begun_after_the_last_minute(tmp_path):
    tasks = [("write", tmp_path / "a"), ("write", tmp_path / "b")]
    assert list(workers.run(do, tasks, jobs=1, timeout_s=60, minutes=1e-9)) == []
    assert not (tmp_path / "a").exists()


def test_closing_kills_what_runs(tmp_path):
    pid_file = tmp_path / "pid"
    endings = workers.run(
        do, [("write", tmp_path / "a"), ("child", pid_file)], jobs=1, timeout_s=60
    )
    next(endings)
    begin = time.monotonic()
    endings.close()
    assert time.monotonic() - begin < 5
    assert not pid_file.exists() or _gone(int(pid_file.read_text()))


def test_a_worker_that_cannot_start_is_an_error():
    with pytest.raises(RunError, match="died while it started"):
        list(workers.run(NeverStarts(), [1], jobs=1, timeout_s=60))


def test_no_tasks():
    assert list(workers.run(do, [], jobs=2, timeout_s=1)) == []


def test_a_killed_parent_leaves_no_worker(tmp_path):
    pid_file = tmp_path / "pid"
    script = (
        "import sys; sys.path[:0] = sys.argv[1:3]\n"
        "from pathlib import Path\n"
        "import test_pool\n"
        "from deepmf_sumo.study.sweep import workers\n"
        "if __name__ == '__main__':\n"
        "    tasks = [('child', Path(sys.argv[3]))]\n"
        "    list(workers.run(test_pool.do, tasks, jobs=1, timeout_s=None))\n"
    )
    program = tmp_path / "program.py"
    program.write_text(script)
    here = Path(__file__).resolve()
    parent = subprocess.Popen([sys.executable, program, here.parents[3], here.parent, pid_file])

    def written():  # the file is there before its text
        return pid_file.exists() and pid_file.read_text().strip()

    worker = _until(lambda: _children(parent.pid) if written() else None)
    parent.kill()
    parent.wait()
    try:
        assert all(_gone(pid, 10.0) for pid in worker)
    finally:
        os.kill(int(pid_file.read_text()), signal.SIGKILL)  # `sleep` itself is not ours to end


def _children(pid):
    tasks = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(one) for one in tasks]


def _until(found, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = found()
        if value:
            return value
        time.sleep(0.05)
    raise AssertionError("did not happen")


def _gone(pid, seconds=3.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.05)
    return False
