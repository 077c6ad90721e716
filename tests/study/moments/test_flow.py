"""Vehicles that pass places without an attack."""

from dataclasses import replace

import numpy as np

from deepmf_sumo.study.moments.flow import accompanied, flows
from deepmf_sumo.study.moments.moment import Flow, FoundMoments

from tests.study.moments.test_moments import traffic
from tests.study.moments.test_moments_encounters import OVER, UP, drive


def test_each_vehicle_counts_once_at_an_edge_and_on_its_way_on():
    seen = drive([(OVER, 18.3), (OVER, 20.3), (UP, 40.0)])
    found = {(one.edge, one.following): one for one in flows(seen)}
    assert found["west", ""] == Flow(edge="west", following="", vehicles=2, near=2)
    assert found["west", "east"] == Flow(edge="west", following="east", vehicles=2, near=2)
    assert found["south", "north"] == Flow(edge="south", following="north", vehicles=1, near=0)
    assert ("far", "") in found
    assert len([one for one in found if one[0] == "far"]) == 1
    late = {(one.edge, one.following) for one in flows(seen, from_s=30.0)}
    assert ("west", "") not in late
    assert ("south", "") in late


def test_somebody_is_near_as_by_looking_at_all_pairs():
    seen = traffic(apart=45.0)
    assert accompanied(seen).all()
    assert not accompanied(traffic(apart=55.0)).any()
    rng = np.random.default_rng(3)
    apart = replace(seen, position_m=rng.uniform(0.0, 300.0, seen.position_m.shape))
    found = accompanied(apart)
    for row in range(0, len(found), 37):
        same = np.flatnonzero(apart.time_s == apart.time_s[row])
        away = np.hypot(*(apart.position_m[same] - apart.position_m[row]).T)
        assert found[row] == ((away < 50.0).sum() > 1)
    bicycles = traffic(permission="bicycle")
    assert not accompanied(bicycles).any()
    assert flows(bicycles) == ()


def test_flows_are_of_the_time_after_the_warm_up():
    found = FoundMoments(
        moments=(), suitable=0, vehicles=1, begin_s=100.0, until_s=1000.0, complete=True
    )
    assert found.hours == 0.25
    assert replace(found, from_s=460.0).hours == 0.15
