import csv
import json
import shutil
import time
from pathlib import Path

import pytest

from deepmf_sumo import spec
from deepmf_sumo.errors import OutputError, SpecError, UsageError
from deepmf_sumo.report.picture import draw
from deepmf_sumo.results import result
from deepmf_sumo.study.sweep import batch, workers

from tests.support import same_bytes, tiny_network

pytestmark = pytest.mark.sumo

ROOT = Path(__file__).resolve().parents[3]
CUT_IN = ROOT / "scenarios" / "cut_in.yaml"

ENDED = "planner_error: the planner ended its process (SIGSEGV; see log.txt)."


def test_same_bytes_whatever_the_number_of_jobs(tiny, tmp_path, spawned_workers):
    specs = [
        spec.load(CUT_IN, ["adversary=none", "duration_s=2.0"]),
        spec.load(tiny_network.spec(tiny, "tiny follower")),
    ]
    results = {}
    for jobs in (1, 2):
        options = batch.Options(out=tmp_path / str(jobs), jobs=jobs, draw=draw, junit=True)
        results[jobs] = batch.run(specs, options)
    assert [one["status"] for one in results[1]] == ["ok", "ok"], results[1]
    assert same_bytes.differences(tmp_path / "1", tmp_path / "2") == []
    run = tmp_path / "1" / "runs" / "tiny-follower--tiny--0"
    expected = {"spec.yaml", "result.json", "tracks.csv.gz", "plans.npz", "picture.png", "sumo"}
    assert {path.name for path in run.iterdir()} == {*expected, "log.txt"}
    with (tmp_path / "1" / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == result.COLUMNS
    assert [row["run_id"] for row in rows] == [one["run_id"] for one in results[1]]
    assert rows[1]["planner"] == "idm"
    assert float(rows[1]["simulation_s"]) > 0


def test_a_resolved_spec_repeats_its_run(tiny, tmp_path):
    first = batch.Options(out=tmp_path / "first")
    batch.run([spec.load(tiny_network.spec(tiny, "once"))], first)
    resolved = spec.load(tmp_path / "first" / "runs" / "once--tiny--0" / "spec.yaml")
    batch.run([resolved], batch.Options(out=tmp_path / "again"))
    assert same_bytes.same(tmp_path / "first", tmp_path / "again")


def test_settings_of_an_attack_may_be_dates(tiny, tmp_path, monkeypatch):
    """YAML knows them, and JSON does not."""
    monkeypatch.syspath_prepend(str(tiny))
    (tiny / "dated_attack.py").write_text(
        "from datetime import date\n"
        "from deepmf_sumo import plugins\n"
        "from deepmf_sumo.attacks import none\n"
        "class Dated:\n"
        "    class Settings(plugins.Settings):\n"
        "        day: date\n"
        "    @staticmethod\n"
        "    def build(settings, weights):\n"
        "        assert settings.day == date(2024, 2, 29)\n"
        "        return none.build(none.Settings(), weights)\n"
    )
    attack = "{name: 'dated_attack:Dated', day: 2024-02-29}"
    path = tiny_network.spec(tiny, "dated", adversary=attack)
    [found] = batch.run([spec.load(path)], batch.Options(out=tmp_path / "out"))
    assert (found["status"], found["settings"]["adversary"]) == ("ok", {"day": "2024-02-29"})


def test_bad_runs_are_rows_and_cost_nobody_else(tiny, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tiny))
    names = {"Crash": "crash", "Hang": "hang", "Raise": "bug"}
    paths = [
        tiny_network.spec(tiny, name, planner=f"{{name: 'bad_planners:{cls}'}}")
        for cls, name in names.items()
    ]
    paths.append(tiny_network.spec(tiny, "fine"))
    (tiny / "broken.sumocfg").write_text("<configuration><input></configuration>")
    broken = "{network: broken.sumocfg, av: {vehicle: av}}"
    paths.append(tiny_network.spec(tiny, "broken", source=broken))
    nobody = "{network: tiny.sumocfg, av: {vehicle: nobody}}"
    paths.append(tiny_network.spec(tiny, "nobody", source=nobody))
    options = batch.Options(out=tmp_path / "out", jobs=2, timeout_s=8.0)
    seen = []
    results = batch.run([spec.load(path) for path in paths], options, seen.append)
    found = {one["spec"]: (one["status"], one["error"]) for one in results}
    assert found["fine"] == ("ok", "")
    assert found["crash"] == ("failed", ENDED)
    assert found["hang"] == ("timeout", "longer than 8 s")
    bug = "planner_error: ZeroDivisionError: a bug of the planner (see log.txt)"
    assert found["bug"] == ("failed", bug)
    assert found["broken"][0] == found["nobody"][0] == "failed"
    assert "broken.sumocfg" in found["broken"][1]
    assert "nobody" in found["nobody"][1]
    assert batch.exit_code(results) == 3
    assert len((tmp_path / "out" / "runs.csv").read_text().splitlines()) == 7
    bug_log = (tmp_path / "out" / "runs" / "bug--tiny--0" / "log.txt").read_text()
    assert "Traceback" in bug_log
    assert seen[-1].done == seen[-1].of == 6


