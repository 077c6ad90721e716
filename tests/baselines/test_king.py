"""KING: gradients through kinematics and a stand-in for the AV."""

import numpy as np
import pytest
import torch

from deepmf_sumo import plugins
from deepmf_sumo.attacks._episodes import Scouted, motion_of
from deepmf_sumo.baselines import _king_descent as descent
from deepmf_sumo.baselines import king
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import Budget

from tests.support.driven_world import World, driven_limits
from tests.support.rollout_doubles import case_of

BOUNDS = descent.OpponentBounds(
    accel_change_mps2=8.0, curvature_change_per_m=0.1, accel_mps2=4.0, brake_mps2=7.0,
    lateral_mps2=4.5,
)  # fmt: skip
TERMS = descent.CostTerms(off_road=1.0, others=1.0)
STEPS = 40


def attack(world, values=None, budget=None):
    chosen = plugins.settings("adversaries", "king", {"opponent": "b", **(values or {})})
    made = plugins.load("adversaries", "king").build(chosen, "open")
    return made.attack(case_of(), world, budget or Budget(), np.random.default_rng(0))


def opponent(accel=0.0, curvature=0.0, **more):
    values = {"position_m": np.zeros(2), "heading_rad": 0.0, "speed_mps": 10.0,
              "size_m": np.array([4.8, 2.0]), **more}  # fmt: skip
    return descent.KingOpponent(
        accel_mps2=np.full(STEPS, accel), curvature_per_m=np.full(STEPS, curvature), **values
    )


def around(av_m, av_start_m, speed, others=(), road=((0.0, 0.0),), reach=1e3):
    return descent.Around(
        av_start_m=np.array(av_start_m, float), av_start_mps=speed, av_m=np.array(av_m, float),
        av_mps=np.full(STEPS, speed), av_there=np.ones(STEPS, bool),
        av_size_m=np.array([4.8, 2.0]), others_m=np.array(others).reshape(-1, STEPS, 2),
        others_reach_m=np.full(len(others), 1.0), road_m=np.array(road, float),
        road_reach_m=np.full(len(road), reach),
    )  # fmt: skip


def straight(x, y, speed):
    times = np.arange(1, STEPS + 1) * 0.2
    return np.stack([x + speed * times, np.full(STEPS, y)], -1)


BESIDE = around(straight(0, 3.5, 10), (0, 3.5), 10)


def problem(one, where=BESIDE, terms=TERMS):
    return descent._Problem(one, where, BOUNDS, terms)


