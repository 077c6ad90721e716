"""Elements of networks: counted by hand, and by SUMO's own reader of networks."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sumo
import sumolib
from sumolib.net.lane import SUMO_VEHICLE_CLASSES

from deepmf_sumo.results.risk import driving, elements
from deepmf_sumo.results.risk import places as places_module
from deepmf_sumo.results.risk.elements import BETWEEN, ELEMENTS, Element
from deepmf_sumo.results.risk.places import Spot
from deepmf_sumo.sumo.network.sumo_net import NetEdge, NetLane
from deepmf_sumo.sumo.network.sumo_road import road_of_net

NETS = Path(__file__).resolve().parents[3] / "sumo_nets"
NAMES = ("arterial", "four_way", "highway", "roundabout", "rural")
LANES, LIMIT = "lanes in the AV's direction", "speed limit"


def of(name):
    return places_module.read(NETS / name / f"{name}.net.xml")


def counts(name):
    return {element: len(sites) for element, sites in elements.everywhere(of(name)).items()}


def test_the_junction_of_four_ways_is_that_of_its_drawing():
    """Twelve movements over one junction with lights; four edges to it have three lanes."""
    found = counts("four_way")
    assert tuple(found) == ELEMENTS
    assert found[Element("junction", "traffic light")] == 12
    assert found[Element(LANES, "3 lanes and more")] == 4
    assert found[Element(LANES, "2 lanes")] == 8
    assert found[Element("junction", "roundabout")] == 0
    assert found[Element("people", elements.CROSSINGS)] == 0


def test_a_ring_is_a_roundabout_with_arms_that_bend():
    """Its four arms meet it with an entry and an exit each, which bend."""
    found = counts("roundabout")
    assert found[Element("junction", "roundabout")] == 16
    assert found[Element("bend", "bend of 50 to 200 m")] == 8  # four entries and four exits
    assert not driving.merging(of("roundabout"))


def test_a_ramp_merges_with_the_road_that_it_joins():
    found = of("highway")
    assert {one.partition(": ")[2].partition(" -> ")[0] for one in driving.merging(found)} == {
        "before", "on_ramp",
    }  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_edges_are_those_that_sumo_reads(name):
    net = sumolib.net.readNet(str(NETS / name / f"{name}.net.xml"))
    edges = [edge for edge in net.getEdges() if edge.allows("passenger")]
    lanes = Counter(sum(lane.allows("passenger") for lane in edge.getLanes()) for edge in edges)
    kmh = Counter(round(edge.getSpeed() * 3.6) for edge in edges)
    found = counts(name)
    several = sum(number for lane, number in lanes.items() if lane > 2)
    assert [found[Element(LANES, one)] for one in ("1 lane", "2 lanes", "3 lanes and more")] == [
        lanes[1], lanes[2], several,
    ]  # fmt: skip
    bounds = {"up to 30 km/h": (0, 30), "30 to 50 km/h": (31, 50), "50 to 70 km/h": (51, 70),
              "70 to 100 km/h": (71, 100), "over 100 km/h": (101, 999)}  # fmt: skip
    for limit, (low, high) in bounds.items():
        expected = sum(number for speed, number in kmh.items() if low <= speed <= high)
        assert found[Element(LIMIT, limit)] == expected, limit
    rings = {node for ring in net.getRoundabouts() for node in ring.getNodes()}
    assert of(name).rings == rings


@pytest.mark.parametrize("name", NAMES)
def test_each_movement_is_over_a_junction_of_one_kind_or_none(name):
    found, places = elements.everywhere(of(name)), of(name)
    kinds = Counter(site for one, sites in found.items() if one.subject == "junction"
                    for site in sites)  # fmt: skip
    assert set(kinds) >= {("movement", one) for one in places.movements}
    assert set(kinds.values()) == {1}
    joints = {one for kind, one in found[Element("junction", BETWEEN)] if kind == "movement"}
    for one in joints:
        junction = places.movements[one].junction
        ends = {edge.start if edge.end == junction else edge.end
                for edge in places.net.edges.values()
                if not edge.function and junction in {edge.start, edge.end}}  # fmt: skip
        assert len(ends) <= 2


@pytest.mark.parametrize(
    ("radius_m", "name"),
    [(30.0, "bend below 50 m"), (48.0, "bend below 50 m"), (53.0, "bend of 50 to 200 m"),
     (190.0, "bend of 50 to 200 m"), (215.0, "straight"), (1e6, "straight")],
)  # fmt: skip
def test_the_radius_of_an_arc_is_its_bend(radius_m, name):
    angle = np.linspace(0, 60 / radius_m, 60)
    arc = radius_m * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    edge = edge_of(np.column_stack([arc, np.zeros(60)]))
    assert elements._bends(edge) == {name}
    assert elements._bend(edge, arc[30]) == name
    assert elements._bend(edge, arc[0]) == name


def edge_of(shape_m):
    lane = NetLane(
        id="e_0", edge="e", index=0, speed_mps=14.0, length_m=60.0, width_m=3.2, allow=None,
        disallow=frozenset(), shape_m=shape_m,
    )  # fmt: skip
    return NetEdge(id="e", start="a", end="b", function="", type="", lanes=(lane,))


def test_a_bend_counts_where_the_av_is():
    """A straight edge of 200 m that turns sharply at its end."""
    edge = edge_of(np.array([[0.0, 0, 0], [200, 0, 0], [206, 6, 0], [206, 40, 0]]))
    assert elements._bends(edge) == {"straight", "bend below 50 m"}
    assert elements._bend(edge, np.array([100.0, 0.0])) == "straight"
    assert elements._bend(edge, np.array([203.0, 3.0])) == "bend below 50 m"


@pytest.mark.parametrize("shape", [[[1.0, 2, 0]], [[1.0, 2, 0]] * 2, [[0.0, 0, 0], [0.5, 0.5, 0]]])
def test_an_edge_that_is_hardly_more_than_a_point_does_not_bend(shape):
    edge = edge_of(np.array(shape))
    assert elements._bends(edge) == {"straight"}
    assert elements._bend(edge, np.zeros(2)) == "straight"


def test_the_elements_of_a_place():
    places = of("four_way")
    left = next(one for one in places.movements.values() if one.turn == "left")
    over = Spot(lane=left.lanes[0], junction=left.junction, movement=left.id)
    before = Spot(lane=f"{left.origin}_0", edge=left.origin)
    there = places.lanes[before.lane].shape_m[0, :2]
    assert elements.at(places, over, there) == {
        Element("junction", "traffic light"), Element(LANES, "3 lanes and more"),
        Element(LIMIT, "30 to 50 km/h"),
    }  # fmt: skip
    assert elements.at(places, before, there) == {
        Element("junction", BETWEEN), Element(LANES, "3 lanes and more"),
        Element(LIMIT, "30 to 50 km/h"), Element("bend", "straight"),
    }  # fmt: skip
    assert elements.at(places, Spot(), there) == frozenset()


GAMES = Path(sumo.SUMO_HOME) / "tools" / "game"
ELSEWHERE = (
    "pedestrian", "wheelchair", "bicycle", "scooter", "tram", "rail", "rail_urban",
    "rail_electric", "rail_fast", "subway", "cable_car", "ship", "container", "aircraft", "drone",
)  # fmt: skip


@pytest.mark.parametrize(
    "file",
    ["DRT/osm", "bs3d/bs", "rail/net", "racing/spreewaldring"],
)
def test_places_of_vehicles_are_none_of_paths_and_tracks(file):
    """As sumolib reads the permissions: with a class that is on no rails, on foot or on a bicycle.

    Networks that come with SUMO: footpaths, cycle paths and tracks among streets, tracks alone,
    and a racing circuit of one class.
    """
    file = GAMES / f"{file}.net.xml"
    net = sumolib.net.readNet(str(file))
    old = {"public_transport", "transport", "lightrail", "cityrail", "rail_slow"}
    away = {*ELSEWHERE, *old} | {one for one in SUMO_VEHICLE_CLASSES if one.startswith("public_")}

    def road(lane):
        return bool(set(lane.getPermissions()) - away)

    edges = [one.getID() for one in net.getEdges() if any(map(road, one.getLanes()))]
    links = {
        (edge.getID(), other.getID())
        for edge in net.getEdges()
        for other, ways in edge.getOutgoing().items()
        if any(road(way.getFromLane()) and road(way.getToLane()) for way in ways)
    }
    lanes = sum(road(lane) for edge in net.getEdges() for lane in edge.getLanes())
    places = places_module.read(file)
    assert set(places.driven["edge"]) == set(edges)
    moved = [places.movements[name] for name in places.driven["movement"]]
    assert {(one.origin, one.target) for one in moved} == links
    assert sum(not one.startswith(":") for one in places.driven["lane"]) == lanes
    assert places.count("movement") == len(links)
    assert bool(edges) == (file.parent.name != "rail")
    if file.parent.name == "DRT":
        assert len(edges) < len(net.getEdges())


@pytest.mark.parametrize(
    ("edges", "lanes"),
    [
        (' function="normal"', ""),
        ("", ' allow="bus"'),
        ("", ' allow="hov evehicle"'),
        ("", ' allow="custom2"'),
        ("", ' disallow="passenger"'),
    ],
)
def test_a_network_said_in_another_way_has_the_same_elements(tmp_path, edges, lanes):
    """Edges with SUMO's name for the usual function, and roads for others than cars."""
    text = (NETS / "four_way" / "four_way.net.xml").read_text()
    text = re.sub(r' (dis)?allow="[^"]*"', "", text)
    text = re.sub(r'<edge id="(?!:)[^"]*"', lambda tag: tag[0] + edges, text)
    twin = tmp_path / "twin.net.xml"
    twin.write_text(text.replace("<lane ", f"<lane{lanes} "))
    found = elements.everywhere(places_module.read(twin))
    assert {element: len(sites) for element, sites in found.items()} == counts("four_way")
    roads = [road_of_net(file) for file in (twin, NETS / "four_way" / "four_way.net.xml")]
    assert len({len(road.lines) for road in roads}) == 1
    assert len({len(road.edges) for road in roads}) == 1


def test_lanes_for_buses_beside_those_of_cars_are_not_counted():
    edge = edge_of(np.array([[0.0, 0, 0], [60, 0, 0]]))
    bus = replace(edge.lanes[0], id="e_1", index=1, allow=frozenset({"bus"}))
    both = replace(edge, lanes=(*edge.lanes, bus))
    assert Element(LANES, "1 lane") in elements._of_edge(both)
