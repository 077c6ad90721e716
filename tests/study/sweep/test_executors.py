"""Executors: what they are called, and a cluster whose machines get lost (Ray is a double)."""

import dataclasses
import os
import re
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from deepmf_sumo.errors import PluginError, RunError, UsageError
from deepmf_sumo.study.sweep import batch, ray_cluster
from deepmf_sumo.study.sweep.inputs import Input, digest
from deepmf_sumo.study.sweep.ray_cluster import Cluster
from deepmf_sumo.study.sweep.workers import BatchLimits, Local

from tests.support.ray_double import Ray


@dataclass(frozen=True)
class Writes:
    """Writes what a task says into its folder, or fails as it says."""

    runs: Path

    def __call__(self, task):
        folder = self.runs / task.run_id
        folder.mkdir()
        (folder / "said").write_text(f"{task.says} {Path.cwd()}")
        if task.says == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if task.says == "hang":
            time.sleep(60)


def tasks(*says):
    return [SimpleNamespace(run_id=f"run-{number}", says=one) for number, one in enumerate(says)]


@pytest.fixture
def runs(tmp_path):
    (tmp_path / "runs").mkdir()
    return tmp_path / "runs"


@pytest.fixture
def use(monkeypatch):
    """Puts a double in Ray's place, and a list of inputs."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    main = ModuleType("__main__")  # of a worker of Ray: a file that is no module of ours
    main.__file__ = "ray.py"
    monkeypatch.setitem(sys.modules, "__main__", main)

    def use(ray, *inputs):
        monkeypatch.setitem(sys.modules, "ray", ray)
        monkeypatch.setattr(ray_cluster, "inputs_of", lambda _: inputs)
        return ray

    return use


def do(runs, wanted, jobs=2, **limits):
    return list(Cluster(jobs=jobs).run(Writes(runs), wanted, BatchLimits(**limits)))


@pytest.mark.sumo
def test_folders_come_home_and_a_crash_costs_one_task(runs, use):
    ray = use(Ray())
    endings = do(runs, tasks("a", "crash", "b", "hang", "c"), timeout_s=1.0)
    found = {one.index: (one.status, one.reason) for one in endings}
    assert [found[index][0] for index in range(5)] == ["done", "crashed", "done", "timeout", "done"]
    assert found[1][1] == "the worker died: SIGSEGV"
    assert found[3][1] == "longer than 1 s"
    assert {path.name for path in runs.iterdir()} == {f"run-{number}" for number in range(5)}
    assert (runs / "run-2" / "said").read_text() == f"b {Path.cwd()}"
    assert len(ray.actors) == 2
    assert not ray.running


@pytest.mark.sumo
def test_a_lost_machine_costs_its_task_a_second_try(runs, use):
    ray = use(Ray(lost={0: 4}))
    endings = do(runs, tasks(*"abcdef"))
    lost = [one for one in endings if one.status == "lost"]
    assert [one.reason for one in lost] == ["its machine is gone"]
    assert sorted(one.index for one in endings if one.status == "done") == list(range(6))
    assert len(list(runs.iterdir())) == 6
    assert len(ray.actors) == 3, "one in the place of the lost one"


@pytest.mark.sumo
def test_a_task_whose_machine_is_lost_again_and_again_is_a_failed_one(runs, use):
    use(Ray(lost=dict.fromkeys(range(3), 2)))
    endings = do(runs, tasks("a", "b"), jobs=1)
    assert [one.status for one in endings] == ["lost", "lost", "crashed", "done"]
    assert endings[2].reason == (
        "the machine was lost 3 times while it did this: its machine is gone"
    )
    assert [one.index for one in endings] == [0, 0, 0, 1]


class OneMachine(Ray):
    """Its first actors are gone as soon as all of them but one have nothing left to do."""

    def wait(self, calls, **options):
        if len(calls) == 1 and len(self.actors) == self.cpus:
            for actor in self.actors:
                actor.place.stop()
                actor.alive = False
        return super().wait(calls, **options)


@pytest.mark.sumo
def test_a_task_is_not_given_to_idle_actors_of_a_lost_machine(runs, use):
    use(OneMachine(cpus=4))
    endings = do(runs, tasks(*"abcd"), jobs=4)
    assert Counter(one.status for one in endings) == {"done": 4, "lost": 1}


@pytest.mark.sumo
def test_a_machine_without_the_files_is_refused(runs, tmp_path, use):
    net = tmp_path / "net.xml"
    net.write_text("one")
    wanted = Input(path=net, digest=digest(net))
    ray = use(Ray(), wanted)
    assert [one.status for one in do(runs, tasks("a"), jobs=1)] == ["done"]
    net.write_text("two")
    with pytest.raises(UsageError, match=r"has another .*net\.xml: all machines of the cluster"):
        do(runs, tasks("a"), jobs=1)
    net.unlink()
    with pytest.raises(UsageError, match=r"has no .*net\.xml: all machines of the cluster"):
        do(runs, tasks("a"), jobs=1)
    assert not ray.running


def test_another_version_is_refused(runs, use, monkeypatch):
    use(Ray())
    monkeypatch.setattr(ray_cluster.deepmf_sumo, "__version__", "0.0.1")
    home = ray_cluster.NodeState(
        version="9.9", sumo="1.20.0", folder=Path.cwd(), modules=(), environment={}, inputs=()
    )
    refused = ray_cluster.WorkerActor(home, Writes(runs), BatchLimits()).start().refusal
    assert refused.endswith("has deepmf-sumo 0.0.1, not 9.9")
    home = dataclasses.replace(home, version="0.0.1")
    refused = ray_cluster.WorkerActor(home, Writes(runs), BatchLimits()).start().refusal
    assert re.search(r"has SUMO 1\.\d+\.\d+, not 1\.20\.0$", refused)


def test_workers_that_never_start_are_not_tried_for_ever(runs, use):
    use(Ray(lost=dict.fromkeys(range(100), 1)))
    with pytest.raises(RunError, match=r"do not start .*: its machine is gone \(is deepmf-sumo"):
        do(runs, tasks("a"))


def test_no_machine_answers(runs, use, monkeypatch):
    ray = use(Ray())
    monkeypatch.setattr(ray, "wait", lambda calls, **_: ([], list(calls)))
    monkeypatch.setattr(ray_cluster, "START_LIMIT_S", -1.0)
    with pytest.raises(RunError, match="No machine of the cluster has answered"):
        do(runs, tasks("a"), jobs=1)


def test_a_lost_head_is_a_sentence(runs, use, monkeypatch):
    ray = use(Ray())

    def gone(calls, **_):
        raise ConnectionError("stream removed")

    monkeypatch.setattr(ray, "wait", gone)
    with pytest.raises(RunError, match=r"'ray' is lost \(stream removed\); --resume goes on"):
        do(runs, tasks("a"))
    assert not ray.running


@pytest.mark.sumo
def test_closing_leaves_no_process_and_begins_nothing(runs, use):
    ray = use(Ray())
    endings = Cluster(jobs=2).run(Writes(runs), tasks("a", "hang", "hang"), BatchLimits())
    assert next(endings).index == 0
    workers = [actor.place._worker.process for actor in ray.actors]
    endings.close()
    assert not any(worker.is_alive() for worker in workers)
    assert not any(actor.alive for actor in ray.actors)
    assert not ray.running


@pytest.mark.sumo
def test_no_task_is_begun_after_the_last_minute(runs, use):
    use(Ray())
    assert do(runs, tasks("a", "b"), minutes=1e-9) == []
    assert list(runs.iterdir()) == []


def test_names_of_executors():
    assert batch.executor_named("local", 3) == Local(jobs=3)
    assert batch.executor_named() == Local(jobs=1)
    assert batch.executor_named("ray") == Cluster()
    assert batch.executor_named("ray://head:6000", 8) == Cluster(host="head", port=6000, jobs=8)
    assert batch.executor_named("ray://[fd00::2]").name == "ray://[fd00::2]:10001"
    for wrong in ("ry", "ray:", "ray://", "ray://head:99999", "ray://a b", "local:2"):
        with pytest.raises(UsageError, match="must be local, ray, or ray://HOST:PORT"):
            batch.executor_named(wrong)


def test_without_ray_and_without_an_answer(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(PluginError, match=r"install deepmf-sumo\[cluster\]"):
        batch.executor_named("ray").check()
    monkeypatch.setitem(sys.modules, "ray", Ray())
    batch.executor_named("ray").check()
    with pytest.raises(UsageError, match=r"No Ray cluster answers at ray://127\.0\.0\.1:9 "):
        batch.executor_named("ray://127.0.0.1:9").check()


class Shy(Ray):
    """Says something against a program that wants to join, and each time something else."""

    def __init__(self, *said):
        super().__init__()
        self.said = list(said)

    def init(self, **options):
        if self.said:
            raise ConnectionAbortedError(self.said.pop(0))
        return super().init(**options)


BUSY = (
    "Initialization failure from server: Traceback (most recent call last): File "
    f"'{'/somewhere/deep' * 20}/proxier.py', line 697, in Datapath RuntimeError: "
    "Starting Ray client server failed. See ray_client.err"
)


@pytest.mark.sumo
def test_a_cluster_that_is_busy_is_asked_again(runs, use):
    use(Shy(BUSY, BUSY))
    assert [one.status for one in do(runs, tasks("a"))] == ["done"]


@pytest.mark.parametrize("said", [(BUSY,) * 3, ("Version mismatch",)])
def test_a_cluster_that_cannot_be_joined(runs, use, said):
    ray = use(Shy(*said, "never asked"))
    with pytest.raises(UsageError, match=f"'ray' cannot be joined: .*{said[-1][-16:]}$"):
        do(runs, tasks("a"))
    assert ray.said == ["never asked"]


def test_a_head_that_does_not_answer_may_want_a_token(runs, use, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"):
        monkeypatch.delenv(name, raising=False)
    use(Shy("ray client connection timeout"))
    said = r"timeout\. A head that has a token .* no token is here, RAY_AUTH_MODE is not set\. Copy"
    with pytest.raises(UsageError, match=said):
        do(runs, tasks("a"))


@pytest.mark.parametrize("where", ["home", "RAY_AUTH_TOKEN_PATH", "RAY_AUTH_TOKEN", None])
def test_a_token_of_this_machine_is_sent(use, monkeypatch, tmp_path, where):
    monkeypatch.setattr(os, "environ", {"HOME": str(tmp_path)})
    monkeypatch.setattr(Cluster, "_check_address", lambda self, host: None)
    token = tmp_path / ".ray" / "auth_token"
    token.parent.mkdir()
    if where == "home":
        token.write_text("secret")
    elif where == "RAY_AUTH_TOKEN_PATH":
        os.environ[where] = str(tmp_path / "elsewhere")
        (tmp_path / "elsewhere").write_text("secret")
    elif where:
        os.environ[where] = "secret"
    use(Ray())
    Cluster(host="head", port=10001).check()
    assert os.environ.get("RAY_AUTH_MODE") == ("token" if where else None)
    os.environ["RAY_AUTH_MODE"] = "disabled"
    Cluster(host="head", port=10001).check()
    assert os.environ["RAY_AUTH_MODE"] == "disabled"


def test_a_program_that_was_part_of_a_cluster_before_stays_so(runs, use):
    ray = use(Shy("called twice"))
    ray.running = True
    with pytest.raises(UsageError, match="cannot be joined: called twice"):
        do(runs, tasks("a"))
    assert ray.running


def test_digests_tell_files_apart(tmp_path):
    (tmp_path / "a").write_text("x")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "b").write_text("x")
    before = digest(tmp_path / "folder")
    assert before
    assert before != digest(tmp_path / "a")
    (tmp_path / "folder" / "b").write_text("y")
    assert digest(tmp_path / "folder") != before
    assert digest(tmp_path / "nowhere") == ""
