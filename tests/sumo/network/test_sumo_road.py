import gzip
import os
from pathlib import Path

import numpy as np
import pytest
import shapely
import sumolib

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.network import mapping, sumo_tools
from deepmf_sumo.sumo.network.carriageway import driven_on
from deepmf_sumo.sumo.network.sumo_net import NetLane, read_net
from deepmf_sumo.sumo.network.sumo_road import road_of_net, road_once, signal_links
from deepmf_sumo.sumo.simulation.road_users import kind_of

from tests.support import pavements

pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """Four signalled junctions, two lanes each way, with sidewalks and crossings."""
    file = tmp_path_factory.mktemp("grid") / "grid.net.xml"
    sumo_tools.run(
        *("netgenerate", "--grid", "--grid.number", "2", "--grid.length", "100"),
        *("--grid.attach-length", "80", "-L", "2", "--default.speed", "13.0"),
        *("--sidewalks.guess", "--crossings.guess"),
        *("--default-junction-type", "traffic_light", "-o", str(file)),
    )
    return file


def test_a_converted_net_gives_the_scenes_lanes_back(crossing, tmp_path):
    net = network.convert(crossing, tmp_path / "net")
    road = road_of_net(net.file, [net.additional])
    assert set(road.lanes) == set(net.lane_of)
    begin = net.pieces["in0"][0].sumo_lane
    lane = road.lanes[begin]
    assert lane.kind == "street"
    assert lane.speed_limit_mps == 15.0
    assert lane.width_m == 3.3
    assert lane.centre_m[0] == pytest.approx([-90.0, -1.75])
    assert {net.lane_of[key] for key in lane.next} == {("S0",), ("L0",), ("R0",)}
    assert road.lanes[net.pieces["over"][0].sumo_lane].kind == "freeway"
    assert road.lanes[net.pieces["bike"][0].sumo_lane].kind == "bike"
    assert [shape.kind for shape in road.polygons] == ["crosswalk"]


def test_joins_lead_over_the_lanes_inside_junctions_and_back(grid):
    road = road_of_net(grid)
    for lane in road.lanes.values():
        assert all(lane.id in road.lanes[after].previous for after in lane.next)
        if lane.interpolating:
            assert lane.next
            assert lane.previous
        else:
            assert all(road.lanes[after].interpolating for after in lane.next)
        for after in lane.next:
            gap = np.hypot(*(lane.centre_m[-1] - road.lanes[after].centre_m[0]))
            assert gap < 0.1


def test_neighbours_face_each_other(grid):
    road = road_of_net(grid)
    pairs = [(lane.id, other.lane_id) for lane in road.lanes.values() for other in lane.left]
    assert len(pairs) >= 24
    for right, left in pairs:
        assert [other.lane_id for other in road.lanes[left].right] == [right]
        ahead = road.lanes[right].centre_m[-1] - road.lanes[right].centre_m[0]
        aside = road.lanes[left].centre_m[0] - road.lanes[right].centre_m[0]
        assert ahead[0] * aside[1] - ahead[1] * aside[0] > 0


def test_pedestrians_ways_are_no_lanes_but_their_crossings_are_drawn(grid):
    road = road_of_net(grid)
    assert not any("_w" in lane_id or "_c" in lane_id for lane_id in road.lanes)
    crosswalks = [shape for shape in road.polygons if shape.kind == "crosswalk"]
    assert len(crosswalks) == 16
    assert all(len(shape.points_m) == 4 for shape in crosswalks)


def test_road_edges_do_not_lie_across_lanes(grid):
    road = road_of_net(grid)
    centres = [
        shapely.LineString(lane.centre_m).segmentize(1.0)
        for lane in road.lanes.values()
        if not lane.interpolating
    ]
    crossed = sum(
        line.crosses(shapely.LineString(edge.points_m)) for edge in road.edges for line in centres
    )
    assert crossed == 0
    assert road.lines


