"""Where people can be on networks, and the same ground drawn with shapely by the invariant."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from deepmf_sumo.scene.geometry.walkable import walkable
from deepmf_sumo.sumo.network.sumo_road import road_of_net

from tests.support import pavements
from tests.support.rollout_doubles import rollout_of
from tests.support.walked_ground import ground, off_ground

FOUR_WAY = Path(__file__).resolve().parents[3] / "sumo_nets" / "four_way" / "four_way.net.xml"
HOUSES = """<additional><poly id="h" type="building" shape="215,208 260,208 260,260 215,260"/>
<poly id="w" type="water" shape="100,150 300,150 300,170 100,170"/></additional>"""


@pytest.fixture(scope="module")
def corner(tmp_path_factory, starts_sumo):
    """A junction with sidewalks, a house at it, and a river under one of its roads."""
    folder = tmp_path_factory.mktemp("corner")
    pavements.build(folder)
    houses = folder / "houses.add.xml"
    houses.write_text(HOUSES)
    return road_of_net(folder / "pavements.net.xml", [houses])


@pytest.mark.parametrize("recorded", [False, True])
def test_two_drawings_of_the_ground_agree(corner, recorded):
    """At 6000 places, apart from those at a border."""
    for net in (corner, road_of_net(FOUR_WAY)):
        road = replace(net, footways=None) if recorded else net
        middle = np.concatenate([one.centre_m for one in road.lanes.values()]).mean(axis=0)
        places = middle + np.random.default_rng(0).uniform(-60, 60, (6000, 2))
        drawn = ground(road, shapely.MultiPoint(places))
        found = walkable(road).holds(places)
        expected = shapely.contains_xy(drawn, *places.T)
        border = shapely.distance(shapely.points(places), shapely.boundary(drawn)) < 0.35
        assert (found == expected)[~border].all()
        assert 0.1 < found.mean() < 0.9
        assert border.mean() < 0.1


def test_the_invariant_sees_who_walks_off(corner):
    along = np.column_stack([np.full(91, 201.6), np.linspace(120, 140, 91), np.full(91, 1.57)])
    off = along.copy()
    off[60:, 0] += 40.0
    for path, count in ((along, 0), (off, 1)):
        rollout = rollout_of({"av": along, "b": path})
        tracks = replace(rollout.tracks, kinds=("vehicle", "pedestrian"))
        said = [*off_ground(replace(rollout, tracks=tracks), corner)]
        assert len(said) == count
        assert all(
            one.startswith("b is where nobody can be at 31 steps, first at 60") for one in said
        )
