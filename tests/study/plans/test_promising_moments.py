"""Moments that are drawn batch after batch: the same runs whatever the workers."""

import csv
import json
from types import SimpleNamespace

import pytest

from deepmf_sumo import spec
from deepmf_sumo.cli import main
from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.results.risk import attacks
from deepmf_sumo.spec import tasks
from deepmf_sumo.study import plans
from deepmf_sumo.study.moments import FoundMoments, Moment
from deepmf_sumo.study.plans.run import DrawRounds
from deepmf_sumo.study.sweep import batch

from tests.support import tiny_network
from tests.support.same_bytes import differences

SOURCE = "{network: tiny.sumocfg, moments: {count: 4, draw: promising}}"
EVERY = {"version": "3", "duration_s": "0.3", "seed": "4"}


def rows(file):
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


def drawn(folder, name="drawn"):
    return spec.load(tiny_network.spec(folder, name, source=SOURCE, **EVERY))


@pytest.mark.sumo
def test_workers_and_interruptions_change_nothing(tiny, tmp_path):
    whole = tmp_path / "whole"
    plans.run_specs([drawn(tiny)], batch.Options(out=whole))
    table = rows(whole / "moments.csv")
    assert [row["run_id"] for row in table] == [row["run_id"] for row in rows(whole / "runs.csv")]
    assert [(row["drawn"], row["draw"], row["pool"]) for row in table] == [
        ("spread" if number == 1 else "promising", str(number), "16") for number in range(1, 5)
    ]
    for row in table:
        result = json.loads((whole / "runs" / row["run_id"] / "result.json").read_text())
        told = result["draw"]
        assert {name: str(value) for name, value in told.items()} == {
            name: row[name] for name in told
        }
    out, seen = tmp_path / "out", []

    def interrupt(progress):
        seen.append((progress.done, progress.of))
        if progress.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plans.run_specs([drawn(tiny)], batch.Options(out=out), interrupt)
    assert seen[0] == (0, 4)
    assert seen[-1] == (2, 4)
    assert len(rows(out / "runs.csv")) == 2
    assert json.loads((out / "manifest.json").read_text())["undecided"] > 0
    kept = []
    plans.run_specs([drawn(tiny)], batch.Options(out=out, resume=True, jobs=2), kept.append)
    assert sum(one.kept for one in kept if one.last is None) == 2
    assert (kept[-1].done, kept[-1].of) == (4, 4)
    assert differences(whole, out) == []


@pytest.mark.sumo
def test_a_budget_that_ends_in_the_middle_keeps_what_it_has(tiny, tmp_path, capsys):
    file, out = tiny_network.spec(tiny, "short", source=SOURCE, **EVERY), tmp_path / "out"
    arguments = ["run", str(file), "--no-pictures", "--out", str(out)]
    assert main.run([*arguments, "--set", "sweep.max_minutes=0.00001"]) == 130
    assert "4 runs not begun: --resume goes on" in capsys.readouterr().out
    assert main.run([*arguments, "--resume"]) == 0
    assert len(rows(out / "runs.csv")) == 4


def moment(edge, number):
    return Moment(
        av=f"v{number}", av_type="car", start_s=float(number), edge=edge, following="",
        turn="along", speed_mps=10.0, around=1,
    )  # fmt: skip


def pool(edges, count):
    """A found pool in order of time, spread the other way round, its request and its runs."""
    found = FoundMoments(
        moments=tuple(moment(edge, number) for number, edge in enumerate(edges)), suitable=99,
        vehicles=9, begin_s=0.0, until_s=99.0, complete=True,
        order=tuple(reversed(range(len(edges)))),
    )  # fmt: skip
    runs = [
        tasks.Task(run_id=f"a--{number}--0", spec=None, scene=str(number))
        for number in range(len(edges))
    ]
    request = SimpleNamespace(wish=SimpleNamespace(count=count), spec=SimpleNamespace(seed=3))
    return request, found, runs


