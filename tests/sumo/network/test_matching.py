from itertools import pairwise

import numpy as np
import pytest

from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.network.matching import (
    edge_of,
    edge_route,
    lane_sequence,
    match,
)
from deepmf_sumo.sumo.network.sumo_net import read_net


def track(scene_of, road, path):
    tracks = scene_of(road, path=path).tracks
    return tracks.position_m[0], tracks.heading_rad[0], tracks.valid[0]


def joined_in(net, route):
    joins = {link.edges for link in read_net(net.file).links if not link.starts_inside}
    return all(pair in joins for pair in pairwise(route))


@pytest.fixture(scope="module")
def net(crossing, tmp_path_factory, starts_sumo):
    return network.convert(crossing, tmp_path_factory.mktemp("nets") / "crossing")


def test_a_drive_straight_on(crossing, scene_of):
    found = lane_sequence(crossing.road, *track(scene_of, crossing.road, [(-60, -1.5), (60, -2.0)]))
    assert found == ["in0", "S0", "out0"]


def test_the_heading_tells_crossing_lanes_apart(crossing, scene_of):
    # Slowly over the junction's middle, where ways of all directions lie on top of each other.
    found = lane_sequence(crossing.road, *track(scene_of, crossing.road, [(1.75, -4), (1.75, 4)]))
    assert found == ["S1"]


def test_lanes_crossed_between_two_steps_are_filled_in(road_of, scene_of):
    rows = [
        ("a", [(0, 0), (50, 0)], {}),
        ("b", [(50, 0), (50.6, 0)], {}),
        ("c", [(50.6, 0), (99, 0)], {}),
    ]
    road = road_of(rows, [("a", "b"), ("b", "c")])
    position = np.array([[49.0, 0.0], [52.0, 0.0]])
    assert lane_sequence(road, position, np.zeros(2), np.ones(2, bool)) == ["a", "b", "c"]


def test_a_lane_change_and_no_flicker(two_lanes, scene_of):
    path = [(5, 0), (40, 0.3), (60, 3.2), (100, 3.5)]
    assert lane_sequence(two_lanes, *track(scene_of, two_lanes, path)) == ["r1", "l1", "l2"]
    wavering = [(5, 1.7), (20, 1.8), (30, 1.7), (40, 1.8), (60, 1.7)]
    assert len(lane_sequence(two_lanes, *track(scene_of, two_lanes, wavering))) == 1


def test_steps_off_the_lanes_and_missing_ones_have_none(two_lanes, scene_of):
    position, heading, valid = track(scene_of, two_lanes, [(5, 0), (40, 0), (60, 40)])
    valid = valid.copy()
    valid[:3] = False
    found = match(two_lanes, position, heading, valid)
    assert found.lane_ids[0] is None
    assert found.lane_ids[5] == "r1"
    assert found.lane_ids[-1] is None
    assert np.isinf(found.distance_m[[0, -1]]).all()
    assert found.distance_m[5] == pytest.approx(0.0, abs=1e-6)


def test_the_wrong_way_is_no_lane(two_lanes, scene_of):
    assert lane_sequence(two_lanes, *track(scene_of, two_lanes, [(70, 0), (20, 0)])) == []


def test_nobody_anywhere(two_lanes):
    nothing = np.zeros(5, bool)
    assert lane_sequence(two_lanes, np.zeros((5, 2)), np.zeros(5), nothing) == []


def test_a_route_over_the_junction_goes_on_to_the_end_of_the_net(net):
    route = edge_route(net, ["in0", "S0", "out0"])
    assert [net.lane_of[f"{edge}_0"] for edge in route] == [("in0",), ("out0",), ("far",), ()]
    assert joined_in(net, route)


def test_a_route_that_begins_in_the_junction_has_the_edges_around_it(net):
    route = edge_route(net, ["L0", "out1"], extend_m=0.0)
    assert [net.lane_of[f"{edge}_0"] for edge in route] == [("in0",), ("out1",)]
    assert net.pieces["L0"][0].sumo_lane.startswith(":")


def test_a_route_that_ends_in_the_junction_leaves_it(net):
    route = edge_route(net, ["in0", "R0"], extend_m=0.0)
    assert [net.lane_of[f"{edge}_0"] for edge in route] == [("in0",), ("out3",)]


def test_a_route_that_breaks_is_cut_there(net):
    route = edge_route(net, ["in0", "S0", "out0", "over"])
    assert route == edge_route(net, ["in0", "S0", "out0"])
    assert joined_in(net, route)
    assert net.lane_of[f"{route[1]}_0"] == ("out0",)


@pytest.mark.sumo
def test_a_lane_change_within_an_edge_is_no_break(two_lanes, scene_of, tmp_path):
    net = network.convert(scene_of(two_lanes, path=[(5, 0), (100, 0)]), tmp_path / "net")
    assert edge_route(net, ["r1", "l1", "l2"], extend_m=0.0) == (
        edge_of(net.pieces["r1"][0].sumo_lane),
        edge_of(net.pieces["r2"][0].sumo_lane),
    )


def test_no_lanes_no_route(net):
    assert edge_route(net, []) == ()
    assert edge_route(net, ["unheard of"]) == ()


@pytest.mark.sumo
def test_recorded_vehicles_get_routes_that_hold(womd, tmp_path):
    from deepmf_sumo.scene import Scene, readers

    scene = next(iter(readers.scenes([womd / "val" / "val-00002-of-00004.tfrecord.gz"])))
    assert isinstance(scene, Scene)
    net = network.convert(scene, tmp_path / "net")
    tracks = scene.tracks
    for row in range(tracks.agents):
        lanes = lane_sequence(
            scene.road, tracks.position_m[row], tracks.heading_rad[row], tracks.valid[row]
        )
        assert joined_in(net, edge_route(net, lanes))