def test_corners_of_pavements_are_not_road_edges(grid):
    """Walking areas as sumolib reads them lie outside of all edges, and lanes along all of them."""
    road, net = road_of_net(grid), sumolib.net.readNet(str(grid), withInternal=True)
    pavement = shapely.union_all(
        [
            shapely.Polygon(edge.getLanes()[0].getShape()).buffer(-0.1)
            for edge in net.getEdges()
            if edge.getFunction() == "walkingarea"
        ]
    )
    lanes = shapely.union_all([shapely.LineString(one.centre_m) for one in road.lanes.values()])
    edges = [shapely.LineString(one.points_m) for one in road.edges]
    assert len(edges) > 16
    assert not any(one.intersects(pavement) for one in edges)
    assert max(one.centroid.distance(lanes) for one in edges) < 3.0


def test_a_network_eight_metres_up_is_the_same_eight_metres_up(grid, tmp_path):
    up = tmp_path / "up.net.xml"
    sumo_tools.run("netconvert", "-s", str(grid), "--offset.z", "8", "-o", str(up))
    low, high = road_of_net(grid), road_of_net(up)

    def lines(road):
        return [
            *(np.column_stack([one.centre_m, one.z_m]) for one in road.lanes.values()),
            *(np.column_stack([one.points_m, one.z_m]) for one in (*road.lines, *road.edges)),
            *(np.column_stack([one.points_m, one.z_m]) for one in road.polygons),
            *(np.column_stack([one.points_m, one.z_m]) for one in road.footways),
            *(one.position_m[None] for one in road.stop_signs),
        ]

    assert len(lines(low)) == len(lines(high)) > 100
    for one, raised in zip(lines(low), lines(high), strict=True):
        np.testing.assert_allclose(raised, one + np.array([0.0, 0.0, 8.0]), atol=0.02)


def test_lights_are_those_of_the_lane_behind_them(grid):
    import xml.etree.ElementTree as ET

    links = signal_links(grid)
    road = road_of_net(grid)
    assert links
    assert set(links) <= set(road.lanes)
    assert all(road.lanes[lane_id].interpolating for lane_id in links)
    for connection in ET.parse(grid).getroot().iter("connection"):
        if connection.get("tl") and not connection.get("from").startswith(":"):
            link = links[connection.get("via")][0]
            assert (link.light, link.index) == (
                connection.get("tl"),
                int(connection.get("linkIndex")),
            )


def test_stops_are_where_the_nets_links_stop(stop_crossing, tmp_path):
    net = network.convert(stop_crossing(4), tmp_path / "net")
    signs = road_of_net(net.file).stop_signs
    assert {net.lane_of[sign.lane_ids[0]] for sign in signs} == {(f"in{arm}",) for arm in range(4)}
    assert all(np.abs(sign.position_m).max() == pytest.approx(12.0) for sign in signs)


def test_a_packed_net_is_the_same(grid, tmp_path):
    packed = tmp_path / "grid.net.xml.gz"
    packed.write_bytes(gzip.compress(grid.read_bytes()))
    assert road_of_net(packed).lanes.keys() == road_of_net(grid).lanes.keys()


@pytest.mark.parametrize("content", [b"", b"<net><edge", b"<additional/>", b"\x1f\x8b123"])
def test_what_is_no_net_is_an_error_that_names_the_file(tmp_path, content):
    file = tmp_path / "bad.net.xml"
    file.write_bytes(content)
    with pytest.raises(SimulationError, match=r"bad\.net\.xml"):
        road_of_net(file)


@pytest.mark.parametrize("root", ["additional", "add", "configuration"])
def test_the_root_of_an_additional_file_may_be_called_anything(grid, tmp_path, root):
    shape = '<poly id="p" type="crosswalk" shape="0,0 4,0 4,4 0,4"/>'
    (tmp_path / "a.add.xml").write_text(f"<{root}>{shape}</{root}>")
    plain = road_of_net(grid).polygons
    names = [shape.id for shape in road_of_net(grid, [tmp_path / "a.add.xml"]).polygons]
    assert names == [*(shape.id for shape in plain), "p"]


def test_a_road_is_read_again_where_its_file_has_changed(grid, tmp_path):
    file = tmp_path / "own.net.xml"
    file.write_bytes(grid.read_bytes())
    road = road_once(file)
    assert road_once(file) is road
    os.utime(file, ns=(0, 0))
    assert road_once(file) is not road
    assert road_once(file).lanes.keys() == road.lanes.keys()
    file.unlink()
    with pytest.raises(SimulationError, match=r"own\.net\.xml"):
        road_once(file)