def result(task, *, finding=0.0, spare=None, status="ok", opponent="foe"):
    return {
        "run_id": task.run_id,
        "status": status,
        "opponent": opponent,
        "metrics": {"finding": {"value": finding}, "time_to_spare": {"value": spare}},
    }


@pytest.mark.parametrize("told", [{"finding": 1.0}, {"spare": 0.0}])
def test_what_came_near_is_drawn_more_often(told):
    request, found, runs = pool(["good", "bad"] * 60, 30)
    rounds = DrawRounds()
    rounds.add(request, found, runs)
    batches = [rounds.begin(runs)]
    assert {task.run_id for task in batches[0]} == {f"a--{number}--0" for number in range(110, 120)}
    assert rounds.left == 20
    results = []
    while batches[-1]:
        for task in batches[-1]:
            good = found.moments[int(task.scene)].edge == "good"
            results.append(result(task, **(told if good else {})))
        batches.append(rounds(results))
    later = [task for each in batches[1:] for task in each]
    assert [task.draw.draw for task in later] == list(range(11, 31))
    edges = [found.moments[int(task.scene)].edge for task in later]
    assert edges.count("good") >= 15
    assert rounds.left == 0
    assert [task.run_id for task, _ in rounds.drawn] == [one["run_id"] for one in results]


def test_runs_that_failed_or_attacked_nobody_say_nothing():
    request, found, runs = pool(["one", "two"] * 12, 6)
    chances = []
    for told in ({"status": "failed"}, {"opponent": None}):
        rounds = DrawRounds()
        rounds.add(request, found, runs)
        first = rounds.begin(runs)
        chances.append(
            [task.draw.probability for task in rounds([result(one, **told) for one in first])]
        )
    assert chances[0] == chances[1] == pytest.approx([1 / 22, 1 / 21][: len(chances[0])])


def test_shards_filters_plans_and_other_moments_are_refused(tiny, tmp_path):
    for options in ({"name_filter": "x"}, {"shard": object()}):
        with pytest.raises(
            UsageError, match="draw: promising the runs before decide which are next"
        ):
            plans.run_specs([drawn(tiny)], batch.Options(out=tmp_path / "no", **options))
    again = "{network: tiny.sumocfg, moments: {of: a, draw: promising}}"
    with pytest.raises(SpecError, match="draw': promising cannot be given with 'of'"):
        spec.load(tiny_network.spec(tiny, "refused", source=again))


def test_risk_counts_an_attack_for_the_moments_that_it_was_drawn_from():
    chances = {"a": 1.0, "b": 1 / 16, "c": 1 / 4, "gone": 1 / 5}
    moments = {
        run_id: {"draw": str(number), "probability": str(chance), "pool": "9"}
        for number, (run_id, chance) in enumerate(chances.items(), 1)
    }
    done = {"status": "ok", "spec": "s", "seed": 1}
    results = {"c": done, "b": done, "a": done, "gone": {**done, "status": "failed"}, "other": done}
    weights = attacks._weights(results, moments)
    assert weights.keys() == {"a", "b", "c"}
    assert sum(weights.values()) == pytest.approx(3.0)
    assert weights["b"] > 1.5 * weights["c"] > weights["a"]


def test_a_draw_whose_run_failed_does_not_change_what_the_others_stand_for():
    """Chances that are equal for all that are left: each stands for as many as the others."""
    chances = {"a": 1.0, "gone": 1 / 8, "b": 1 / 7, "c": 1 / 6}
    moments = {
        run_id: {"draw": str(number), "probability": str(chance), "pool": "9"}
        for number, (run_id, chance) in enumerate(chances.items(), 1)
    }
    results = {one: {"status": "ok", "spec": "s", "seed": 1} for one in chances}
    whole = attacks._weights(results, moments)
    results["gone"] = {**results["gone"], "status": "failed"}
    weights = attacks._weights(results, moments)
    assert weights.keys() == {"a", "b", "c"}
    assert weights["b"] == pytest.approx(weights["c"])
    assert weights["b"] / weights["a"] == pytest.approx(whole["b"] / whole["a"])
    assert sum(weights.values()) == pytest.approx(3.0)
