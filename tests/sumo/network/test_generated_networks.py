"""Networks made up from a seed."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_net import read_net
from deepmf_sumo.sumo.network.sumo_road import road_of_net
from deepmf_sumo.training import generated
from deepmf_sumo.training.generated import motorway, street_graph
from deepmf_sumo.training.generated.layout import Edge, GeneratedLayout, Node, build

PLAIN = [kind for kind in generated.KINDS if kind != generated.MIX]


@pytest.fixture(scope="module")
def networks(tmp_path_factory, starts_sumo):
    """One of each kind: kind -> configuration."""
    made = {}
    for kind in PLAIN:
        folder = tmp_path_factory.mktemp(kind)
        made[kind] = generated.generate(kind, 5, 0, folder)
    return made


@pytest.mark.parametrize("kind", PLAIN)
def test_each_kind_has_lanes_that_lead_on(networks, kind):
    road = road_of_net(networks[kind].parent / "net.net.xml")
    assert len(road.lanes) > 5
    limits = {lane.speed_limit_mps for lane in road.lanes.values()}
    assert all(6.0 < limit < 32.0 for limit in limits)
    assert sum(bool(lane.next) for lane in road.lanes.values()) > len(road.lanes) / 3
    assert any(lane.kind == "freeway" for lane in road.lanes.values()) or kind != "motorway"


@pytest.mark.parametrize("kind", PLAIN)
def test_sumo_drives_every_trip_without_an_objection(networks, kind):
    config = networks[kind]
    more = ("--step-length", "1", "--end", "60", "--no-step-log", "--duration-log.disable")
    complaints = sumo_tools.run("sumo", "-c", str(config), *more)
    assert "rror" not in complaints
    trips = ET.parse(config.with_suffix(".rou.xml")).getroot().findall("trip")
    assert len(trips) > 50
    assert len({trip.get("type") for trip in trips}) > 2


def test_same_seed_same_bytes_and_another_number_another_network(networks, tmp_path):
    first = networks["grid"].parent
    again, other = tmp_path / "again", tmp_path / "other"
    for folder, number in ((again, 0), (other, 1)):
        folder.mkdir()
        generated.generate("grid", 5, number, folder)
    for name in ("plain.nod.xml", "plain.edg.xml", "grid-5-000.rou.xml"):
        assert (again / name).read_bytes() == (first / name).read_bytes()
    assert (other / "plain.edg.xml").read_bytes() != (first / "plain.edg.xml").read_bytes()


def test_a_mix_has_every_kind_and_a_kind_only_itself():
    assert set(generated.kinds_of("mix", 10)) == set(PLAIN)
    assert generated.kinds_of("spider", 3) == ["spider"] * 3


def test_junctions_lanes_and_limits_of_every_sort_are_drawn():
    kinds, lanes, turn_lanes, bends = set(), set(), 0, 0
    for seed in range(150):
        rng = np.random.default_rng(seed)
        layout = street_graph.dress(street_graph.crossing(rng), rng)
        kinds |= {node.kind for node in layout.nodes.values()}
        lanes |= {edge.lanes for edge in layout.edges.values()}
        turn_lanes += sum(edge.turn_lane_m > 0 for edge in layout.edges.values())
        bends += sum(edge.shape_m is not None for edge in layout.edges.values())
    assert {"priority", "priority_stop", "allway_stop", "right_before_left"} <= kinds
    assert {"traffic_light", "traffic_light_right_on_red"} <= kinds
    assert lanes == {1, 2, 3}
    assert turn_lanes > 5
    assert bends > 10


def star(arms):
    layout = GeneratedLayout(nodes={"m": Node(position_m=(0.0, 0.0))})
    for number in range(arms):
        angle = 2 * np.pi * number / arms
        layout.nodes[f"n{number}"] = Node(
            position_m=(150 * float(np.cos(angle)), 150 * float(np.sin(angle)))
        )
        for origin, target in (("m", f"n{number}"), (f"n{number}", "m")):
            layout.edges[f"{origin}_{target}"] = Edge(
                origin=origin, target=target, lanes=1, speed_mps=13.4
            )
    return layout


@pytest.mark.sumo
def test_a_roundabout_is_a_ring_with_right_of_way(tmp_path, monkeypatch):
    monkeypatch.setattr(street_graph, "_SHARE", 1.0)
    layout = star(4)
    street_graph.add_roundabouts(layout, np.random.default_rng(0))
    assert "m" not in layout.nodes
    net = read_net(build(layout, tmp_path))
    ring = {name: edge for name, edge in net.edges.items() if name.endswith("_ring")}
    assert len(ring) == 4
    assert {edge.end for edge in ring.values()} == {edge.start for edge in ring.values()}
    entries = [
        link for link in net.links if link.origin.startswith("n") and link.target[:-2] in ring
    ]
    assert entries
    assert {link.state for link in entries} <= {"m", "="}


def test_a_motorway_has_ramps_whose_lanes_lead_onto_it():
    counts = []
    for seed in range(6):
        layout = motorway.motorway(np.random.default_rng(seed))
        entries = [name for name in layout.edges if name.endswith("in_ramp")]
        counts.append(len(entries))
        onto = {link.origin: link for link in layout.connections if link.origin in entries}
        assert set(onto) == set(entries)
        assert all(link.target_lane == 0 for link in onto.values())
    assert sum(counts) > 6


def test_what_netgenerate_refuses_is_an_error(tmp_path, monkeypatch):
    def refuse(name, *arguments, timeout_s=120.0):
        raise ConversionError(f"{name} failed: Error: no")

    monkeypatch.setattr(sumo_tools, "run", refuse)
    with pytest.raises(ConversionError, match="netgenerate failed"):
        generated.generate("grid", 0, 0, tmp_path)
