"""Made people stand where people could: beside the lanes as sumolib reads them, in nobody's way."""

from pathlib import Path

import numpy as np
import pytest
import shapely
import sumolib

from deepmf_sumo.planners import sumo
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.spec import WantedPeople
from deepmf_sumo.study.moments import made_people, roadside
from deepmf_sumo.sumo.simulation import network_case, plain, simulate

from tests.support import hills, tiny_network
from tests.support.made_walkers import StepsOut

ROOT = Path(__file__).resolve().parents[3]
OTHERS = ROOT.parent / "shared" / "networks"
FOUR_WAY = ROOT / "sumo_nets" / "four_way" / "four_way.sumocfg"
PLACES = {
    FOUR_WAY: (60.0, None),
    OTHERS / "lucas4x4" / "4x4.sumocfg": (128.0, "4.40"),
    OTHERS / "cologne1" / "cologne1.sumocfg": (25230.0, "123965_406_0"),
    OTHERS / "wildau" / "flow1_Spaet.sumocfg": (54050.0, "pkwflow1.1"),
}


def rng(seed=3):
    return np.random.default_rng([seed, 7])


def situation(config, start_s, av):
    case = network_case(config, start_s, av, 60, seed=0)
    return case, plain(case)


def lane_areas(config):
    """Areas of all lanes on which anything but people on foot moves, by sumolib."""
    net_file = network_case(config, 0.0, "av").net_file
    net = sumolib.net.readNet(str(net_file), withInternal=True)
    return shapely.union_all(
        [
            shapely.LineString(lane.getShape()).buffer(lane.getWidth() / 2, cap_style="flat")
            for edge in net.getEdges(withInternal=True)
            if edge.getFunction() not in ("crossing", "walkingarea")
            for lane in edge.getLanes()
            if lane.allows("passenger") or lane.allows("bus")
        ]
    )


@pytest.fixture(scope="module")
def four_way(starts_sumo):
    case = network_case(FOUR_WAY, 202.0, "flow_e_w.18", 80, seed=42)
    return case, plain(case)


def boxes_of(made):
    for one in made:
        size = np.array([0.9, 0.9] if one.road_user == "pedestrian" else [1.8, 0.8])
        yield shapely.Polygon(boxes.corners(one.position_m, np.array(one.heading_rad), size))


def test_nobody_is_on_a_lane_and_all_are_beside_a_road(four_way):
    case, rollout = four_way
    lanes = lane_areas(FOUR_WAY)
    seen = set()
    for seed in range(8):
        drawn = made_people.drawn(case, WantedPeople(count=6), rollout, rng(seed))
        for one, box in zip(drawn.made, boxes_of(drawn.made), strict=True):
            away_m = lanes.distance(box)
            # a walker's box turns, so its side is up to 0.2 m nearer than half its diagonal
            assert 0.05 < away_m < 1.2, (one.place, away_m)
            seen.add(one.place)
            if one.way_m is not None:
                assert lanes.distance(shapely.LineString(one.way_m)) > 0.6
    assert {"kerb", "cyclist"} <= seen


def test_one_at_each_place_and_no_more_than_are_asked_for(four_way):
    case, rollout = four_way
    for count in (1, 2, 3):
        made = made_people.drawn(case, WantedPeople(count=count), rollout, rng()).made
        assert len(made) <= count
        assert len({one.place for one in made}) == len(made)
    drawn = made_people.drawn(case, WantedPeople(count=2, places=("kerb",)), rollout, rng())
    assert [one.place for one in drawn.made] == ["kerb", "kerb"]
    apart = drawn.made[0].position_m - drawn.made[1].position_m
    assert np.hypot(*apart) > 1.0


def test_the_seed_says_who_is_made(four_way):
    case, rollout = four_way
    first, again, other = (
        made_people.drawn(case, WantedPeople(), rollout, rng(seed)).made for seed in (1, 1, 2)
    )
    assert [one.position_m.tobytes() for one in first] == [
        one.position_m.tobytes() for one in again
    ]
    assert [one.position_m.tobytes() for one in first] != [
        one.position_m.tobytes() for one in other
    ]


