"""Attacks that aim at the AV's rollouts, in SUMO: on a network of its own and on recordings."""

from itertools import islice

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.planners import idm, replay
from deepmf_sumo.scene import Budget, Driver, RecordedCase, readers
from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.simulation import network_case
from deepmf_sumo.sumo.simulation import simulate as simulate_case

from tests.support import tiny_network
from tests.support.driven_world import driven_limits
from tests.support.predictor_doubles import Doubles
from tests.support.simulated_worlds import LANE_M, scene_of, straight_motion, straight_road
from tests.support.simulated_worlds import case_of as recorded_case_of

pytestmark = pytest.mark.sumo

NAMES = ("rule", "cat", "art", "king", "diffscene")


@pytest.fixture(autouse=True)
def doubles(monkeypatch):
    monkeypatch.setattr(weights, "cached_predictors", lambda name: Doubles())


def attack(name, case, planner, values=None):
    def simulate(policy):
        return simulate_case(case, planner, policy, rng=np.random.default_rng(0))

    if name == "art":
        values = {"restarts": 3, "iterations": 40, **(values or {})}
    settings = plugins.settings("adversaries", name, values or {})
    made = plugins.load("adversaries", name).build(settings, "open")
    return made.attack(case, simulate, Budget(), np.random.default_rng(0))


@pytest.mark.parametrize("name", NAMES)
def test_on_a_sumo_network(name, tmp_path):
    case = network_case(tiny_network.build(tmp_path), 2.0, "av", 30)
    found = attack(name, case, idm.build(idm.Settings()), {"opponent": "leader"})
    rollout = found.rollout
    assert (rollout.opponent_id, found.simulations) == ("leader", 2)
    driver = rollout.driver[rollout.tracks.row("leader"), rollout.now + 1 :]
    assert (driver == Driver.POLICY).all()
    assert found.generation_s > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_a_replayed_av_is_hit_where_it_was_aimed_at(name, tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 12.0),
        "b": straight_motion(50.0, LANE_M, 0.0, 12.0),
    }
    case = recorded_case_of(scene_of(straight_road(), motions), tmp_path)
    found = attack(name, case, replay.build(replay.Settings()))
    assert found.rollout.opponent_id == "b"
    assert found.rollout.first("av_opponent") is not None
    assert found.trials[-1].objective == 0.0


def test_recorded_scenes_are_attacked_within_limits(womd, tmp_path):
    scene = next(islice(readers.scenes([womd / "val"]), 1, None))
    case = RecordedCase(
        name=scene.name,
        road=scene.road,
        av_id=scene.av_id,
        duration_steps=80,
        traffic="log",
        seed=0,
        scene=scene,
        net=network.cached(scene, tmp_path),
    )
    found = attack("art", case, replay.build(replay.Settings()))
    accel, brake, lateral = driven_limits(found.rollout)
    assert accel <= 3.5 + 1e-6
    assert brake <= 5.0 + 1e-6
    assert lateral <= 3.5 * 1.1
