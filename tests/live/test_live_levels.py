"""Attacks in somebody else's simulation where one road passes over another."""

import libsumo
import numpy as np
import pytest

from deepmf_sumo.planners import sumo as plain
from deepmf_sumo.scene import Plan, TurnRules
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support import two_levels
from tests.support.live_doubles import OPTIONS, session_on, step

pytestmark = pytest.mark.sumo


class North:
    """Drives a vehicle on to the north, over the bridge."""

    period_steps = None

    def reset(self, view, rng):
        return ("over",) if "over" in view.history.ids else ()

    def plan(self, view):
        row = view.history.row("over")
        return {
            "over": Plan(
                agent_id="over",
                first_step=view.step + 1,
                position_m=view.history.position_m[row, -1]
                + np.arange(1, 81)[:, None] * [0.0, 1.0],
                heading_rad=np.full(80, np.pi / 2),
                speed_mps=np.full(80, 10.0),
            )
        }


@pytest.fixture
def sumo(tmp_path):
    config = two_levels.build(tmp_path)
    libsumo.start(["sumo", "-c", str(config), *OPTIONS, "--step-length", "0.1"])
    yield libsumo
    libsumo.close()


def test_who_drives_over_the_av_on_a_bridge_does_not_meet_it(sumo, tmp_path):
    sumo.simulationStep(5.0)
    rules = TurnRules(longest_s=8.0)
    session, fought = session_on(sumo, tmp_path, North(), rules=rules, net="levels.net.xml")
    step(sumo, session, 110)
    (attack,) = (one.rollout for one in fought)
    tracks = attack.tracks
    av, over = tracks.row("av"), tracks.row("over")
    boxes_of = [
        (tracks.position_m[row], tracks.heading_rad[row], tracks.size_m[row, :2])
        for row in (av, over)
    ]
    seen_from_above = boxes.overlap(*boxes_of[0], *boxes_of[1]) & tracks.valid[over]
    assert seen_from_above.sum() > 3
    assert (tracks.z_m[over, seen_from_above] > 7.0).all()
    assert not tracks.z_m[av].any()
    assert not attack.contacts
    assert attack.turns[0].ended != "contact"
    assert attack.turns[0].gap_m > 5.0


class OverTheSide(North):
    """Drives to the north over the bridge, and on it to the east over its side."""

    def plan(self, view):
        here = view.history.position_m[view.history.row("over"), -1]
        heading = np.interp(np.arange(80), [29, 49], [np.pi / 2, 0.2])
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        return {
            "over": Plan(
                agent_id="over",
                first_step=view.step + 1,
                position_m=here + np.cumsum(ahead, axis=0),
                heading_rad=heading,
                speed_mps=np.full(80, 10.0),
            )
        }


def test_an_opponent_does_not_fall_onto_the_road_below(sumo, tmp_path):
    """SUMO takes it for the lane below, by x and y; the world of `attack` is the twin."""
    sumo.simulationStep(5.0)
    rules = TurnRules(longest_s=7.0)
    session, fought = session_on(sumo, tmp_path, OverTheSide(), rules=rules, net="levels.net.xml")
    step(sumo, session, 100)
    case = network_case(tmp_path / "levels.sumocfg", 6.0, "av", 70, seed=0)
    planner = plain.build(plain.Settings())
    twin = simulate(case, planner, OverTheSide(), rng=np.random.default_rng(0))
    for rollout in (fought[0].rollout, twin):
        tracks = rollout.tracks
        row = tracks.row("over")
        there = tracks.valid[row] & (tracks.position_m[row, :, 1] > -39.0)
        assert there.sum() > 60
        assert tracks.z_m[row, there].min() > 7.5
        assert not rollout.contacts