def test_a_missing_net_is_an_error_that_names_the_file(tmp_path):
    with pytest.raises(SimulationError, match=r"none\.net\.xml"):
        road_of_net(tmp_path / "none.net.xml")


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (' speed="13.00"', ' speed="inf"', "speed of <lane> .* is 'inf', not a number"),
        (' speed="13.00"', ' speed="1e400"', "speed of <lane> .* is '1e400', not a number"),
        (' speed="13.00"', ' speed="fast"', "speed of <lane> .* is 'fast', not a number"),
        (' linkIndex="0"', ' linkIndex="x"', "linkIndex of <connection> .* is 'x', not a number"),
        (' shape="', ' shape="a,b ', "the shape 'a,b .* is not a list of x,y or x,y,z"),
        (' shape="', ' shape="nan,1 ', "the shape 'nan,1 .* has numbers that are not finite"),
        (' shape="', ' shape="1 ', "the shape '1 .* is not a list of x,y or x,y,z"),
    ],
)
def test_attributes_that_are_no_numbers_are_named_with_the_file(
    grid, tmp_path, before, after, said
):
    text = grid.read_text()
    assert before in text
    (tmp_path / "bad.net.xml").write_text(text.replace(before, after, 1))
    with pytest.raises(SimulationError, match=rf"bad\.net\.xml is not a network of SUMO: {said}"):
        road_of_net(tmp_path / "bad.net.xml")


def test_buildings_are_kept_apart_from_what_is_painted_on_the_road(grid, tmp_path):
    """As polyconvert writes them; networks that predict and planners do not get them."""
    file = tmp_path / "houses.add.xml"
    square = "0,0 10,0 10,10 0,10 0,0"
    file.write_text(
        "<additional>"
        f'<poly id="a" type="building" color="1,0,0" layer="-1" shape="{square}"/>'
        f'<poly id="b" type="building.apartments" shape="{square}"/>'
        f'<poly id="c" type="landuse.forest" shape="{square}"/>'
        f'<poly id="d" type="driveway" shape="{square}"/>'
        f'<poly id="e" type="water" shape="{square}"/>'
        "</additional>"
    )
    plain, road = road_of_net(grid), road_of_net(grid, [file])
    assert [one.id for one in road.buildings] == ["a", "b"]
    assert road.buildings[0].points_m.shape == (4, 2)
    assert [one.id for one in road.polygons] == [*(one.id for one in plain.polygons), "d"]
    assert [one.id for one in road.water] == ["e"]
    assert plain.buildings == plain.water == ()


def test_what_lies_beside_a_network_keeps_its_heights_in_results(grid, tmp_path):
    """A driveway on a bridge is not on the road below; SUMO reads the file, too."""
    given, kept = tmp_path / "given.add.xml", tmp_path / "kept.add.xml"
    corners = "0,0,6 10,0,6 10,10,6.5 0,10,6.5"
    given.write_text(
        "<additional>"
        f'<poly id="a" type="driveway" shape="{corners}"/>'
        f'<poly id="b" type="building" shape="{corners}"/>'
        '<poly id="c" type="water" shape="0,0 10,0 10,10"/>'
        "</additional>"
    )
    road = road_of_net(grid, [given])
    mapping.write_additional(mapping.beside(road), kept)
    again = road_of_net(grid, [kept])
    for mine, its in zip(mapping.beside(road), mapping.beside(again), strict=True):
        assert (mine.kind, mine.points_m.tolist()) == (its.kind, its.points_m.tolist())
        assert mine.z_m.tolist() == its.z_m.tolist()
    assert [one.z_m.max() for one in mapping.beside(road)] == [6.5, 6.5, 0.0]
    sumo_tools.run("sumo", "-n", str(grid), "-a", str(kept), "--end", "1")


OLD_CLASSES = {"transport", "lightrail", "cityrail", "rail_slow"}
CLASSES = {
    one
    for one in sumolib.net.lane.SUMO_VEHICLE_CLASSES - OLD_CLASSES
    if not one.startswith("public_")
}


