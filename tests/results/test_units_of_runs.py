"""Seeds of one spec are one unit wherever a rate has an interval."""

import pytest

from deepmf_sumo.results import run_sets
from deepmf_sumo.results.folder import summary
from deepmf_sumo.results.gate.thresholds import Thresholds, judge
from deepmf_sumo.study.plans.tables import row_of

from tests.support import gate_doubles

ONE = pytest.approx((1.0, 0.025, 1.0), abs=1e-6)
"""Of one unit that was hit, with 95 %."""


def runs(seeds):
    known = {"perception": None, "parameters": "treiber", "samples": None, "budget": {}}
    found = [gate_doubles.result("a", seed, hit=True, **known) for seed in range(seeds)]
    for one in found:
        one["metrics"] = {}
    return found


@pytest.mark.parametrize("seeds", [1, 10])
def test_of_the_summary_that_run_prints(seeds):
    assert tuple(summary(runs(seeds))["collision_rate"].values()) == ONE


@pytest.mark.parametrize("seeds", [1, 10])
def test_of_thresholds(tmp_path, seeds):
    found = run_sets.read(gate_doubles.write_folder(tmp_path / "out", runs(seeds))).runs
    limits = Thresholds.model_validate({"version": 1, "max_av_collision_rate": 0.5})
    [judged] = [one for one in judge(limits, found) if one.limit == "max_av_collision_rate"]
    assert (judged.value, judged.runs) == (1.0, seeds)
    assert judged.interval == pytest.approx((0.025, 1.0), abs=1e-6)


@pytest.mark.parametrize("seeds", [1, 10])
def test_of_tables_of_plans(seeds):
    row = row_of("fast", "lane", gate_doubles.runs_of_plan(runs(seeds)), seeds)
    assert tuple(row[f"collision_rate{end}"] for end in ("", "_lo", "_hi")) == ONE