def test_the_bicycle_brakes_as_by_hand():
    position, heading = problem(opponent(accel=-2.0)).place(torch.zeros(2, STEPS))
    times = np.minimum(np.arange(1, STEPS + 1) * 0.2, 5.0)  # it stands after 5 s
    np.testing.assert_allclose(position[:, 0], 10 * times - times**2, atol=1e-3)
    np.testing.assert_allclose(position[:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(heading, 0.0, atol=1e-6)


def test_the_bicycle_drives_a_circle():
    """Its rear axle, 0.3 lengths behind the centre, is on a circle of 50 m."""
    position, heading = problem(opponent(curvature=0.02)).place(torch.zeros(2, STEPS))
    direction = torch.stack([heading.cos(), heading.sin()], -1)
    rear = position - 1.44 * direction
    away = (rear - torch.tensor([-1.44, 50.0])).norm(dim=-1)
    np.testing.assert_allclose(away, 50.0, atol=0.05)
    np.testing.assert_allclose(heading, 0.02 * 2.0 * np.arange(1, STEPS + 1), rtol=1e-5)


def test_speed_limits_the_curvature():
    """At 20 m/s, 4.5 m/s2 across are a curvature of 0.01125 1/m."""
    fast = opponent(curvature=0.05, speed_mps=20.0)
    _, heading = problem(fast).place(torch.zeros(2, STEPS))
    np.testing.assert_allclose(heading, 0.01125 * 4.0 * np.arange(1, STEPS + 1), rtol=1e-4)


def test_the_stand_in_brakes_for_what_is_ahead():
    behind = around(straight(-30, 0, 10), (-30, 0), 10)
    standing = torch.zeros(STEPS, 2)
    places, course = problem(opponent(), behind)._av.answers(standing)
    assert -30 < float(places[-1, 0]) + 30 < 30 - 4.8  # it stops in time
    beside = torch.tensor([[0.0, 5.0]]).expand(STEPS, 2)
    free, _ = problem(opponent(), behind)._av.answers(beside)
    np.testing.assert_allclose(free[:, 0], straight(-30, 0, 10)[:, 0], atol=0.2)
    np.testing.assert_allclose(course, 0.0, atol=1e-6)


def test_gradients_agree_with_differences():
    torch.manual_seed(0)
    others = [straight(12, -1.5, 9)]
    one = problem(opponent(), around(straight(-2, 3.5, 10), (-2, 3.5), 10, others, reach=1.5))
    controls = (torch.rand(2, STEPS) - 0.5).mul(0.2).requires_grad_()
    (slope,) = torch.autograd.grad(one.cost(*one.place(controls))[0], controls)
    ahead = torch.randn(2, STEPS)
    with torch.no_grad():
        moved = [one.cost(*one.place(controls + step * ahead))[0] for step in (1e-3, -1e-3)]
    measured = float(moved[0] - moved[1]) / 2e-3
    assert float((slope * ahead).sum()) == pytest.approx(measured, rel=0.1)


def test_it_stops_at_the_first_collision_and_turns_towards_the_av():
    found = descent.descend(opponent(), BESIDE, BOUNDS, TERMS, 0.005, 150, np.inf)
    assert found.iterations < 150
    assert found.gap_m < 0
    assert found.position_m[:, 1].max() > 1.0
    one_look = descent.descend(opponent(), BESIDE, BOUNDS, TERMS, 0.005, 150, 0.0)
    assert (one_look.iterations, one_look.out_of_time) == (1, True)


def test_terms_count_the_road_and_others():
    zero = torch.zeros(2, STEPS)
    lone = around(straight(0, 500, 10), (0, 500), 10)
    with_one = around(straight(0, 500, 10), (0, 500), 10, [straight(0, 0, 10)])
    on_verge = around(straight(0, 500, 10), (0, 500), 10, road=straight(0, -4, 10), reach=1.5)
    cost = [float(problem(opponent(), each).cost(*problem(opponent()).place(zero))[0])
            for each in (lone, with_one, on_verge)]  # fmt: skip
    assert cost[1] - cost[0] == pytest.approx(1.0 + 2.0, abs=0.01)  # room, and two half widths
    assert cost[2] - cost[0] == pytest.approx(4.0 - 1.5, abs=0.1)


def test_it_hits_and_keeps_the_limits():
    found = attack(World())
    assert found.rollout.first("av_opponent")
    assert found.simulations == 2
    accel, brake, lateral = driven_limits(found.rollout)
    assert (accel <= 4.0 + 0.1, brake <= 7.0 + 0.1, lateral <= 4.5 + 0.5) == (True, True, True)
    again = attack(World())
    np.testing.assert_array_equal(
        found.rollout.plans[-1].position_m, again.rollout.plans[-1].position_m
    )


def test_a_miss_is_aimed_again():
    """The AV is elsewhere in the second episode, and there again in the third."""
    found = attack(World(av_y_m=(0.0, -14.0, -14.0)), {"rounds": 3, "iterations": 20})
    assert len(found.trials) >= 2
    assert {"iterations", "stand_in_gap_m", "predicted_gap_m"} == set(found.trials[0].values)


def test_without_another_vehicle_nothing_is_attacked():
    assert attack(World(others=False), {"opponent": "argmax"}).rollout.opponent_id is None


def test_the_unattacked_motion_is_fitted():
    """The controls of the unattacked motion lead along it, within 0.3 m in 8 s."""
    world = World(opponent=(-8.0, 3.5, 0.2, 12.0))
    rollout = world(None)
    view = world.view
    scouted = Scouted(
        view=view, rollout=rollout, opponent_id="b", reference=motion_of(rollout, "b", 80),
        av=motion_of(rollout, "av", 80),
    )  # fmt: skip
    one = king._opponent(scouted, Start.of(view, "b"))
    position, _ = problem(one).place(torch.zeros(2, STEPS))
    expected = scouted.reference.position_m[1::2]
    moved = position.numpy() + one.position_m
    assert np.hypot(*(moved - expected).T).max() < 0.3
