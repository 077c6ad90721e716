"""The opponent's path and the spec of a candidate, without SUMO."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene import Plan
from deepmf_sumo.spec import Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.shrink import candidate as module
from deepmf_sumo.study.shrink.candidate import Candidate, changes_of_plan, path_of
from deepmf_sumo.study.shrink.failure import RecordedHit

STEPS = 40


def along(speed, steps=STEPS, y=0.0):
    """(steps + 1, 3) poses from the start on, straight to the east."""
    x = speed * 0.1 * np.arange(steps + 1)
    return np.column_stack([x, np.full(steps + 1, y), np.zeros(steps + 1)])


def plan(first, poses):
    return Plan(
        agent_id="b",
        first_step=first,
        position_m=poses[:, :2],
        heading_rad=poses[:, 2],
        speed_mps=np.full(len(poses), 5.0),
    )


def failure(*plans, driven=None):
    return RecordedHit(
        run_id="r",
        planner="idm",
        task=None,
        opponent="b",
        others=("c", "d"),
        driven=along(10.0) if driven is None else driven,
        plans=plans,
        begin=0,
        contact=STEPS,
    )


@pytest.fixture
def whole():
    return Candidate(last=STEPS, contact=STEPS, only=None, plans=0)


SPEC = {
    "version": 3, "name": "r", "seed": 7, "duration_s": 8.0, "av_sees": "in_sight",
    "source": {"start_s": 5.0, "av": {"vehicle": "av"},
               "sumo_options": ["--step-length", "0.05"]},
    "planner": {"name": "idm", "perception": "corridor"},
    "adversary": {"name": "deepmf", "tries": 4}, "profile": "any", "opponents": "in_turn",
    "turns": {"longest_s": 9.0}, "budget": {"simulations": 3}, "weights": "womd",
}  # fmt: skip
OF_THE_ATTACK = {
    "name", "duration_s", "adversary", "expect", "profile", "opponents", "turns", "budget",
    "weights",
}  # fmt: skip


@pytest.mark.parametrize("seen", ["in_sight", "all"])
def test_a_spec_is_that_of_the_run_but_for_the_attack(whole, seen, tmp_path):
    network = tmp_path / "a.sumocfg"
    network.write_text("<configuration/>")
    source = SPEC["source"] | {"network": str(network)}
    given = Spec.model_validate(SPEC | {"av_sees": seen, "source": source})
    task = Task(run_id="r", spec=given, scene="s")
    found = replace(failure(), task=task)
    values = module.spec_values(whole, found, along(10.0)[1:])
    made = Spec.model_validate(values)
    for name in Spec.model_fields.keys() - OF_THE_ATTACK - {"version"}:
        assert getattr(made, name) == getattr(given, name), name
    assert not OF_THE_ATTACK & values.keys() - {"name", "duration_s", "adversary", "expect"}


def test_the_path_is_the_driven_one(whole):
    np.testing.assert_allclose(path_of(whole, failure(), along(10.0)), along(10.0)[1:])


def test_the_last_plan_goes_on_beyond_the_contact(whole):
    later = along(12.0, 60)[11:]
    driven = np.concatenate([along(10.0)[:11], later[:30]])
    found = failure(plan(1, along(10.0, 60)[1:]), plan(11, later), driven=driven)
    path = path_of(replace(whole, plans=2, last=55), found, None)
    assert len(path) == 55
    np.testing.assert_allclose(path[:10], along(10.0)[1:11])
    np.testing.assert_allclose(path[10:], later[:45])


def test_without_the_last_change_the_first_plan_is_followed(whole):
    first = along(10.0, 60)[1:]
    found = failure(plan(1, first), plan(11, along(12.0, 60)[11:]), driven=along(11.0))
    np.testing.assert_allclose(path_of(replace(whole, plans=1, last=60), found, None), first)
    assert [changes_of_plan(replace(whole, plans=n), found) for n in (1, 2)] == [0, 1]
    assert changes_of_plan(replace(whole, plans=2, begin=10), found) == 0


def test_half_of_the_deviation_is_half_way_to_the_undisturbed_motion(whole):
    driven = along(10.0)
    driven[:, 1] = np.linspace(0.0, 4.0, STEPS + 1)
    path = path_of(replace(whole, scale=0.5), failure(driven=driven), along(6.0))
    np.testing.assert_allclose(path[-1], [32.0, 2.0, 0.0])


def test_averaging_rounds_a_kink_off_and_keeps_the_start(whole):
    driven = along(10.0)
    driven[20:, 1] += 0.3 * np.arange(STEPS + 1 - 20)
    found = failure(driven=driven)
    sharp = path_of(whole, found, along(10.0))
    round_ = path_of(replace(whole, smooth=8), found, along(10.0))

    def hardest(path):
        return np.abs(np.diff(path[:, 1], 2)).max()

    assert hardest(round_) < 0.3 * hardest(sharp)
    np.testing.assert_allclose(round_[0], sharp[0], atol=1e-9)


def test_a_later_begin_starts_where_and_as_fast_as_the_undisturbed_vehicle(whole):
    driven = along(10.0)
    driven[:, 1] = 2.0
    begin = 15
    path = path_of(replace(whole, begin=begin), failure(driven=driven), along(6.0))
    assert len(path) == STEPS - begin
    calm = along(6.0)
    first = path[0] - calm[begin]
    np.testing.assert_allclose(first[:2], [0.6, 0.0], atol=0.06)
    np.testing.assert_allclose(path[-1], driven[-1], atol=1e-9)


def test_an_undisturbed_motion_that_ends_early_goes_straight_on():
    np.testing.assert_allclose(module._continued(along(6.0)[:11], 31), along(6.0, 30))


def test_a_path_goes_on_straight_after_its_plans_end():
    found = failure()
    long = Candidate(last=400, contact=50, only=None, plans=len(found.plans))
    path = path_of(long, found, None)
    assert len(path) == 400
    np.testing.assert_allclose(np.diff(path[-50:], axis=0), np.tile(path[-1] - path[-2], (49, 1)))