@pytest.mark.parametrize("permission", sorted(CLASSES))
def test_a_lane_for_vehicles_of_one_class_is_a_road_as_a_lane_for_all_is(tmp_path, permission):
    """With the same lines and joins; the classes are those that sumolib lists."""
    for_all = road_of_net(_one_class(tmp_path, ""))
    found = road_of_net(_one_class(tmp_path, f' allow="{permission}"'))
    assert {one.kind for one in for_all.lanes.values()} == {"street"}
    if kind_of(permission) == "vehicle":
        assert found.lanes.keys() == for_all.lanes.keys()
        assert {one.kind for one in found.lanes.values()} == {"street"}
        assert [one.id for one in found.edges] == [one.id for one in for_all.edges]
        assert all(driven_on(lane) for lane in _lanes(tmp_path))
    else:
        assert {one.kind for one in found.lanes.values()} <= {"bike"}
        assert bool(found.lanes) == (permission == "bicycle")


@pytest.mark.parametrize(("width_m", "lanes"), [(2.6, 2), (2.2, 0)])
def test_narrow_lanes_of_a_class_of_the_networks_own_are_strips_for_parked_cars(
    tmp_path, width_m, lanes
):
    file = _one_class(tmp_path, f' allow="custom1" width="{width_m}"')
    assert len(road_of_net(file).lanes) == lanes
    assert [driven_on(lane) for lane in _lanes(tmp_path)] == [lanes > 0] * 2
    assert len(road_of_net(_one_class(tmp_path, f' allow="bus" width="{width_m}"')).lanes) == 2


def _one_class(folder: Path, attributes: str) -> Path:
    """A road of two lanes with the attributes."""
    lanes = "".join(
        f'<lane id="ab_{row}" index="{row}" speed="13.9" length="90"{attributes} '
        f'shape="0,{3 * row} 90,{3 * row}"/>'
        for row in (0, 1)
    )
    file = folder / "class.net.xml"
    file.write_text(f'<net version="1.20"><edge id="ab" from="a" to="b">{lanes}</edge></net>')
    return file


def _lanes(folder: Path) -> list[NetLane]:
    net = read_net(folder / "class.net.xml")
    return [lane for edge in net.edges.values() for lane in edge.lanes]


def test_footways_are_the_sidewalks_and_walking_areas(tmp_path):
    """As sumolib reads them; lanes for vehicles, bicycles included, are none."""
    pavements.build(tmp_path)
    net_file = tmp_path / "pavements.net.xml"
    found = {one.id: shapely.Polygon(one.points_m) for one in road_of_net(net_file).footways}
    net = sumolib.net.readNet(str(net_file), withInternal=True, withPedestrianConnections=True)
    lanes = [lane for edge in net.getEdges(withInternal=True) for lane in edge.getLanes()]
    walked = {one.getID(): one for one in lanes if one.getPermissions() == {"pedestrian"}}
    assert len(found) > 8
    assert {one.kind for one in road_of_net(net_file).footways} == {"footway"}
    assert {*found} == {n for n, one in walked.items() if one.getEdge().getFunction() != "crossing"}
    for name, area in found.items():
        shape = walked[name].getShape()
        if walked[name].getEdge().getFunction() == "walkingarea":
            assert area.equals(shapely.Polygon(shape))
        else:
            line = shapely.LineString(shape)
            assert area.area == pytest.approx(2.0 * line.length, rel=1e-3)
            assert shapely.LineString(shape).buffer(0.9, cap_style="flat").within(area)


def test_tracks_of_trams_are_told_from_sidewalks(tmp_path):
    pavements.build(tmp_path)
    text = (tmp_path / "pavements.net.xml").read_text()
    begin = text.index('<lane id="wm_0"')
    rails = text[begin:].replace('allow="pedestrian"', 'allow="tram"', 1)
    (tmp_path / "rails.net.xml").write_text(text[:begin] + rails)
    before, after = (
        {one.id: one.kind for one in road_of_net(tmp_path / f"{name}.net.xml").footways}
        for name in ("pavements", "rails")
    )
    assert before.keys() == after.keys()
    assert {name for name in after if after[name] == "track"} == {"wm_0"}
