"""Benchmarks from plan to tables: shards, kills, and runs that go wrong."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.study import plans
from deepmf_sumo.study.plans import tables
from deepmf_sumo.study.sweep import batch

from tests.support import same_bytes, tiny_plan
from tests.support.forked_workers import Command

ENDED = "planner_error: the planner ended its process (SIGSEGV; see log.txt)."


@pytest.fixture(scope="module")
def whole(tiny, tmp_path_factory):
    """Plan file, and the folder of an undisturbed run of it."""
    os.environ["DEEPMF_SUMO_HOME"] = str(tmp_path_factory.mktemp("home"))
    folder = tmp_path_factory.mktemp("whole")
    file = tiny_plan.write(tiny)
    results = plans.run(plans.load(file), options(folder))
    assert [one["status"] for one in results] == ["ok"] * 8, results
    return file, folder


def options(folder, **more):
    return batch.Options(out=folder, sumo=False, **more)


def rows(file):
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


def test_rows_are_in_plan_order_with_denominators(whole):
    _, folder = whole
    runs = rows(folder / "runs.csv")
    assert [run["method"] for run in runs] == ["none"] * 4 + ["fixed"] * 4
    assert [run["planner_label"] for run in runs[:4]] == ["lane", "lane", "straight", "straight"]
    table = {(row["method"], row["planner"]): row for row in rows(folder / "table.csv")}
    fixed = table["fixed", "lane"]
    assert (fixed["scenes"], fixed["attacked"], fixed["hits"]) == ("2", "2", "1")
    assert float(fixed["collision_rate"]) == 0.5
    assert 0 < float(fixed["collision_rate_lo"]) < 0.2 < 0.8 < float(fixed["collision_rate_hi"]) < 1
    assert (fixed["n_collision_rate"], fixed["n_collision_time_s"], fixed["n_kl"]) == (
        "2",
        "1",
        "2",
    )
    assert (fixed["ok"], fixed["failed"], fixed["unfinished"]) == ("2", "0", "0")
    nobody = table["none", "lane"]
    assert (nobody["attacked"], nobody["nobody_to_attack"], nobody["collision_rate"]) == (
        "0",
        "2",
        "",
    )
    assert json.loads((folder / "summary.json").read_text())["runs"] == 8
    accidents = rows(folder / "accidents.csv")
    hits = [
        int(row["hits"]) for row in accidents if (row["method"], row["kind"]) == ("fixed", "sector")
    ]
    assert sum(hits) == 2


def test_shards_merge_to_the_whole(whole, tmp_path):
    file, folder = whole
    for number in (1, 2):
        part = plans.Shard(number=number, of=2)
        assert len(plans.run(plans.load(file), options(tmp_path / str(number), shard=part))) == 4
    results, missing = plans.merge(tmp_path / "all", [tmp_path / "1", tmp_path / "2"])
    assert (len(results), missing) == (8, [])
    assert same_bytes.differences(folder, tmp_path / "all") == []
    half, missing = plans.merge(tmp_path / "half", [tmp_path / "2"])
    assert (len(half), len(missing)) == (4, 4)
    assert {row["unfinished"] for row in rows(tmp_path / "half" / "table.csv")} == {"1"}
    with pytest.raises(UsageError, match="give each shard once"):
        plans.merge(tmp_path / "twice", [tmp_path / "1", tmp_path / "1"])
    with pytest.raises(UsageError, match="one of the shards"):
        plans.merge(tmp_path / "1", [tmp_path / "1", tmp_path / "2"])
    with pytest.raises(UsageError, match="holds 4 runs that no shard has"):
        plans.merge(tmp_path / "1", [tmp_path / "2"])  # OUT was forgotten


def test_shards_merge_wherever_their_plans_lay(whole, tmp_path):
    file, _ = whole
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for one in [file, *file.parent.glob("tiny.*")]:
        shutil.copy(one, moved)
    for number, plan in enumerate((file, moved / file.name), start=1):
        part = plans.Shard(number=number, of=2)
        plans.run(plans.load(plan), options(tmp_path / str(number), shard=part))
    results, missing = plans.merge(tmp_path / "all", [tmp_path / "1", tmp_path / "2"])
    assert (len(results), missing) == (8, [])


def test_other_plans_and_versions_are_not_merged(whole, tmp_path):
    _, folder = whole
    layout = json.loads((folder / "study.json").read_text())
    for name, changes in {"plan": {"name": "other"}, "version": {"version": "0.0.1"}}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "study.json").write_text(json.dumps(layout | changes))
    with pytest.raises(UsageError, match=r"another plan than .*\(they differ in 'name'\)"):
        plans.merge(tmp_path / "out", [folder, tmp_path / "plan"])
    with pytest.raises(UsageError, match=r"made by version 0\.0\.1"):
        plans.merge(tmp_path / "out", [folder, tmp_path / "version"])
    (tmp_path / "version" / "manifest.json").write_text('{"tool": "deepmf-sumo"}')
    with pytest.raises(UsageError, match=r"made by version 0\.0\.1"):
        plans.run(plans.load(whole[0]), options(tmp_path / "version", resume=True))
    with pytest.raises(UsageError, match="not the folder of a plan"):
        plans.merge(tmp_path / "out", [tmp_path])
    assert not (tmp_path / "out").exists()


def test_a_method_left_out_does_not_lose_its_runs_without_a_word(whole, tmp_path):
    file, folder = whole
    out = tmp_path / "out"
    shutil.copytree(folder, out)
    before = (out / "runs.csv").read_bytes(), (out / "manifest.json").read_bytes()
    text = tiny_plan.PLAN.partition("tables:")[0]
    file = tiny_plan.write(file.parent, text, "without.yaml")
    with pytest.raises(UsageError, match=r"results of 4 runs .* \(methods fixed\): --resume would"):
        plans.run(plans.load(file, without=["fixed"]), options(out, resume=True))
    assert before == ((out / "runs.csv").read_bytes(), (out / "manifest.json").read_bytes())


def test_nothing_is_lost_or_doubled_by_kills(whole, tmp_path):
    """The command is killed again and again, its workers too, then goes on to the end."""
    file, folder = whole
    out = tmp_path / "out"
    command = [
        sys.executable, "-m", "deepmf_sumo.cli.main", "run", file, "--out", out, "--resume",
        "--set", "sweep.figures=false", "--jobs", "2",
    ]  # fmt: skip
    finished: set[str] = set()
    for number in range(KILLS):
        process = subprocess.Popen(
            command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
        )
        _wait_for_runs(process, out, len(finished) + number % 3)
        if number % 2:
            _kill_a_worker(process.pid)
            time.sleep(0.3)
        process.kill()
        process.wait()
        now = {path.name for path in (out / "runs").glob("[!.]*")} if out.exists() else set()
        assert finished <= now, "a finished run is lost"
        finished = {name for name in now if _status(out, name) == "ok"}
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert same_bytes.differences(folder, out) == []
    ids = [row["run_id"] for row in rows(out / "runs.csv")]
    assert len(ids) == len(set(ids)) == 8
    assert {path.name for path in (out / "runs").iterdir()} == set(ids)


KILLS = int(os.environ.get("DEEPMF_SUMO_TEST_KILLS", "2"))


def _status(out, run_id):
    return json.loads((out / "runs" / run_id / "result.json").read_text())["status"]


def _kill_a_worker(parent):
    """Kill the youngest worker; the run that it did becomes a failed one."""
    try:
        children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
        workers = [
            pid for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
        ]
        os.kill(int(workers[-1]), signal.SIGKILL)
    except (OSError, IndexError):
        return  # the command has just ended


def _wait_for_runs(process, out, count):
    """Until so many runs are finished, or the command is."""
    end = time.monotonic() + 60
    while time.monotonic() < end and process.poll() is None:
        if len(list((out / "runs").glob("[!.]*"))) >= count + 1:
            return
        time.sleep(0.02)


def test_a_time_limit_leaves_a_table_that_says_what_is_missing(whole, tmp_path):
    file, folder = whole
    out = tmp_path / "out"
    results = plans.run(plans.load(file), options(out, minutes=1e-6))
    assert len(results) < 8
    left = sum(int(row["unfinished"]) for row in rows(out / "table.csv"))
    assert left == 8 - len(results)
    assert json.loads((out / "summary.json").read_text())["interrupted"]
    plans.run(plans.load(file), options(out, resume=True))
    assert same_bytes.differences(folder, out) == []


BAD = """
import time
from bad_planners import _Planner, Crash, Hang, Raise

