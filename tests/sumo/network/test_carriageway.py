"""Where vehicles drive, at the heights at which they do."""

import numpy as np
import pytest
import shapely

from deepmf_sumo.sumo.network.carriageway import carriageway_of

TRACK = """<net version="1.20"><location netOffset="0,0" convBoundary="0,0,400,0"
 origBoundary="0,0,400,0" projParameter="!"/>
<edge id="flat" from="a" to="b"><lane id="flat_0" index="0" speed="9" length="400"
 shape="0,0,0 350,0,0 370,0,8 400,0,8"/></edge>
<edge id="over" from="a" to="b"><lane id="over_0" index="0" speed="9" length="400"
 shape="0,6,20 400,6,20"/></edge></net>"""


def height(x: float) -> float:
    """Of the lane ``flat``, by hand: a short ramp at its end."""
    return min(max(x - 350.0, 0.0) * 0.4, 8.0)


@pytest.fixture
def track(tmp_path):
    file = tmp_path / "ramp.net.xml"
    file.write_text(TRACK)
    return carriageway_of(file)


@pytest.mark.parametrize("x", np.arange(2.0, 400.0, 7.0))
def test_a_lane_is_where_it_is_at_its_own_height_alone(track, x):
    place, here = np.array([[x, 0.0]]), shapely.Point(x, 0.0)
    assert track.near(place, 1.0, np.array([height(x)])).covers(here)
    assert not track.near(place, 1.0, np.array([height(x) + 4.0])).covers(here)


def test_a_way_has_the_heights_of_its_places(track):
    x = np.arange(0.0, 401.0)
    way = np.column_stack([x, np.zeros(len(x))])
    area = track.near(way, 20.0, np.array([height(one) for one in x]))
    assert area.area == pytest.approx(400 * 3.2, rel=1e-6)


def test_the_lane_of_a_position_is_of_its_height(track):
    assert track.lane_at(np.array([100.0, 5.0]), 0.0).id == "flat_0"
    assert track.lane_at(np.array([100.0, 5.0]), 20.0).id == "over_0"
    assert track.lane_at(np.array([100.0, 30.0]), 0.5).id == "flat_0"
    assert track.lane_at(np.array([100.0, 5.0]), -50.0).id == "over_0"  # else the nearest


def test_a_network_without_lanes_has_none(tmp_path):
    file = tmp_path / "none.net.xml"
    file.write_text('<net version="1.20"></net>')
    empty = carriageway_of(file)
    assert empty.lane_at(np.zeros(2), 0.0) is None
    assert empty.near(np.zeros((1, 2)), 5.0, np.zeros(1)).is_empty
