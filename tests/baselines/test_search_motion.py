"""Knots, the bicycle that drives them, and the cost of what happened."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.attacks._episodes import AgentMotion, Scouted
from deepmf_sumo.baselines._search import Bicycle, Knots, SearchSettings, Weights, cost_of
from deepmf_sumo.judge.metrics.driving import feasible
from deepmf_sumo.scene.geometry import frames

from tests.support.predictor_doubles import straight_road, view_of
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

AV = (40.0, 0.0, 0.0, 10.0)
SETTINGS = SearchSettings()


def motion_of(poses, valid=None, measured=None):
    """Motion after now of (91, 3) poses, or what is measured of it."""
    after = (poses if measured is None else measured)[11:]
    moved = np.diff(poses[10:, :2], axis=0)
    return AgentMotion(
        position_m=after[:, :2],
        heading_rad=after[:, 2],
        speed_mps=np.hypot(*moved.T) / 0.1,
        valid=np.ones(len(after), bool) if valid is None else valid,
    )


def bend(speed, radius):
    """(91, 3) poses of a car whose rear axle is on a circle to the left; at (0, 0) now."""
    rear = 0.3 * 4.8
    turn = speed * (np.arange(91) - 10) * 0.1 / radius
    x = radius * np.sin(turn) + rear * (np.cos(turn) - 1)
    y = radius * (1 - np.cos(turn)) + rear * np.sin(turn)
    return np.stack([x, y, frames.wrap(turn)], -1)


def bicycle_of(poses, valid=None, measured=None):
    reference = motion_of(poses, valid, measured)
    x, y, heading = poses[10]
    speed = float(np.hypot(*(poses[10, :2] - poses[9, :2])) / 0.1)
    view = view_of({"av": AV, "b": (x, y, heading, speed)}, road=straight_road())
    scouted = Scouted(
        view=view,
        rollout=rollout_of({"av": straight(40, 0, 10), "b": poses}, opponent_id=None),
        opponent_id="b",
        reference=reference,
        av=motion_of(straight(40, 0, 10)),
    )
    return Bicycle(scouted, SETTINGS.bounds)


def drive(bicycle, accel=0.0, steer=0.0):
    full = np.ones((1, bicycle.steps))
    return bicycle.drive(accel * full, steer * full)


class TestKnots:
    def test_controls_go_through_the_knots_and_never_beyond(self):
        knots = Knots(3, 81)
        accel, steer = knots.controls(np.array([[-1.0, 1.0, 0.5, 0.2, -0.2, 0.0]]))
        np.testing.assert_allclose(accel[0, [0, 40, 80]], [-1.0, 1.0, 0.5])
        np.testing.assert_allclose(steer[0, [0, 40, 80]], [0.2, -0.2, 0.0], atol=1e-12)
        assert np.abs(accel).max() <= 1.0
        assert (np.diff(accel[0, :41]) >= 0).all()
        assert np.abs(np.diff(accel, n=2)).max() < 0.01  # smooth

    def test_parameters_have_names(self):
        assert Knots(2, 80).names == ("accel_0", "accel_1", "steer_0", "steer_1")


class TestUnchanged:
    @pytest.mark.parametrize(
        "poses", [straight(0, 0, 10), bend(8.0, 20.0), straight(0, 0, 2, accel=1.0)]
    )
    def test_the_reference_is_driven(self, poses):
        driven = drive(bicycle_of(poses))
        assert np.hypot(*(driven.position_m[0] - poses[11:, :2]).T).max() < 0.6
        assert np.abs(frames.difference(driven.heading_rad[0], poses[11:, 2])).max() < 0.05

    def test_noise_of_a_recording_does_not_turn_the_wheel(self):
        poses = straight(0, 0, 8)
        noise = np.random.default_rng(0).normal(0, 0.01, poses.shape)
        driven = drive(bicycle_of(poses, measured=poses + noise))
        assert np.hypot(*(driven.position_m[0] - poses[11:, :2]).T).max() < 0.6
        assert np.abs(np.diff(driven.heading_rad[0])).max() < 0.02

    def test_who_stands_stays(self):
        driven = drive(bicycle_of(straight(0, 0, 0.0)))
        np.testing.assert_allclose(driven.position_m[0], 0.0, atol=1e-9)

    def test_who_vanishes_goes_on_at_its_speed_along_its_lane(self):
        driven = drive(bicycle_of(straight(0, 0, 10), valid=np.arange(80) < 5))
        np.testing.assert_allclose(driven.speed_mps[0], 10.0, atol=0.01)
        np.testing.assert_allclose(driven.position_m[0, -1], [80.0, 0.0], atol=0.1)

    def test_who_is_never_seen_again_goes_on_too(self):
        driven = drive(bicycle_of(straight(0, 0, 10), valid=np.zeros(80, bool)))
        np.testing.assert_allclose(driven.position_m[0, -1], [80.0, 0.0], atol=0.1)

    def test_off_the_lanes_it_goes_straight_on(self):
        poses = straight(0, 60, 10, heading=0.8)
        driven = drive(bicycle_of(poses, valid=np.arange(80) < 5))
        np.testing.assert_allclose(driven.position_m[0, -1], poses[-1, :2], atol=0.5)

    def test_a_gap_in_the_recording_is_bridged(self):
        valid = np.ones(80, bool)
        valid[20:40] = False
        poses = straight(0, 0, 10)
        broken = poses.copy()
        broken[31:51] = 0.0
        driven = drive(bicycle_of(poses, valid, broken))
        assert np.hypot(*(driven.position_m[0] - poses[11:, :2]).T).max() < 0.6


class TestChanged:
    def test_braking_keeps_the_path_of_a_bend(self):
        driven = drive(bicycle_of(bend(8.0, 20.0)), accel=-0.3)
        radius = np.hypot(*(driven.position_m[0] - [-0.3 * 4.8, 20.0]).T)
        assert np.abs(radius - 20.0).max() < 0.5
        assert driven.speed_mps[0, -1] == 0.0

    def test_steering_left_goes_left(self):
        assert drive(bicycle_of(straight(0, 0, 10)), steer=0.2).position_m[0, -1, 1] > 5.0
        assert drive(bicycle_of(straight(0, 0, 10)), steer=-0.2).position_m[0, -1, 1] < -5.0

    def test_one_that_stands_can_drive_off(self):
        driven = drive(bicycle_of(straight(0, 0, 0.0)), accel=0.5)
        assert driven.position_m[0, -1, 0] > 50.0
        assert abs(driven.position_m[0, -1, 1]) < 0.5

    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 10**6), st.floats(0.0, 20.0))
    def test_limits_are_kept_and_the_start_is_joined(self, seed, speed):
        bicycle = bicycle_of(straight(0, 0, speed))
        knots = Knots(5, bicycle.steps)
        points = np.random.default_rng(seed).choice([-1.0, 0.0, 1.0], (3, knots.dimensions))
        driven = bicycle.drive(*knots.controls(points))
        before = np.concatenate([np.full((3, 1), speed), driven.speed_mps[:, :-1]], axis=1)
        change = (driven.speed_mps - before) / 0.1
        assert change.min() >= -SETTINGS.brake_mps2 - 1e-6
        assert change.max() <= SETTINGS.accel_mps2 + 1e-6
        turn = frames.difference(driven.heading_rad[:, 1:], driven.heading_rad[:, :-1]) / 0.1
        fastest = np.maximum(driven.speed_mps[:, 1:], driven.speed_mps[:, :-1])
        assert (np.abs(turn) * fastest).max() <= SETTINGS.lateral_mps2 + 1e-6
        first = driven.position_m[:, 0] - [speed * 0.1, 0.0]
        assert np.hypot(*first.T).max() < 0.1

    def test_what_is_driven_is_feasible(self):
        poses = bend(9.0, 30.0)
        bicycle = bicycle_of(poses)
        knots = Knots(5, bicycle.steps)
        points = np.random.default_rng(0).uniform(-1, 1, (40, knots.dimensions))
        driven = bicycle.drive(*knots.controls(points))
        share = []
        for row in range(len(points)):
            path = np.concatenate([poses[:11, :2], driven.position_m[row]])
            heading = np.concatenate([poses[:11, 2], driven.heading_rad[row]])
            rollout = rollout_of({"av": straight(40, 0, 10), "b": np.column_stack([path, heading])})
            share.append(feasible.measure(rollout, case_of()).value)
        assert np.mean(share) == 1.0


class TestCost:
    def cost(self, paths, **more):
        rollout = rollout_of(paths, **more)
        return cost_of(rollout, case_of(), Weights(), rollout)

    def test_a_miss_costs_the_smallest_distance_between_the_boxes(self):
        cost = self.cost({"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
        assert cost.distance == pytest.approx(1.5, abs=1e-6)  # boxes of 2 m width side by side
        assert cost.late == pytest.approx(0.1)
        assert (cost.off_road, cost.third_party) == (0.0, 0.0)
        assert cost.jerk == pytest.approx(0.0, abs=1e-12)

    def test_a_contact_costs_the_less_the_earlier_it_is(self):
        paths = {"av": straight(0, 0, 10, steps=31), "b": straight(-8, 0, 12, steps=31)}
        cost = self.cost(paths, contacts=[contact_of(step=30)])
        assert (cost.distance, cost.late) == (0.0, pytest.approx(0.1 * 20 / 80))

    def test_off_road_and_third_parties_cost(self):
        paths = {"av": straight(0, 0, 10), "b": straight(0, 30, 10)}
        cost = self.cost(paths, contacts=[contact_of("opponent_other", first="b", second="c")])
        assert (cost.off_road, cost.third_party) == (1.0, 1.0)
        assert cost.total == pytest.approx(28.0 + 0.1 + 1.0 + 1.0, abs=1e-6)

    def test_jerk_costs(self):
        seconds = (np.arange(91) - 10) * 0.1
        poses = straight(0, 3.5, 10)
        poses[:, 0] += np.maximum(seconds, 0) ** 3 / 6 * 3.0
        cost = self.cost({"av": straight(0, 0, 10), "b": poses})
        assert cost.jerk == pytest.approx(0.01 * 9.0, rel=1e-3)

    def test_an_av_that_is_gone_is_far(self):
        rollout = rollout_of({"av": straight(0, 0, 10), "b": straight(-8, 0, 12)})
        object.__setattr__(rollout.tracks, "valid", np.array([[True] * 11 + [False] * 80] * 2))
        assert cost_of(rollout, case_of(), Weights(), rollout).distance == 100.0

    def test_an_opponent_on_the_unattacked_path_of_the_av_costs_if_asked(self):
        beside = rollout_of({"av": straight(0, 3.5, 10), "b": straight(-8, 0, 12)})
        far = straight(-8, 50, 12)
        unattacked = {y: rollout_of({"av": straight(0, y, 10), "b": far}) for y in (0.0, 3.5)}
        weights = Weights(av_path=5.0)
        costs = {y: cost_of(beside, case_of(), weights, one) for y, one in unattacked.items()}
        assert [one.av_path for one in costs.values()] == [5.0, 0.0]
        assert costs[0.0].total == pytest.approx(costs[3.5].total + 5.0)
        assert cost_of(beside, case_of(), Weights(), unattacked[0.0]).av_path == 0.0
