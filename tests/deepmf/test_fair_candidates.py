"""Which candidates a competent driver could avoid, from what the AV is predicted to do."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.deepmf import constraints
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.judge.avoidability.av_path import VehicleState
from deepmf_sumo.judge.avoidability.grading import (
    AvAhead,
    OpponentFutures,
    PastPoses,
    TakeOver,
    avoidable,
)
from deepmf_sumo.scene import Forecast, Futures
from deepmf_sumo.scene.road_users import MotionLimits

from tests.support.predictor_doubles import STEPS, view_of


def straight(agent_id, x, y, speeds):
    """A future along x; ``speeds`` (80)."""
    position = np.stack([x + np.cumsum(speeds) * 0.1, np.full(80, float(y))], -1)
    return Futures(
        agent_id=agent_id, position_m=position[None], heading_rad=np.zeros((1, len(speeds)))
    )


def forecast(futures):
    return Forecast(futures=futures, probability=np.ones(1))


def fair(view, futures, av):
    limits = MotionLimits(accel=3.0, brake=4.0, lateral=3.0)
    return constraints.fair_candidates(Situation.of(view, "b", limits), futures, av)


def test_a_driver_can_avoid_a_leader_that_slows_down_but_not_one_that_stops_dead():
    view = view_of({"av": (0, 0, 0, 15.0), "b": (30, 0, 0, 15.0)})
    av = forecast(straight("av", 0, 0, np.full(80, 15.0)))
    slow = straight("b", 30, 0, np.maximum(15.0 - 3.0 * STEPS, 0.0))
    near = view_of({"av": (0, 0, 0, 15.0), "b": (7, 0, 0, 15.0)})
    dead = straight("b", 7, 0, np.maximum(15.0 - 9.0 * STEPS, 0.0))
    assert fair(view, slow, av)[0]
    assert not fair(near, dead, av)[0]


def test_a_follower_that_an_av_meets_because_it_brakes_is_not_avoidable():
    view = view_of({"av": (0, 0, 0, 12.0), "b": (-12, 0, 0, 12.0)})
    behind = straight("b", -12, 0, np.full(80, 12.0))
    keeps = forecast(straight("av", 0, 0, np.full(80, 12.0)))
    brakes = forecast(straight("av", 0, 0, np.maximum(12.0 - 3.0 * STEPS, 0.0)))
    assert fair(view, behind, keeps)[0]
    assert not fair(view, behind, brakes)[0]


def test_a_driver_that_took_over_when_the_attack_began_has_had_time():
    """A car stands 15 m ahead of the AV at 10 m/s: too late now, but not 2 s ago."""
    steps = np.arange(1, 81)
    standing = np.zeros((1, 80, 2)), np.zeros((1, 80))
    av, car = VehicleState(np.array([-15.0, 0.0]), 0.0, 10.0), VehicleState(np.zeros(2), 0.0, 0.0)
    size = np.array([4.8, 2.0])
    ahead = np.stack([-15.0 + steps * 1.0, np.zeros(80)], -1)
    position, heading = standing
    known = (
        AvAhead(now=av, size_m=size, path_m=ahead),
        OpponentFutures(now=car, size_m=size, position_m=position, heading_rad=heading),
        0.1,
    )
    assert not avoidable(*known)[0]
    before = np.arange(20) - 20.0
    driven = np.stack([-15.0 + before, np.zeros(20), np.zeros(20)], -1)
    assert avoidable(*known, take_over=TakeOver(PastPoses(driven, np.zeros((20, 3)))))[0]


def test_a_driver_may_not_react_before_the_attack_shows():
    """The AV follows too closely: RSS brakes at once, but a driver could not know why."""
    view = view_of({"av": (0, 0, 0, 15.0), "b": (12, 0, 0, 15.0)})
    av = forecast(straight("av", 0, 0, np.full(80, 15.0)))
    speeds = np.concatenate([np.full(20, 15.0), np.maximum(15.0 - 9.0 * STEPS[:60], 0.0)])
    late = straight("b", 12, 0, speeds)
    likeliest = straight("b", 12, 0, np.full(80, 15.0))
    situation = Situation.of(view, "b", MotionLimits(accel=3.0, brake=4.0, lateral=3.0))
    driven = constraints.EpisodeHistory()
    driven.note(situation, candidates_of(likeliest))
    assert constraints.fair_candidates(situation, late, av)[0]
    assert not constraints.fair_candidates(situation, late, av, driven)[0]


def candidates_of(futures):
    known = Forecast(futures=futures, probability=np.ones(1))
    return SimpleNamespace(forecast=known, origin=("mode",))


@pytest.mark.parametrize("steps", [1, 10, 40])
def test_what_was_driven_since_the_first_plan_is_kept(steps):
    def situation(step):
        x = 1.0 * (step - 10)
        view = view_of({"av": (x, 0, 0, 10.0), "b": (x / 2, 3.5, 0, 5.0)}, step=step)
        return SimpleNamespace(view=view, opponent_id="b")

    driven = constraints.EpisodeHistory()
    own = candidates_of(straight("b", 0, 3.5, np.full(80, 5.0)))
    driven.note(situation(10), own)
    assert len(driven.past.av) == 0
    driven.note(situation(10 + steps), candidates_of(straight("b", 99, 0, np.ones(80))))
    expected = np.arange(steps)[:, None] * [[1.0, 0.0, 0.0]]
    np.testing.assert_allclose(driven.past.av, expected, atol=1e-9)
    np.testing.assert_allclose(driven.past.opponent, expected / 2 + [[0, 3.5, 0]], atol=1e-9)
    found = driven.expected_m(80)
    assert found.shape == (steps + 81, 2)
    np.testing.assert_allclose(found[1:81, 0], 0.5 * np.arange(1, 81), atol=1e-9)
    assert np.isnan(found[0]).all()
    assert np.isnan(found[81:]).all()
