from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf import candidates
from deepmf_sumo.deepmf.reference_paths import goal_paths, own_paths
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Start, Tracked, track
from deepmf_sumo.scene import Forecast, Futures, Plan
from deepmf_sumo.scene.road_users import MotionLimits

from tests.support.predictor_doubles import FanPredictor, view_of

LIMITS = MotionLimits(accel=3.0, brake=4.0, lateral=3.0)


def goals(view, count, own=None):
    """References to goals, and the AV that they lead to."""
    predictor = FanPredictor()
    own = own or predictor.predict(view, "b").modes(32)
    av = predictor.predict(view, "av").modes(32)
    situation = Situation.of(view, "b", LIMITS, unattacked=av)
    return goal_paths(situation, own_paths(own, situation.start), count), av


class Listed:
    """Log-densities as listed."""

    def __init__(self, values):
        self.values = np.array(values)

    def log_density(self, position_m):
        assert len(position_m) == len(self.values)
        return self.values


def two_modes(probability):
    futures = Futures(agent_id="b", position_m=np.zeros((2, 80, 2)), heading_rad=np.zeros((2, 80)))
    return Forecast(futures=futures, probability=np.array(probability))


def test_made_candidates_share_the_probability_by_density():
    modes = two_modes([0.75, 0.25])
    # Modes with P = 3 f: a cell of volume 3; the made ones have densities f = .05 and 10.
    density = Listed(np.log([0.25, 0.25 / 3, 0.05, 10.0]))
    shares = candidates.weights(modes, np.zeros((2, 80, 2)), density)
    weight = np.array([0.75, 0.25, 0.15, 0.75])  # the last one no likelier than the likeliest mode
    np.testing.assert_allclose(shares, weight / weight.sum())


def test_without_made_candidates_the_prediction_is_kept():
    shares = candidates.weights(two_modes([0.6, 0.4]), np.zeros((0, 80, 2)), Listed([]))
    np.testing.assert_array_equal(shares, [0.6, 0.4])


def driven(speed, position):
    still, straight = np.zeros(len(speed)), np.zeros(speed.shape)
    return Tracked(position_m=position, heading_rad=straight, speed_mps=speed, bent_m=still)


def on_the_lane(count):
    along = np.linspace(21.0, 100.0, 80)
    return np.tile(np.stack([along, np.full(80, 3.5)], axis=-1), (count, 1, 1))


def test_comfort_weighs_the_mean_square_acceleration_of_the_next_three_seconds():
    steady = np.full(80, 10.0)
    speeding = 10.0 + 0.2 * np.minimum(np.arange(1, 81), 30)  # 2 m/s2 for 3 s
    later = np.where(np.arange(80) < 30, 10.0, 20.0)  # after what counts
    tracked = driven(np.stack([steady, speeding, later]), on_the_lane(3))
    situation = Situation.of(view_of({"av": (0, 0, 0, 1.0), "b": (20, 3.5, 0, 10.0)}), "b", LIMITS)
    shares = candidates.comfortable(situation, np.full(3, 1 / 3), tracked, 0.5)
    weight = np.array([1.0, np.exp(-0.5 * 4.0), 1.0])
    np.testing.assert_allclose(shares, weight / weight.sum())
    kept = candidates.comfortable(situation, np.array([0.5, 0.3, 0.2]), tracked, 0.0)
    np.testing.assert_allclose(kept, [0.5, 0.3, 0.2])


@pytest.mark.parametrize(("start_m", "costs"), [(3.5, [0.0, 4 * 1.5]), (7.0, [0.0, 0.0])])
def test_comfort_weighs_seconds_off_the_road_of_a_vehicle_that_was_on_it(start_m, costs):
    position = on_the_lane(2)
    position[1, 15:, 1] = 7.0  # 1.25 m beyond the edge, from 1.5 s on
    if start_m == 7.0:
        position[..., 1] = 7.0
    tracked = driven(np.full((2, 80), 10.0), position)
    situation = Situation.of(
        view_of({"av": (0, 0, 0, 1.0), "b": (20, start_m, 0, 10.0)}), "b", LIMITS
    )
    shares = candidates.comfortable(situation, np.full(2, 0.5), tracked, 0.5)
    weight = np.exp(-0.5 * np.array(costs))
    np.testing.assert_allclose(shares, weight / weight.sum())


def test_tail_is_the_rest_of_the_plan_and_its_straight_continuation():
    view = view_of({"av": (0, 0, 0, 1.0), "b": (20, 0, 0, 8.0)}, step=20)
    along = np.arange(80.0)
    plan = Plan(
        agent_id="b",
        first_step=11,
        position_m=np.stack([along, 0 * along], -1),
        heading_rad=np.zeros(80),
        speed_mps=np.full(80, 10.0),
    )
    (rest,) = candidates.tail(Situation.of(view, "b", LIMITS, last=plan), 80)
    assert rest.origin == ("tail",)
    np.testing.assert_allclose(rest.position_m[0, :, 0], np.arange(10.0, 90.0))
    late = view_of({"av": (0, 0, 0, 1.0), "b": (20, 0, 0, 8.0)}, step=95)
    assert candidates.tail(Situation.of(late, "b", LIMITS, last=plan), 80) == []
    assert candidates.tail(Situation.of(view, "b", LIMITS), 80) == []


@pytest.mark.parametrize(
    "other",
    [(-8, 3.5, 0, 12.0), (60, -40, np.pi / 2, 9.0), (30, 3.5, 0, 0.0), (70, 3.0, np.pi, 11.0)],
)
def test_goals_lead_to_the_predicted_av(other):
    view = view_of({"av": (0, 0, 0, 10.0), "b": other})
    paths, av = goals(view, 32)
    assert 8 <= len(paths.limits) <= 32
    assert (paths.limits <= LIMITS.rows(1)).all()
    tracked = track(paths.position_m, Start.of(view, "b"), paths.limits)
    away = np.linalg.norm(tracked.position_m[:, None] - av.futures.position_m[None], axis=-1)
    # Most drivable ways pass within half a metre of where the AV is predicted at the same time.
    assert np.mean(away.min(axis=(1, 2)) < 0.5) > 0.8
    assert away.min(axis=(1, 2)).max() < 4.0


def test_goals_stay_within_horizon_and_count():
    view = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)})
    assert len(goals(view, 5)[0].limits) == 5
    assert len(goals(view, 0)[0].limits) == 0
    late = replace(view, steps_left=3)
    assert len(goals(late, 32)[0].limits) == 0
    assert goals(late, 32)[0].position_m.shape == (0, 80, 2)


def test_an_av_out_of_reach_gives_no_goals():
    view = view_of({"av": (0, 0, 0, 10.0), "b": (600, 300, 0, 12.0)})
    assert len(goals(view, 32)[0].limits) == 0


@pytest.mark.parametrize("moved", [0.0, 0.3, 0.5, 1.0, 3.0])
def test_modes_that_hardly_move_are_paths_too(moved):
    view = view_of({"av": (0, 0, 0, 10.0), "b": (30, 3.5, 0, 0.0)})
    share = np.minimum(np.arange(1, 81) / 20, 1.0)
    position = np.array([30, 3.5]) + moved * share[:, None] * np.array([[1.0, 0.0]])
    own = Forecast(
        futures=Futures(
            agent_id="b", position_m=np.stack([position, position]), heading_rad=np.zeros((2, 80))
        ),
        probability=np.array([0.5, 0.5]),
    )
    paths, _ = goals(view, 32, own)
    assert np.isfinite(paths.position_m).all()
