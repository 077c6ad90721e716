"""Rows, denominators, paired differences and the readable tables, on results made by hand."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.report import benchmark as report
from deepmf_sumo.report.tables import layouts
from deepmf_sumo.report.tables.text import _escaped
from deepmf_sumo.results.quantities import BY_NAME, COLUMNS
from deepmf_sumo.results.result import row as row_of_run
from deepmf_sumo.results.statistics import rate
from deepmf_sumo.spec.tasks import slug
from deepmf_sumo.study.plans import tables
from deepmf_sumo.study.plans.layout import Budgeted, PlanLayout, read_layout
from deepmf_sumo.study.plans.tables import row_of
from deepmf_sumo.tables import to_csv

from tests.support import same_bytes
from tests.support.gate_doubles import runs_of_plan


def result(scene="a", method="fast", planner="lane", hit=True, **changes):
    """A run; ``metrics`` are values by name."""
    metrics = {"acceleration_kl": 1.0, "feasible": 1.0, "third_party": 0.0, "av_third_party": 0.0}
    if hit:
        metrics |= {"collision_time_s": 2.0, "collision_speed": 5.0, "finding": 1.0}
    else:
        metrics |= {"collision_time_s": None, "collision_speed": None, "finding": 0.0}
    metrics |= changes.pop("metrics", {})
    contact = {"kind": "av_opponent", "sector": 2, "time_s": 2.0, "relative_mps": 5.0}
    one = {
        "run_id": f"{slug(method)}-on-{planner}--{scene}--0",
        "key": "key",
        "settings": {"planner": {}, "adversary": {}},
        "spec": f"{method} on {planner}",
        "scene": scene,
        "seed": 0,
        "status": "ok",
        "error": "",
        "method": method,
        "base_method": method,
        "planner_label": planner,
        "part": "main",
        "budget": {"simulations": None, "seconds": None},
        "planner": "idm",
        "perception": "lane",
        "parameters": "treiber",
        "adversary": "deepmf",
        "weights": "open",
        "version": "S1",
        "opponent": "b",
        "outcome": "av_opponent" if hit else "none",
        "ended": "contact" if hit else "time",
        "steps": 40,
        "contacts": [contact] if hit else [],
        "metrics": {name: {"value": value} for name, value in metrics.items()},
        "samples": {
            "opponent_m": [[0.0, 0.0], [5.0, 0.0]],
            "attack_mps2": [0.1],
            "recorded_mps2": [0.2],
        },
        "search": {"simulations": 1},
        "timings": {"generation_s": 0.5, "wall_s": 1.0},
        "expectations_broken": [],
    }
    return one | changes


def differences(sides):
    """Rows of the differences to the method ``slow``."""
    sides = {name: runs_of_plan(results) for name, results in sides.items()}
    return tables.differences(sides, "slow", "lane")


def failed(scene, **changes):
    one = result(scene, **changes)
    for name in ("opponent", "outcome", "contacts", "metrics", "samples", "search"):
        del one[name]
    return one | {"status": "failed", "error": "no", "timings": {"wall_s": 1.0}}


def test_a_row_counts_what_it_averages():
    results = [
        result("a", metrics={"acceleration_kl": 1.0, "avoidable": 1.0}),
        result("b", hit=False, metrics={"acceleration_kl": None, "third_party": 2.0}),
        result("c", metrics={"acceleration_kl": 3.0, "avoidable": 0.0, "feasible": 0.0}),
        result("d", opponent=None, hit=False, samples=None),
        failed("e"),
    ]
    row = row_of("fast", "lane", runs_of_plan(results), planned=7)
    assert (row["scenes"], row["runs"], row["attacked"], row["hits"]) == (5, 5, 3, 2)
    assert (row["ok"], row["failed"], row["nobody_to_attack"], row["unfinished"]) == (4, 1, 1, 2)
    expected = rate([[1.0], [0.0], [1.0]])
    assert row["collision_rate"] == pytest.approx(2 / 3)
    assert (row["collision_rate_lo"], row["collision_rate_hi"]) == (expected.low, expected.high)
    assert (row["kl"], row["n_kl"]) == (2.0, 2)
    assert (row["collision_time_s"], row["n_collision_time_s"]) == (2.0, 2)
    assert (row["avoidable_rate"], row["n_avoidable_rate"]) == (0.5, 2)
    assert (row["third_party_rate"], row["feasible_rate"]) == pytest.approx((1 / 3, 2 / 3))
    assert row["finding_rate"] == pytest.approx(2 / 3)
    assert row["n_av_other_rate"] == 4
    assert (row["sectors_hit"], row["parameters"]) == (1, "treiber")
    assert row["pooled_runs"] == 3
    assert row["sspd_m"] is None


def test_a_row_without_runs_is_empty():
    row = row_of("fast", "lane", runs_of_plan([]), planned=3)
    assert (row["unfinished"], row["attacked"], row["collision_rate"]) == (3, 0, None)
    assert list(row) == list(row_of("fast", "lane", runs_of_plan([result()]), planned=3))


def test_every_rate_is_of_zeros_and_ones():
    one = result(metrics=dict.fromkeys(("third_party", "offroad_share", "av_at_fault"), 0.3))
    for column in COLUMNS:
        if column.rate:
            assert column.value(one) in {0.0, 1.0, None}, column.name
    assert BY_NAME["offroad_rate"].value(one) == 1.0


def test_paired_differences_take_common_scenes_alone():
    ours = [result(scene, hit=hit) for scene, hit in (("a", True), ("b", True), ("c", False))]
    theirs = [result(scene, hit=False, method="slow") for scene in "abd"]
    found = differences({"slow": theirs, "fast": ours})
    rate = next(row for row in found if row["quantity"] == "collision_rate")
    assert (rate["method"], rate["pairs"], rate["difference"]) == ("fast", 2, 1.0)
    assert (rate["method_only"], rate["baseline_only"]) == (2, 0)
    speed = next(row for row in found if row["quantity"] == "collision_speed_mps")
    assert (speed["pairs"], speed["difference"], speed["difference_lo"]) == (0, None, None)


def test_interval_of_many_scenes_is_that_of_the_mean():
    rng = np.random.default_rng(0)
    values = rng.normal(1.0, 2.0, 200)
    low, high = interval([[value] for value in values])
    error = values.std(ddof=1) / np.sqrt(len(values))
    assert low == pytest.approx(values.mean() - 1.96 * error, abs=0.1)
    assert high == pytest.approx(values.mean() + 1.96 * error, abs=0.1)
    assert interval([[value] for value in values]) == (low, high)


def test_seeds_of_a_scene_are_one_unit():
    values = (0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0)
    alike = [[value] * 10 for value in values]
    apart = [[value] for value in values]
    assert interval(alike) == pytest.approx(interval(apart))


def interval(by_scene):
    """Of the difference in a row of ``differences.csv``; ``by_scene`` are those of each scene."""
    sides = {
        name: [
            result(f"scene-{scene}", name, seed=seed, metrics={"path_sspd": of(value)})
            for scene, values in enumerate(by_scene)
            for seed, value in enumerate(values)
        ]
        for name, of in (("slow", lambda value: 10.0), ("fast", lambda value: 10.0 + value))
    }
    found = differences(sides)
    row = next(row for row in found if row["quantity"] == "sspd_m")
    assert row["pairs"] == sum(map(len, by_scene))
    return row["difference_lo"], row["difference_hi"]


@pytest.fixture
def folder(tmp_path):
    """A finished benchmark of two methods with a curve, three scenes, one run of them failed."""
    runs = [result(scene, hit=scene != "a") for scene in "abc"]
    runs += [result(scene, method="slow_&_old", hit=False, adversary="brs") for scene in "ab"]
    runs += [failed("c", method="slow_&_old")]
    runs += [
        result(scene, method="slow_&_old (9 s)", base_method="slow_&_old", part="budgets",
               budget={"simulations": None, "seconds": 9.0})
        for scene in "ab"
    ]  # fmt: skip
    part = Budgeted(
        budgets={"slow_&_old": [{"simulations": None, "seconds": 9.0}]},
        planners=["lane"],
        scenes=["a", "b"],
    )
    own = {"planners": [], "scenes": "all", "budget": {"simulations": 4, "seconds": None}}
    PlanLayout(
        name="made", version=_version(), methods=["fast", "slow_&_old"], planners=["lane"],
        scenes=list("abc"), baseline="fast", versions=["fast"], compared=["fast", "slow_&_old"],
        equal_seconds=part, curves=part, runs={one["run_id"]: "key" for one in runs},
        plan={"version": 1, "seeds": [0], "duration_s": 8.0, "weights": "open",
              "methods": {"fast": own | {"adversary": "S1"},
                          "slow_&_old": own | {"adversary": {"name": "brs"}}}},
    ).write(tmp_path)  # fmt: skip
    for one in runs:
        place = tmp_path / "runs" / one["run_id"]
        place.mkdir(parents=True)
        (place / "result.json").write_text(json.dumps(one))
    (tmp_path / "runs.csv").write_text(to_csv(map(row_of_run, runs), cell=str))
    tables.write(tmp_path)
    return tmp_path


def _version():
    import deepmf_sumo

    return deepmf_sumo.__version__


def rows(file):
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


def test_other_budgets_are_points_and_no_rows_of_the_table(folder):
    assert [row["method"] for row in rows(folder / "table.csv")] == ["fast", "slow_&_old"]
    curve = rows(folder / "curves.csv")
    points = [
        (row["budget"], row["budget_simulations"], row["budget_seconds"], row["hits"])
        for row in curve
    ]
    assert points == [("own", "4", "", "0"), ("given", "", "9", "2")]
    equal = rows(folder / "equal_seconds.csv")
    assert [(row["method"], row["scenes"], row["hits"]) for row in equal] == [
        ("fast", "2", "1"), ("slow_&_old", "2", "2"),
    ]  # fmt: skip


def test_tables_say_by_which_rule_deepmf_chose():
    def layout(version=1, **methods):
        return SimpleNamespace(plan={"version": version, "methods": methods}, methods=list(methods))

    mixed = layout(
        one={"adversary": {"name": "deepmf", "version": "S1", "rule": "likeliest"}},
        two={"adversary": "S1"},
        three={"adversary": {"aggressiveness": 0.7}},
        four={"adversary": {"name": "deepmf", "form": "paper"}},
        other={"adversary": "cat"},
    )
    assert layouts.rule_title(mixed, ["one", "other"]) == (" (DeepMF: extended, rule likeliest)")
    assert layouts.rule_title(mixed, ["two"]) == " (DeepMF: extended, rule expected)"
    second = layout(version=2, two={"adversary": "S1"})
    assert layouts.rule_title(second, ["two"]) == " (DeepMF: extended, rule likeliest)"
    assert layouts.rule_title(mixed, ["four", "one"]) == (
        " (DeepMF: form paper; extended, rule likeliest)"
    )
    assert layouts.rule_title(mixed, ["other"]) == ""
    assert layouts.notes(mixed) == [
        "one: attacks chosen by likeliest, not by the paper's product (rule expected).",
        "three: attacks chosen by aggressiveness 0.7, not by the paper's product (rule expected).",
    ]


def test_readable_tables_hold_the_papers_columns_and_say_what_is_missing(folder):
    report.finish(folder, figures=False)
    text = (folder / "table.md").read_text()
    for title in (
        "Table I.",
        "Table II.",
        "Table III.",
        "Beyond the paper: fairness",
        "Beyond the paper: naturalness, variety, cost",
        "Equal time",
        "Paired",
    ):
        assert f"## {title}" in text
    assert "| fast | 2 / 3 | **67** | 2.00 | 5.00 | 0.50 |" in text
    assert "slow_&_old on lane: of 3 runs 1 failed." in text
    assert "kl [nat]: mean over attacked runs of acceleration_kl: " in text
    assert "21 bins" in text
    assert "slow_&_old: looked up: the opponent's un-attacked motion" in text
    assert "fast: looked up" not in text
    assert "Not measured, or defined in no run: " in text
    tex = (folder / "table.tex").read_text()
    assert r"slow\_\&\_old" in tex
    assert tex.count(r"\begin{tabular}") == tex.count(r"\end{tabular}") == 7
    for tabular in tex.split(r"\begin{tabular}")[1:]:
        lines = [line for line in tabular.splitlines() if line.endswith(r"\\")]
        cells = {line.count(" & ") for line in lines if "multicolumn" not in line}
        assert len(cells) == 1, lines


def test_latex_escapes_what_it_knows_as_commands():
    assert _escaped(r"50 % of a_b & {c} \d ~ ^") == (
        r"50 \% of a\_b \& \{c\} \textbackslash{}d \textasciitilde{} \textasciicircum{}"
    )


def test_layout_comes_back_as_it_was(folder):
    layout = read_layout(folder)
    layout.write(folder)
    assert read_layout(folder) == layout
    assert layout.planned("fast", "lane") == 3


def test_compare_passes_over_times_in_tables(folder, tmp_path_factory):
    import shutil

    other = tmp_path_factory.mktemp("other") / "out"
    shutil.copytree(folder, other)
    file = other / "runs" / "fast-on-lane--a--0" / "result.json"
    one = json.loads(file.read_text())
    one["timings"]["generation_s"] = 3.0
    file.write_text(json.dumps(one))
    tables.write(other)
    assert (other / "table.csv").read_bytes() != (folder / "table.csv").read_bytes()
    assert same_bytes.differences(folder, other) == []
    file = other / "runs" / "fast-on-lane--b--0" / "result.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"outcome": "none"}))
    tables.write(other)
    assert "table.csv" in same_bytes.differences(folder, other)