def test_a_place_without_anybody_says_why(four_way):
    case, rollout = four_way
    drawn = made_people.drawn(case, WantedPeople(places=("stop",)), rollout, rng())
    assert not drawn.made
    assert drawn.nobody == (
        ("stop", "the AV comes to no bus stop of the network's additional files"),
    )


def test_nobody_walks_along_a_motorway(starts_sumo):
    config = ROOT / "sumo_nets" / "highway" / "highway.sumocfg"
    case, rollout = situation(config, 60.0, "flow_join.0")
    drawn = made_people.drawn(case, WantedPeople(), rollout, rng())
    assert not drawn.made
    assert dict(drawn.nobody)["kerb"] == "nobody walks along the AV's road there"


def test_who_is_made_is_in_nobodys_way(four_way):
    """The episode with them is that without them, to the last bit, for all others."""
    case, rollout = four_way
    made = made_people.drawn(case, WantedPeople(count=6), rollout, rng()).made
    assert len(made) >= 2
    with_them = plain(_with(case, made))
    assert set(with_them.tracks.ids) == {*rollout.tracks.ids, *(one.id for one in made)}
    for row, agent in enumerate(rollout.tracks.ids):
        same = with_them.tracks.row(agent)
        assert (with_them.tracks.position_m[same] == rollout.tracks.position_m[row]).all()
    assert not with_them.contacts


def _with(case, made):
    from dataclasses import replace

    return replace(case, made=made)


@pytest.mark.parametrize("config", [one for one in PLACES if one != FOUR_WAY], ids=lambda p: p.stem)
def test_on_networks_of_others_all_of_them_walk_onto_the_road_and_back(config, starts_sumo):
    """Whoever attacks: SUMO goes on, and nothing jumps (`tests/support/continuity.py`)."""
    if not config.is_file():
        pytest.skip(f"{config} is not there")
    start_s, av = PLACES[config]
    case, rollout = situation(config, start_s, str(av))
    made = made_people.drawn(case, WantedPeople(count=4), rollout, rng()).made
    driver = sumo.build(sumo.Settings())
    assert made
    for one in made:
        walk = StepsOut(one.id, one.heading_rad, far_m=5.0)
        found = simulate(_with(case, made), driver, walk, rng=rng())
        assert found.tracks.steps > 11


def test_on_a_slope_nobody_stands_on_the_road(tmp_path, starts_sumo):
    """Heights of lanes are not those of their middles: the AV starts 18 m below it."""
    config = hills.slope(tmp_path)
    case, rollout = situation(config, 1.0, "av")
    lanes = lane_areas(config)
    made = made_people.drawn(case, WantedPeople(count=6), rollout, rng()).made
    assert {"kerb", "cyclist"} == {one.place for one in made}
    for one, box in zip(made, boxes_of(made), strict=True):
        assert 0.05 < lanes.distance(box) < 1.2
        assert one.z_m == pytest.approx(hills.SLOPE * one.position_m[0], abs=0.3)


def test_what_is_on_another_storey_is_not_beside_the_way(tmp_path, starts_sumo):
    config = hills.storeys(tmp_path)
    found = {}
    for storey in ("above", "below"):
        case = network_case(config, 6.0, storey, 600, seed=0)  # that below waits for its light
        here = roadside.Roadside.of(case, plain(case))
        stands, lights = roadside.parked(here), roadside.stop_lines(here)
        crossed = list(roadside.crossings(here))
        edges = {edge.id for edge, _ in here.lanes_near}
        found[storey] = len(stands), len(lights), len(crossed), here.inside.any(), edges
    assert found["above"] == (0, 0, 0, False, {"deck"})
    assert found["below"] == (1, 1, 1, True, {"in", "out", "south", "north"})


def test_a_spec_puts_people_where_it_wants(tmp_path, starts_sumo):
    config = tiny_network.build(tmp_path)
    case, rollout = situation(config, 3.0, "av")
    given = {"position_m": [120.0, -7.5], "heading_rad": 1.5}
    people = WantedPeople(who="made", given=[given, {**given, "position_m": [90.0, -7.5]}])
    drawn = made_people.drawn(case, people, rollout, rng())
    assert [one.id for one in drawn.made] == ["made_pedestrian_1", "made_pedestrian_2"]
    assert drawn.made[0].position_m.tolist() == [120.0, -7.5]
    assert not drawn.nobody
