"""Boxes of SUMO's own traffic overlap only where SUMO says that vehicles have collided."""

import libsumo
import numpy as np
import pytest
import shapely

from deepmf_sumo.scene import agent_ids
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.sumo.simulation.road_users import TrafficReader

from tests.conftest import ROOT
from tests.support import mixed_traffic

NETWORKS = ("arterial", "four_way", "highway", "roundabout", "rural")
OPTIONS = ("--step-length", "0.1", "--no-warnings", "--seed", "1", "--collision.action", "none",
           "--collision.check-junctions", "--collision.mingap-factor", "0")  # fmt: skip
_SEEN_M2 = 0.1


def overlapping(reader, frame):
    """Pairs of road users whose boxes share an area."""
    size_m = reader.bodies.sizes_m(frame.ids)
    shapes = shapely.polygons(boxes.corners(frame.position_m, frame.heading_rad, size_m))
    wholes = [agent_ids.whole_of(one) for one in frame.ids]
    for a, b in shapely.STRtree(shapes).query(shapes, predicate="intersects").T.tolist():
        shared = a < b and wholes[a] != wholes[b] and not clear(frame.z_m[a], frame.z_m[b])
        if shared and shapely.intersection(shapes[a], shapes[b]).area > _SEEN_M2:
            yield wholes[a], wholes[b]


def beside(one, two):
    """Whether two vehicles are on two lanes of an edge, where one of them has changed lanes."""
    if any(agent_ids.person_of(name) is not None for name in (one, two)):
        return False
    lanes = {libsumo.vehicle.getLaneID(name) for name in (one, two)}
    return len(lanes) == 2 and len({lane.rpartition("_")[0] for lane in lanes}) == 1


def unsaid(config, seconds):
    """Overlaps that SUMO does not call collisions; and the number of boxes."""
    libsumo.start(["sumo", "-c", str(config), *OPTIONS])
    found, said, count = set(), set(), 0
    try:
        reader = TrafficReader(libsumo)
        libsumo.simulationStep(libsumo.simulation.getTime() + seconds / 2)
        for _ in range(round(5 * seconds)):
            libsumo.simulationStep()
            frame = reader.read()
            count += len(frame.ids)
            said |= {frozenset((c.collider, c.victim)) for c in libsumo.simulation.getCollisions()}
            pairs = list(overlapping(reader, frame)) if frame.ids else []
            found |= {frozenset(pair) for pair in pairs if not beside(*pair)}
    finally:
        libsumo.close()
    return found - said, count


@pytest.mark.parametrize("name", NETWORKS)
def test_of_our_networks(name):
    found, count = unsaid(ROOT / "sumo_nets" / name / f"{name}.sumocfg", 60.0)
    assert count > 1000
    assert found == set()


def test_of_a_street_with_persons_and_a_bus(tmp_path):
    found, count = unsaid(mixed_traffic.build(tmp_path), 50.0)
    assert count > 1000
    persons = {one for pair in found for one in pair if one.startswith("person ")}
    assert [pair for pair in found if not pair <= persons] == []  # persons walk side by side


def test_the_rule_sees_an_overlap():
    size = np.array([5.0, 1.8])
    corners = boxes.corners(np.array([[0, 0], [4, 1]]), np.zeros(2), np.stack([size, size]))
    first, second = shapely.polygons(corners)
    assert shapely.intersection(first, second).area > _SEEN_M2