class Hungry(_Planner):
    def go_wrong(self):
        self.held = []
        while True:
            self.held.append(bytearray(50_000_000))
            time.sleep(0.01)
"""


def test_runs_that_go_wrong_are_rows_with_their_status(tiny, tmp_path, monkeypatch):
    (tiny / "worse_planners.py").write_text(BAD)
    monkeypatch.syspath_prepend(str(tiny))
    planners = ", ".join(
        f"{name}: {{name: 'worse_planners:{name}'}}"
        for name in ("Crash", "Hang", "Raise", "Hungry")
    )
    text = tiny_plan.PLAN.replace("planners: {", f"planners: {{{planners}, ")
    text = text.replace("  - {network: tiny.sumocfg, start_s: 2.0, av: {vehicle: av}}\n", "")
    file = tiny_plan.write(tiny, text, "bad.yaml")
    loaded = plans.load(file, ["tables={}"], without=["none"])
    results = plans.run(loaded, options(tmp_path, jobs=2, timeout_s=12.0, memory_mb=900.0))
    found = {one["planner_label"]: (one["status"], one["error"]) for one in results}
    assert found["Crash"] == ("failed", ENDED)
    assert found["Hang"] == ("timeout", "longer than 12 s")
    assert found["Raise"][0] == "failed"
    assert found["Hungry"] == ("failed", "more than 900 MB of memory")
    assert found["lane"] == ("ok", "")
    table = {row["planner"]: row for row in rows(tmp_path / "table.csv")}
    assert (table["Hungry"]["failed"], table["Hang"]["timeout"]) == ("1", "1")
    assert table["Hungry"]["collision_rate"] == ""
    assert table["lane"]["attacked"] == "1"


def test_a_result_that_is_not_a_number_is_a_failed_run(whole, tmp_path, monkeypatch):
    from deepmf_sumo.scene import MetricValue
    from deepmf_sumo.study.plans import entries
    from deepmf_sumo.study.sweep import episode

    value = MetricValue(name="pet", value=float("nan"), unit="s", better="lower")
    monkeypatch.setattr(episode.metrics, "measured", lambda *_: [value])
    loaded = plans.load(whole[0])
    task = entries.tasks_of(entries.entries_of(loaded, tmp_path), (0,))[-1]
    (tmp_path / "runs").mkdir()
    episode.TaskRunner(runs=tmp_path / "runs", cache=tmp_path)(task)
    found = json.loads((tmp_path / "runs" / task.run_id / "result.json").read_text())
    assert found["status"] == "failed"
    assert found["error"] == "metrics.pet.value is not a finite number; the run is not used."


def test_tables_can_be_made_again(whole, tmp_path):
    _, folder = whole
    before = (folder / "table.csv").read_bytes()
    tables.write(folder)
    assert (folder / "table.csv").read_bytes() == before
    with pytest.raises(UsageError, match="not the folder of a plan"):
        tables.write(tmp_path)


def test_a_folder_with_other_files_is_refused(whole, tmp_path):
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(OutputError, match="holds other files"):
        plans.run(plans.load(whole[0]), options(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_signal_ends_the_workers_too(whole, tmp_path):
    file, _ = whole
    out = tmp_path / "out"
    process = Command("run", file, "--out", out, "--set", "sweep.figures=false")
    _wait_for_runs(process, out, 0)
    process.send_signal(signal.SIGTERM)
    process.communicate(30)
    assert process.returncode in {0, 130}
    assert (out / "table.csv").is_file()
