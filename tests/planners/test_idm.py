"""The IDM planner's parameters, and its corridor."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.planners import idm
from deepmf_sumo.planners.perception import nearest_in_corridor
from deepmf_sumo.scene import RoadMap, SumoNet, Tracks, View
from deepmf_sumo.scene.car_following import TREIBER

from tests.support.rollout_doubles import case_of

STRAIGHT = np.array([[2.5, 0.0], [60.0, 0.0], [120.0, 0.0]])


def view_of(others, sizes=None):
    """The AV at the origin, 5 x 2 m, heading east; others as (x, y, heading, speed)."""
    table = np.array([(0.0, 0.0, 0.0, 10.0), *others], float)
    count = len(table)
    unit = np.column_stack([np.cos(table[:, 2]), np.sin(table[:, 2])])
    history = Tracks(
        ids=("av", *(f"o{number}" for number in range(len(others)))),
        kinds=("vehicle",) * count,
        size_m=np.array([(5.0, 2.0, 1.5)] + (sizes or [(4.0, 2.0, 1.5)] * len(others))),
        position_m=table[:, None, :2],
        z_m=np.zeros((count, 1)),
        heading_rad=table[:, None, 2],
        velocity_mps=(table[:, 3:] * unit)[:, None],
        valid=np.ones((count, 1), bool),
    )
    return View(
        step=10,
        dt_s=0.1,
        av_id="av",
        history=history,
        road=RoadMap(lanes={}),
        signals={},
        steps_left=80,
    )


def leader(others, path=STRAIGHT, margin=0.2, sizes=None):
    return nearest_in_corridor(view_of(others, sizes), path, margin)


def test_gap_is_from_bumper_to_rear():
    found = leader([(30.0, 0.0, 0.0, 7.0)])
    assert found.gap_m == pytest.approx(30.0 - 2.0 - 2.5)
    assert found.speed_mps == pytest.approx(7.0)


def test_oncoming_box_has_negative_speed_and_crossing_box_none():
    assert leader([(30.0, 0.0, np.pi, 7.0)]).speed_mps == pytest.approx(-7.0)
    assert leader([(30.0, 0.0, np.pi / 2, 7.0)]).speed_mps == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("y", "seen"), [(2.1, True), (2.25, False), (-2.1, True), (-2.25, False)])
def test_only_what_reaches_into_the_swept_width_counts(y, seen):
    assert (leader([(30.0, y, 0.0, 5.0)]) is not None) == seen


def test_nearest_wins_and_those_behind_or_beyond_do_not_count():
    found = leader([(80.0, 0, 0, 1.0), (40.0, 0, 0, 2.0), (-20.0, 0, 0, 3.0), (200.0, 0, 0, 4.0)])
    assert found.agent_id == "o1"
    assert leader([(-6.0, 0.0, 0.0, 12.0)]) is None
    assert leader([(200.0, 0.0, 0.0, 4.0)]) is None


@pytest.mark.parametrize("y", [-5.0, -1.7, 0.0, 2.0, 3.3])
def test_long_box_across_the_corridor_is_seen_though_no_corner_is_inside(y):
    assert leader([(30.0, y, np.pi / 2, 0.0)], sizes=[(16.0, 2.5, 3.0)]) is not None


def test_corridor_follows_the_bend():
    angle = np.linspace(0.0, np.pi / 2, 40)
    bend = np.column_stack([2.5 + 20 * np.sin(angle), 20 * (1 - np.cos(angle))])
    assert leader([(40.0, 0.0, 0.0, 0.0)], path=bend) is None
    found = leader([(22.5, 20.0, np.pi / 2, 3.0)], path=bend)
    assert found.speed_mps == pytest.approx(3.0, abs=0.3)


def test_on_a_lane_of_its_own_where_sumo_sees_nobody_the_corridor_is_used(tmp_path):
    def command(ghost_edge):
        net = SumoNet(file=tmp_path / "a.net.xml", ghost_edge=ghost_edge)
        case = replace(case_of(), net=net)
        planner = idm.build(idm.Settings(perception="lane"))
        planner.reset(case, np.random.default_rng(0))
        return planner.act(replace(view_of([(30.0, 0.0, 0.0, 7.0)]), av_path_m=STRAIGHT)).kind

    assert command("ghost") == "leader"
    assert command(None) == "sumo"


def test_published_parameters_and_overrides():
    assert idm.build(idm.Settings()).model == TREIBER
    metadrive = idm.build(plugins.settings("planners", "idm", {"parameters": "metadrive"})).model
    assert (metadrive.gap_m, metadrive.headway_s, metadrive.exponent) == (10.0, 1.5, 10.0)
    assert metadrive.desired_mps == pytest.approx(11.11, abs=0.01)
    changed = idm.build(idm.Settings(headway_s=0.8, desired_mps=20)).model
    assert (changed.headway_s, changed.desired_mps) == (0.8, 20.0)
    assert changed.gap_m == TREIBER.gap_m


def test_emergency_braking_is_never_below_comfortable_braking():
    assert idm.build(idm.Settings(decel_mps2=9.0)).model.emergency_mps2 == 9.0


@pytest.mark.parametrize("values", [{"perception": "radar"}, {"headway_s": 0}, {"gapp_m": 1.0}])
def test_wrong_settings_are_refused(values):
    with pytest.raises(PluginError):
        plugins.settings("planners", "idm", values)
