"""What a rollout keeps of what the AV's planner looked at."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.planners import constant_velocity, idm, replay, sumo
from deepmf_sumo.scene import SignalLink, SignalState
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.observation import LiveSignals

from tests.support import tiny_network
from tests.support.simulated_worlds import LANE_M, case_of, scene_of, straight_motion, straight_road

NETWORKS = Path(__file__).resolve().parents[3] / "sumo_nets"
RED_LIGHT = NETWORKS / "four_way/red_light_runner.sumocfg"


def run(case, planner):
    return simulate(case, planner, None, rng=np.random.default_rng(0))


def driving(folder, other_y):
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 10.0),
        "b": straight_motion(80.0, other_y, 0.0, 9.0),
    }
    return case_of(scene_of(straight_road(), motions), folder, steps=10)


@pytest.mark.parametrize("perception", ["lane", "corridor"])
def test_who_drives_ahead_is_followed(tmp_path, perception):
    rollout = run(driving(tmp_path, 0.0), idm.build(idm.Settings(perception=perception)))
    assert rollout.leaders == (("b",),) * 10


@pytest.mark.parametrize("perception", ["lane", "corridor"])
def test_who_drives_beside_is_not(tmp_path, perception):
    rollout = run(driving(tmp_path, LANE_M), idm.build(idm.Settings(perception=perception)))
    assert rollout.leaders == ((),) * 10


def test_only_a_corridor_shows_who_is_half_on_the_lane(tmp_path):
    """SUMO takes a car as one of the lane that the middle of its front is nearest to."""
    case = driving(tmp_path, 1.9)
    lane = run(case, idm.build(idm.Settings()))
    corridor = run(case, idm.build(idm.Settings(perception="corridor")))
    assert lane.leaders == ((),) * 10
    assert corridor.leaders == (("b",),) * 10


def test_planners_that_do_not_look(tmp_path):
    case = driving(tmp_path, 0.0)
    for planner in (
        replay.build(replay.Settings()),
        constant_velocity.build(constant_velocity.Settings(follow_route=True)),
    ):
        assert run(case, planner).leaders == (None,) * 10


def test_a_network(tmp_path):
    case = network_case(tiny_network.build(tmp_path), 3.0, "av", 20, seed=0)
    rollout = run(case, sumo.build(sumo.Settings()))
    assert rollout.leaders == (("leader",),) * 20


class Onlooker:
    """Keeps what it sees of the lights, every second."""

    period_steps = 10

    def __init__(self):
        self.seen = []

    def reset(self, view, rng):
        return ("runner",)

    def plan(self, view):
        self.seen.append(view.signals)
        return {}


def test_lights_of_a_network_are_those_before_each_step():
    case = network_case(RED_LIGHT, 18.7, "av", 21, seed=0)
    onlooker, planner = Onlooker(), sumo.build(sumo.Settings())
    rollout = simulate(case, planner, onlooker, rng=np.random.default_rng(0))
    assert len(rollout.signals) == 21
    assert [rollout.signals[step] for step in (0, 10, 20)] == onlooker.seen
    assert {SignalState.STOP, SignalState.GO} <= set(onlooker.seen[0].values())


def test_a_program_with_fewer_states_than_links_leaves_those_unknown():
    api = SimpleNamespace(
        trafficlight=SimpleNamespace(getRedYellowGreenState=lambda light: {"j": "rG"}[light])
    )
    links = {name: (SignalLink(light="j", index=row),) for row, name in enumerate("abc")}
    states = LiveSignals(api, links).states()
    assert states == {"a": SignalState.STOP, "b": SignalState.GO}
