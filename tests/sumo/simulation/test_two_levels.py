"""A road above another: who passes over the AV does not meet it, who comes down to it does."""

import numpy as np
import pytest
import shapely

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.planners import constant_velocity, idm, sumo
from deepmf_sumo.scene import Plan
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support import two_levels
from tests.support.predictor_doubles import Doubles

BRIDGE_S, RAMP_S = 4.0, 30.0


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return two_levels.build(tmp_path_factory.mktemp("levels"))


def run(config, start_s, steps, policy=None, planner=sumo):
    case = network_case(config, start_s, "av", steps, seed=0)
    planner = planner.build(planner.Settings())
    return case, simulate(case, planner, policy, rng=np.random.default_rng(0))


def overlapping(rollout, other):
    """Steps after now at which two boxes overlap seen from above, by shapely."""
    tracks = rollout.tracks
    pair = [tracks.row("av"), tracks.row(other)]
    steps = np.flatnonzero(tracks.valid[pair].all(axis=0))
    shapes = [
        shapely.polygons(
            boxes.corners(
                tracks.position_m[row, steps],
                tracks.heading_rad[row, steps],
                tracks.size_m[row, :2],
            )
        )
        for row in pair
    ]
    met = shapely.area(shapely.intersection(*shapes)) > 1e-9
    return steps[met & (steps > rollout.now)]


class Straight:
    """Drives a vehicle on as it points, at its speed."""

    period_steps = None

    def __init__(self, name):
        self.name = name

    def reset(self, view, rng):
        return (self.name,)

    def plan(self, view):
        row = view.history.row(self.name)
        heading = float(view.history.heading_rad[row, -1])
        speed = float(view.history.speed_mps[row, -1])
        way = speed * 0.1 * np.arange(1, 141)[:, None] * [np.cos(heading), np.sin(heading)]
        return {
            self.name: Plan(
                agent_id=self.name,
                first_step=view.step + 1,
                position_m=view.history.position_m[row, -1] + way,
                heading_rad=np.full(140, heading),
                speed_mps=np.full(140, speed),
            )
        }


@pytest.mark.parametrize("policy", [None, Straight("over")])
def test_who_drives_over_the_av_on_a_bridge_does_not_meet_it(config, policy):
    _, rollout = run(config, BRIDGE_S, 130, policy)
    assert len(overlapping(rollout, "over")) > 3  # seen from above they do
    assert not rollout.contacts
    assert rollout.ended == "time"
    tracks = rollout.tracks
    row, there = tracks.row("over"), tracks.valid[tracks.row("over")]
    # SUMO says where the bumper is, 2.5 m ahead
    expected = [two_levels.height_above(y + 2.5) for y in tracks.position_m[row, there, 1]]
    np.testing.assert_allclose(tracks.z_m[row, there], expected, atol=0.45)
    np.testing.assert_array_equal(tracks.z_m[tracks.row("av")], 0.0)


def test_the_planner_does_not_brake_for_a_bridge(config):
    _, rollout = run(config, BRIDGE_S, 130, planner=idm)
    row = rollout.tracks.row("av")
    assert rollout.tracks.speed_mps[row, rollout.now :].min() > 9.0
    assert not any("over" in (leaders or ()) for leaders in rollout.leaders)


def test_who_comes_down_the_ramp_meets_the_av_where_the_roads_join(config):
    _, rollout = run(config, RAMP_S, 140, Straight("joins"), constant_velocity)
    (contact,) = rollout.contacts
    assert contact.kind == "av_opponent"
    assert contact.step == overlapping(rollout, "joins")[0]
    tracks = rollout.tracks
    joins = tracks.row("joins")
    assert tracks.z_m[joins, rollout.now] > 1.0  # still coming down
    assert tracks.z_m[joins, contact.step] == pytest.approx(0.0, abs=0.8)


WISHES = {
    "plain": {},
    "sector": {"sector": "left"},
    "lawful": {"constraints": ["lawful"]},
    "fair": {"constraints": ["fair"]},
}


@pytest.mark.parametrize("wish", WISHES)
def test_an_attack_finds_no_hit_through_the_bridge(config, wish):
    settings = Settings(opponent="over", period_s=1.0, **WISHES[wish])
    _, rollout = run(config, BRIDGE_S, 80, build(settings, Doubles()))
    assert len(rollout.plans) == 8
    assert not any(plan.reason.collides.any() for plan in rollout.plans)
    assert not rollout.contacts


def test_who_passes_over_the_way_of_the_av_is_not_chosen(config):
    """It is the nearest: what scores it best knows no heights."""
    settings = Settings(form={"tried_opponents": 1})
    _, rollout = run(config, BRIDGE_S, 5, build(settings, Doubles()))
    assert rollout.opponent_id == "leads"
    assert "over" in rollout.tracks.ids
    assert rollout.plans[0].reason.scores.ids == ("leads",)


METRICS = ("ttc_min", "pet", "drac_max", "required_deceleration", "min_gap", "time_to_spare")


def test_measures_of_conflict(config):
    """None through the bridge, where 5.5 m are left beyond the clearance; some at the ramp."""
    case, rollout = run(config, BRIDGE_S, 130, Straight("over"))
    found = {name: plugins.load("metrics", name).measure(rollout, case).value for name in METRICS}
    assert found["min_gap"] == pytest.approx(two_levels.BRIDGE_M - 2.5, abs=0.3)
    assert found["ttc_min"] is None
    assert (found["pet"], found["time_to_spare"]) == (None, None)
    assert (found["drac_max"], found["required_deceleration"]) == (0.0, 0.0)
    case, rollout = run(config, RAMP_S, 140, Straight("joins"), constant_velocity)
    found = {name: plugins.load("metrics", name).measure(rollout, case).value for name in METRICS}
    assert (found["min_gap"], found["ttc_min"], found["pet"]) == (0.0, 0.0, 0.0)
    assert found["drac_max"] > 0.0