def test_a_planner_with_threads_that_crashes_is_blamed(tiny, tmp_path, monkeypatch):
    """It drives in the worker itself, which no copy can be made of."""
    monkeypatch.syspath_prepend(str(tiny))
    thread = "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()"
    planners = (tiny / "bad_planners.py").read_text()
    (tiny / "threaded_planners.py").write_text(f"import threading\n{planners}\n{thread}\n")
    path = tiny_network.spec(tiny, "crash", planner="{name: 'threaded_planners:Crash'}")
    [result] = batch.run([spec.load(path)], batch.Options(out=tmp_path / "out"), lambda _: None)
    assert (result["status"], result["error"], result["planner_fault"]) == (
        "failed",
        ENDED,
        "crashed",
    )
    log = (tmp_path / "out" / "runs" / "crash--tiny--0" / "log.txt").read_text()
    assert "Fatal Python error" in log
    assert "bad_planners.py" not in log
    assert "threaded_planners.py" in log  # where it was


def test_interrupt_keeps_what_is_finished_and_resumes(tiny, tmp_path):
    specs = [spec.load(tiny_network.spec(tiny, f"run {number}")) for number in range(3)]
    options = batch.Options(out=tmp_path / "out", resume=True)

    def interrupt(progress):
        if progress.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch.run(specs, options, interrupt)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["runs"], summary["interrupted"]) == (1, True)
    assert not list((tmp_path / "out" / "runs").glob(".*"))  # nothing of the runs that had begun
    seen = []
    batch.run(specs, options, seen.append)
    assert (seen[0].kept, seen[-1].done) == (1, 3)
    batch.run(specs, batch.Options(out=tmp_path / "whole"))
    assert same_bytes.differences(tmp_path / "out", tmp_path / "whole") == []


def test_a_run_that_ends_as_the_interrupt_comes_is_kept(tiny, tmp_path):
    specs = [spec.load(tiny_network.spec(tiny, f"run {number}")) for number in range(6)]
    options = batch.Options(out=tmp_path / "out", jobs=2)
    runs = tmp_path / "out" / "runs"
    kept = []

    def interrupt(progress):
        def there():
            return len(list(runs.glob("[!.]*/result.json")))

        end = time.monotonic() + 5.0  # the other worker may not have begun yet
        while 0 < progress.done == there() and time.monotonic() < end:
            time.sleep(0.01)
        if there() > progress.done:
            kept.append((progress.done, there()))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch.run(specs, options, interrupt)
    ((told, there),) = kept
    assert there == told + 1
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["runs"], summary["interrupted"]) == (there, True)


def test_a_run_counts_whose_worker_dies_before_it_says_that_it_is_done(tiny, tmp_path, monkeypatch):
    specs, out = [spec.load(tiny_network.spec(tiny, "once"))], tmp_path / "out"
    (made,) = batch.run(specs, batch.Options(out=tmp_path / "whole"))

    def finished_then_killed(store, left, options, read):
        shutil.copytree(tmp_path / "whole" / "runs" / made["run_id"], store.runs / made["run_id"])
        yield workers.Finished(index=0, status="crashed", reason="the worker died: SIGKILL")

    monkeypatch.setattr(batch, "_endings", finished_then_killed)
    (found,) = batch.run(specs, batch.Options(out=out))
    assert (found["status"], found["error"]) == ("ok", "")
    assert same_bytes.differences(tmp_path / "whole", out) == []


