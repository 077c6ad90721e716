import dataclasses

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics import statistics

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

PATHS = {"av": straight(0, 0, 10), "b": straight(20, 0, 4)}


def measured(name, leaders, contacts=()):
    rollout = dataclasses.replace(rollout_of(PATHS, contacts=contacts), leaders=tuple(leaders))
    return plugins.load("metrics", name).measure(rollout, case_of())


def test_the_planner_followed_the_opponent():
    leaders = [()] * 5 + [("c",)] * 3 + [("c", "b")] + [None] * 21
    assert measured("planner_saw_opponent", leaders).value == 1.0
    # seen for the step after the eighth from now, contact at the thirtieth
    warning = measured("planner_warning_s", leaders, [contact_of(step=40)])
    assert warning.value == pytest.approx(2.2)
    assert measured("planner_warning_s", leaders).value is None


def test_the_planner_never_followed_the_opponent():
    leaders = [("c",)] * 30
    assert measured("planner_saw_opponent", leaders).value == 0.0
    assert "never" in measured("planner_warning_s", leaders, [contact_of(step=40)]).reason


@pytest.mark.parametrize("leaders", [[], [None] * 30])
def test_a_planner_that_looks_at_nobody(leaders):
    for name in ("planner_saw_opponent", "planner_warning_s"):
        found = measured(name, leaders, [contact_of(step=40)])
        assert (found.value, found.reason[:11]) == (None, "the planner")


def test_diversity_of_trajectories():
    line = straight(0, 0, 10)[:, :2]
    beside, shorter = line + np.array([0, 3.0]), line[:20] + np.array([4.0, 0])
    assert statistics.diversity_m([line, beside]) == pytest.approx(3.0)
    # 3, 4 and 5 m
    assert statistics.diversity_m([line, beside, shorter]) == pytest.approx(4.0)
    assert statistics.diversity_m([line]) is None
    scenes = [[line, beside], [line], [line, line]]
    assert statistics.diversity_within_m(scenes) == pytest.approx(1.5)
    assert statistics.diversity_within_m([[line]]) is None


def test_diversity_of_kinds():
    assert statistics.distinct([0, 0, 4, None]) == 2
    assert statistics.effectively_distinct([0, 1, 2, 3, None]) == pytest.approx(4.0)
    assert statistics.effectively_distinct([0] * 99 + [1]) == pytest.approx(1.06, abs=0.01)
    assert statistics.effectively_distinct([None]) == 0.0
    assert statistics.effectively_distinct(np.array([2, 2])) == pytest.approx(1.0)
