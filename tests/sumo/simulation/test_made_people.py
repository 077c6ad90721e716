"""People who were put beside the road: they stand, SUMO's cars pass them, and brake on the road."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.planners import sumo
from deepmf_sumo.scene import HISTORY_STEPS, Driver, MadeRoadUser
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support import tiny_network
from tests.support.made_walkers import StepsOut, standing

NOW = HISTORY_STEPS - 1
KERB_M = -6.4
"""Right border of the tiny network's road, along x."""
BESIDE_M = KERB_M - 0.45 - 0.5


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return tiny_network.build(tmp_path_factory.mktemp("tiny"))


def run(config, *made, policy=None, steps=100, **more):
    case = replace(network_case(config, 3.0, "av", steps, seed=0), made=made, **more)
    planner = sumo.build(sumo.Settings())
    return simulate(case, planner, policy, rng=np.random.default_rng(0))


def of(rollout, agent):
    return rollout.tracks.row(agent)


def test_a_made_pedestrian_stands_where_it_was_put_for_the_whole_history(config):
    rollout = run(config, standing((120.0, BESIDE_M)))
    tracks, row = rollout.tracks, of(rollout, "made_pedestrian_1")
    assert tracks.kinds[row] == "pedestrian"
    assert tracks.size_m[row] == pytest.approx((0.9, 0.9, 1.75))
    assert tracks.valid[row].all()
    assert np.abs(tracks.position_m[row] - (120.0, BESIDE_M)).max() < 1e-9
    assert np.abs(tracks.heading_rad[row] - np.pi / 2).max() < 1e-9
    assert (rollout.driver[row] == Driver.SUMO).all()


def test_people_are_made_where_the_nearest_lane_is_closed_to_cars(tmp_path):
    """SUMO refuses a vehicle whose class may use no lane of the edge where it begins."""
    cycleway = '<edge id="cycleway" from="a" to="b" shape="0,-12 400,-12" allow="bicycle"/>'
    config = tiny_network.build(tmp_path, more_edges=cycleway)
    beside = standing((120.0, -9.0)), standing((150.0, BESIDE_M), "made_pedestrian_2")
    tracks = run(config, *beside, steps=20).tracks
    for one in beside:
        assert np.abs(tracks.position_m[tracks.row(one.id)] - one.position_m).max() < 1e-9


def test_sumos_cars_pass_a_person_at_the_kerb_as_if_nobody_stood_there(config):
    alone, beside = run(config), run(config, standing((120.0, BESIDE_M)))
    passed = beside.tracks.position_m[of(beside, "av"), -1, 0]
    assert passed > 130.0, "the car has to pass"
    for car in ("av", "leader"):
        assert (
            alone.tracks.position_m[of(alone, car)] == beside.tracks.position_m[of(beside, car)]
        ).all()


def test_a_car_brakes_for_a_person_who_walks_onto_its_lane(tmp_path):
    beside_m = -3.2 - 0.95
    policy = StepsOut(far_m=2.6, for_s=11.5)
    one_lane = tiny_network.build(tmp_path, lanes=1)
    rollout = run(one_lane, standing((170.0, beside_m)), policy=policy, steps=115)
    tracks, row = rollout.tracks, of(rollout, "made_pedestrian_1")
    assert tracks.position_m[row, :, 1].max() == pytest.approx(beside_m + 2.6, abs=0.15)
    assert not rollout.contacts
    speed, x = tracks.speed_mps[of(rollout, "av")], tracks.position_m[of(rollout, "av"), :, 0]
    assert speed[NOW] > 12.0
    assert speed[-1] < 1.0
    assert x[NOW] + 60.0 < x[-1] + 2.5 < 170.0 - 0.45
    alone = run(one_lane, steps=90)
    assert alone.tracks.position_m[of(alone, "av"), -1, 0] > 175.0, "nobody is there without it"


def test_after_the_attack_it_walks_off_the_road_and_stays(config):
    rollout = run(config, standing((200.0, BESIDE_M)), policy=StepsOut(far_m=2.6), steps=80)
    row = of(rollout, "made_pedestrian_1")
    y, driver = rollout.tracks.position_m[row, :, 1], rollout.driver[row]
    left = NOW + np.flatnonzero(driver[NOW:] == Driver.POLICY)[-1]
    assert (driver[left + 1 :] == Driver.SUMO).all()
    assert y[-1] + 0.45 <= KERB_M - 0.3
    assert rollout.tracks.speed_mps[row, -1] == 0.0
    walked = np.abs(np.diff(rollout.tracks.position_m[row, left:], axis=0)).max()
    assert walked <= 0.14 + 1e-9


def test_who_is_far_away_changes_nothing_for_others(config):
    """A twin: the person stands somewhere else, and everybody moves as before."""
    near, far = (run(config, standing(place)) for place in ((150.0, BESIDE_M), (390.0, 30.0)))
    for agent in ("av", "leader"):
        assert (
            near.tracks.position_m[of(near, agent)] == far.tracks.position_m[of(far, agent)]
        ).all()


def test_equal_runs_are_equal_to_the_last_bit(config):
    one, other = (
        run(config, standing((150.0, BESIDE_M)), policy=StepsOut(far_m=2.6)) for _ in range(2)
    )
    assert one.tracks.position_m.tobytes() == other.tracks.position_m.tobytes()


def cyclist(way, position, speed=4.0):
    return MadeRoadUser(
        id="made_cyclist_1",
        road_user="bicycle",
        position_m=np.array(position, float),
        heading_rad=0.0,
        speed_mps=speed,
        place="cyclist",
        way_m=np.array(way, float),
    )


def test_a_cyclist_rides_beside_the_lane_and_stops_at_the_end_of_its_way(config):
    y = KERB_M - 0.7
    rollout = run(config, cyclist([(60.0, y), (100.0, y)], (70.0, y)), steps=120)
    tracks, row = rollout.tracks, of(rollout, "made_cyclist_1")
    x = tracks.position_m[row, :, 0]
    assert tracks.kinds[row] == "cyclist"
    assert x[NOW] == pytest.approx(70.0)
    assert np.diff(x[: NOW + 30]) == pytest.approx(0.4)
    assert x[-1] == pytest.approx(100.0)
    assert tracks.speed_mps[row, -1] == 0.0
    assert -np.diff(tracks.speed_mps[row]).min() <= 3.0 * 0.1 + 1e-9


def test_only_names_the_made_people_who_stay(config):
    made = standing((120.0, BESIDE_M)), standing((140.0, BESIDE_M), "made_pedestrian_2")
    rollout = run(config, *made, steps=3, only=("made_pedestrian_2",))
    assert set(rollout.tracks.ids) == {"av", "made_pedestrian_2"}