def test_a_run_without_a_result_fails_alone(tiny, tmp_path, monkeypatch):
    def gone(store, left, options, read):
        yield workers.Finished(index=0, status="done")

    monkeypatch.setattr(batch, "_endings", gone)
    specs = [spec.load(tiny_network.spec(tiny, "once"))]
    (found,) = batch.run(specs, batch.Options(out=tmp_path / "out"))
    assert (found["status"], found["error"]) == ("failed", "its worker has left no result")


def test_what_a_killed_sweep_began_is_gone_after_a_resume(tiny, tmp_path):
    specs, out = [spec.load(tiny_network.spec(tiny, "once"))], tmp_path / "out"
    (made,) = batch.run(specs, batch.Options(out=out))
    left = out / "runs" / f".{made['run_id']}.partial"
    left.mkdir()
    (left / "result.json").write_text("{}")
    (found,) = batch.run(specs, batch.Options(out=out, resume=True))
    assert found["status"] == "ok"
    assert [path.name for path in (out / "runs").iterdir()] == [made["run_id"]]


def test_other_settings_are_not_resumed(tiny, tmp_path):
    path = tiny_network.spec(tiny, "changed")
    options = batch.Options(out=tmp_path / "out", resume=True)
    batch.run([spec.load(path)], options)
    seen = []
    batch.run([spec.load(path, ["planner.headway_s=3.0"])], options, seen.append)
    assert seen[0].kept == 0


def test_runs_on_files_that_have_changed_are_not_resumed(tiny, tmp_path):
    options = batch.Options(out=tmp_path / "out", resume=True)
    specs = [spec.load(tiny_network.spec(tiny, f"run {number}")) for number in range(2)]
    routes = tiny / "tiny.rou.xml"
    batch.run(specs, options)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert str(routes) in manifest["machine"]["inputs"]
    routes.touch()
    seen = []
    batch.run(specs, options, seen.append)
    assert (seen[0].kept, seen[0].again) == (2, 0)
    routes.write_text(routes.read_text() + "<!-- another demand -->")
    batch.run(specs[:1], options, seen.append)
    assert (seen[1].kept, seen[1].again, seen[1].changed) == (0, 1, (str(routes),))
    seen.clear()
    batch.run(specs, options, seen.append)
    assert (seen[0].kept, seen[0].again) == (1, 1)


def test_maps_and_pages_of_earlier_runs_do_not_stand_beside_new_ones(tiny, tmp_path):
    path, out = tiny_network.spec(tiny, "mapped"), tmp_path / "out"
    options = batch.Options(out=out, resume=True)
    batch.run([spec.load(path)], options)
    (out / "risk").mkdir()
    (out / "report.html").write_text("of one run")
    batch.run([spec.load(path)], options)
    assert (out / "risk").is_dir()
    assert (out / "report.html").is_file()
    batch.run([spec.load(path, ["planner.headway_s=3.0"])], options)
    assert not (out / "risk").exists()
    assert not (out / "report.html").exists()


def test_broken_expectation(tiny, tmp_path):
    path = tiny_network.spec(tiny, "strict", expect="{av_collision: true}")
    results = batch.run([spec.load(path)], batch.Options(out=tmp_path / "out"))
    assert results[0]["expectations_broken"] == ["av_collision is false, expected true"]
    assert batch.exit_code(results) == 1
    assert 'failures="1"' in (tmp_path / "out" / "junit.xml").read_text()


def test_refused_before_anything_runs(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "run", None)
    one = spec.load(tiny_network.spec(tiny, "one"))
    out = tmp_path / "out"
    with pytest.raises(SpecError, match="Two runs are called 'one--av-2s--0'"):
        batch.run([one, one], batch.Options(out=out))
    with pytest.raises(UsageError, match="-k nothing leaves none of 1 runs"):
        batch.run([one], batch.Options(out=out, name_filter="nothing"))
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(OutputError, match="cannot be written"):
        batch.run([one], batch.Options(out=file / "out"))
    with pytest.raises(OutputError, match="holds other files"):
        batch.run([one], batch.Options(out=tmp_path))
    assert file.read_text() == "mine"
