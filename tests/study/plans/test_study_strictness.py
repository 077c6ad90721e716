"""What a plan may not say, and tables of plans whose methods run on a part of it."""

import json
import time

import numpy as np
import pytest
from test_study_tables import differences, folder, result, rows  # noqa: F401 - a fixture

from deepmf_sumo.cli import _screen as screen
from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.judge.metrics import statistics
from deepmf_sumo.report import benchmark as report
from deepmf_sumo.results.folder import summary
from deepmf_sumo.study import plans
from deepmf_sumo.study.plans import layout, tables

from tests.support import tiny_plan


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("seeds=[0, 0]", r"key 'seeds': \[0, 0\]: '0' is given twice"),
        ("seeds=[0, -1]", r"key 'seeds\.1': -1"),
        ("seeds=[0, 99999999999]", r"key 'seeds\.1': 99999999999"),
        ("methods.fixed.planners=[lane, lane]", r"fixed\.planners': .*'lane' is given twice"),
        ("tables.compared=[none, none]", r"tables\.compared': .*'none' is given twice"),
        ("equal_seconds={seconds: 1.0, methods: [fixed, fixed]}", "'fixed' is given twice"),
        ("curves={methods: {fixed: {simulations: [5, 5]}}}", "'5' is given twice"),
        ("curves={methods: {fixed: {simulations: [0]}}}", r"fixed\.simulations\.0': 0"),
        ("curves={methods: {fixed: {seconds: [-1.0]}}}", r"fixed\.seconds\.0': -1"),
        ("methods.fixed.figures_only=true", "key 'tables.baseline': 'fixed' is run for figures"),
        ("methods.none={adversary: none, figures_only: true}", "'none' is run for figures"),
    ],
)  # fmt: skip
def test_plans_that_would_count_wrong_are_refused(tiny, assignment, message):
    with pytest.raises(SpecError, match=message):
        plans.load(tiny_plan.write(tiny), [assignment])


def test_a_plan_of_figures_alone_is_refused(tiny):
    sets = ["tables={}", "methods={none: {adversary: none, figures_only: true}}"]
    with pytest.raises(SpecError, match=r"key 'methods': .*figures alone"):
        plans.load(tiny_plan.write(tiny), sets)


def test_parts_of_a_plan_that_are_about_left_out_methods_alone_go(tiny):
    sets = [
        "tables={}",
        "equal_seconds={seconds: 1.0, methods: [fixed]}",
        "curves={methods: {fixed: {simulations: [5]}}}",
    ]
    plan = plans.load(tiny_plan.write(tiny), sets, without=["fixed"]).plan
    assert (list(plan.methods), plan.equal_seconds, plan.curves) == (["none"], None, None)
    with pytest.raises(SpecError, match=r"key 'equal_seconds\.methods'"):
        plans.load(tiny_plan.write(tiny), ["equal_seconds={seconds: 1.0, methods: []}"], ["none"])


def _change(folder, **changes):  # noqa: F811
    file = folder / layout.FILE
    values = json.loads(file.read_text())
    values["plan"]["methods"]["fast"].update(changes.pop("fast", {}))
    file.write_text(json.dumps(values | changes))
    tables.write(folder)


def test_runs_that_are_not_in_the_plan_are_not_unfinished(folder):  # noqa: F811
    part = json.loads((folder / layout.FILE).read_text())["equal_seconds"]
    part["scenes"] = scenes = list("abcd")
    _change(folder, fast={"scenes": {"first": 3}}, scenes=scenes, equal_seconds=part)
    fast = rows(folder / "equal_seconds.csv")[0]
    assert (fast["method"], fast["unfinished"]) == ("fast", "0")
    _change(folder, fast={"planners": ["another"]})
    assert [row["method"] for row in rows(folder / "equal_seconds.csv")] == ["slow_&_old"]
    assert {row["method"] for row in rows(folder / "accidents.csv")} == {"slow_&_old"}


def test_tables_that_the_plan_has_not_go(folder):  # noqa: F811
    assert (folder / "curves.csv").is_file()
    _change(folder, curves=None, equal_seconds=None)
    assert not (folder / "curves.csv").exists()
    assert not (folder / "equal_seconds.csv").exists()


