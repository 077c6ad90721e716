"""Excerpts of road maps."""

from dataclasses import replace

import numpy as np

from deepmf_sumo.scene import Lane, Neighbour, Polygon, Polyline, RoadMap, StopSign
from deepmf_sumo.training.recording.scenes import Excerpts


def lane(name, start, end, **more):
    return Lane(id=name, kind="street", centre_m=[start, end], z_m=[0.0, 0.0], **more)


def beside(name):
    return (Neighbour(lane_id=name, self_start=0, self_end=1, other_start=0, other_end=1),)


ROAD = RoadMap(
    lanes={
        "a": lane("a", (0, 0), (100, 0), next=("b",), left=beside("far")),
        "b": lane("b", (100, 0), (200, 0), previous=("a",), next=("c",)),
        "c": lane("c", (200, 0), (400, 0), previous=("b",)),
        "far": lane("far", (0, 300), (100, 300)),
    },
    lines=(Polyline(id="l", kind=1, points_m=[(0, 2), (100, 2)], z_m=[0, 0]),),
    edges=(Polyline(id="e", kind=1, points_m=[(300, 2), (400, 2)], z_m=[0, 0]),),
    stop_signs=(StopSign(id="s", position_m=(150, 5), z_m=0.0, lane_ids=("b", "c")),),
)


def test_what_is_near_stays_whole_and_names_nobody_who_is_gone():
    near = Excerpts(ROAD).near(np.array([[0.0, 0.0], [60.0, 0.0]]), 100.0)
    assert list(near.lanes) == ["a", "b"]
    assert near.lanes["b"].next == ()
    assert near.lanes["b"].previous == ("a",)
    assert near.lanes["a"].left == ()
    np.testing.assert_array_equal(near.lanes["b"].centre_m, ROAD.lanes["b"].centre_m)
    assert [line.id for line in near.lines] == ["l"]
    assert near.edges == ()
    assert [sign.lane_ids for sign in near.stop_signs] == [("b",)]


def test_who_stands_still_has_a_way_of_one_point():
    still = np.array([[50.0, 0.0], [50.0, 0.0]])
    assert list(Excerpts(ROAD).near(still, 20.0).lanes) == ["a"]


def test_everything_is_within_a_large_radius():
    near = Excerpts(ROAD).near(np.array([[0.0, 0.0]]), 1e4)
    assert near.lanes.keys() == ROAD.lanes.keys()
    assert near.lanes["a"].left == ROAD.lanes["a"].left
    assert len(near.edges) == 1


def test_what_hides_people_and_where_they_walk_is_kept():
    def area(kind, x):
        ring = [(x, 10), (x + 10, 10), (x + 10, 20)]
        return Polygon(id=f"{kind} {x}", kind=kind, points_m=ring, z_m=[0, 0, 0])

    road = replace(
        ROAD,
        buildings=(area("building", 900), area("building", 0)),
        water=(area("water", 0), area("water", 900)),
        footways=(area("footway", 0), area("track", 900)),
    )
    way = np.array([[0.0, 0.0], [60.0, 0.0]])
    near = Excerpts(road).near(way, 100.0)
    assert [one.id for one in near.buildings] == ["building 0"]
    assert [one.id for one in near.water] == ["water 0"]
    assert [one.id for one in near.footways] == ["footway 0"]
    assert Excerpts(ROAD).near(way, 100.0).footways is None
    assert Excerpts(replace(ROAD, footways=())).near(way, 100.0).footways == ()