def test_rows_of_readable_tables_are_in_the_order_asked_for(folder):  # noqa: F811
    _change(folder, compared=["slow_&_old", "fast"])
    report.finish(folder, figures=False)
    table = (folder / "table.md").read_text().split("## Table II.")[1].split("##")[0]
    assert table.index("slow_&_old") < table.index("| fast")


def test_one_scene_says_next_to_nothing():
    found = differences({"slow": [result("a", hit=False)], "fast": [result("a")]})
    rate = next(row for row in found if row["quantity"] == "collision_rate")
    assert (rate["pairs"], rate["difference"]) == (1, 1.0)
    assert (rate["difference_lo"], rate["difference_hi"]) == pytest.approx((-0.95, 1.0))


def test_a_damaged_result_is_named(folder):  # noqa: F811
    place = next((folder / "runs").iterdir()) / "result.json"
    place.write_text("{")
    with pytest.raises(UsageError, match=r"result\.json is damaged"):
        tables.write(folder)
    place.unlink()
    with pytest.raises(UsageError, match="cannot be read"):
        tables.write(folder)


def test_names_and_directions_are_not_averaged():
    metric = {"unit": "1", "better": "neither"}
    runs = [
        result(scene)
        | {"metrics": {name: metric | {"value": value} for name, value in one.items()}}
        for scene, one in (
            ("a", {"accident_type": 0.0, "pdof": 3.1, "avoidance_grade": 3.0, "pet": 1.0}),
            ("b", {"accident_type": 4.0, "pdof": -3.1, "avoidance_grade": 0.0, "pet": 2.0}),
            ("c", {"accident_type": 4.0, "pdof": None, "avoidance_grade": None, "pet": None}),
        )
    ]
    found = summary(runs)["metrics"]
    for name in ("accident_type", "pdof", "avoidance_grade"):
        assert (found[name]["mean"], found[name]["median"]) == (None, None), name
    assert found["accident_type"]["counts"] == {"0": 1, "4": 2}
    assert found["avoidance_grade"]["counts"] == {"0": 1, "3": 1}
    assert (found["pdof"]["runs"], "counts" in found["pdof"]) == (2, False)
    assert (found["pet"]["mean"], "counts" in found["pet"]) == (1.5, False)


def test_readable_tables_say_where_intervals_are_wide(folder):  # noqa: F811
    report.finish(folder, figures=False)
    text = (folder / "table.md").read_text()
    assert "Of 3 scenes intervals are wide" in text
    values = json.loads((folder / layout.FILE).read_text())
    _change(folder, plan=values["plan"] | {"seeds": [0, 1]}, scenes=[f"{n}" for n in range(20)])
    report.finish(folder, figures=False)
    text = (folder / "table.md").read_text()
    assert "intervals are wide" not in text


def test_the_screen_does_not_drop_failures(folder, capsys):  # noqa: F811
    lost = [
        {"run_id": f"run {number}", "status": "failed", "error": "why"} for number in range(12)
    ] + [{"run_id": "unread", "status": "skipped", "error": "a damaged record"}]
    screen.show_study(folder, lost[-1:], 1, [])
    assert "unread: a damaged record" in capsys.readouterr().out
    screen.show_study(folder, lost, 13, [])
    assert "and 3 more" in capsys.readouterr().out


def test_diversity_of_many_runs_takes_no_seconds():
    rng = np.random.default_rng(0)
    paths = [rng.normal(size=(steps, 2)) for steps in rng.integers(1, 17, 400)]
    few = paths[:5]
    pairs = [
        np.hypot(*(a[: len(b)] - b[: len(a)]).T).mean()
        for number, a in enumerate(few)
        for b in few[number + 1 :]
    ]
    assert statistics.diversity_m(few) == pytest.approx(np.mean(pairs))
    begin = time.process_time()
    statistics.diversity_m(paths)
    assert time.process_time() - begin < 1.0, "each row of a table waits for it"
