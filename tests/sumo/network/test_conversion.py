import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import RoadMap, Scene
from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.network import mapping, plain_net, sumo_tools
from deepmf_sumo.sumo.network.sumo_net import points, read_net

pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module")
def net(crossing, tmp_path_factory):
    return network.convert(crossing, tmp_path_factory.mktemp("nets") / "crossing")


def shape(net, lane_id):
    net_file = read_net(net.file)
    return next(
        lane.shape_m
        for edge in net_file.edges.values()
        for lane in edge.lanes
        if lane.id == lane_id
    )


def load_in_sumo(net):
    return sumo_tools.run(
        "sumo", "-n", str(net.file), "-a", str(net.additional), "--no-step-log", "-e", "1"
    )


def junctions(net, scene_lane):
    edges = read_net(net.file).edges
    edge = edges[net.pieces[scene_lane][0].sumo_lane.rpartition("_")[0]]
    return edge.start, edge.end


def test_nothing_is_lost_and_lanes_are_where_they_were(net, crossing):
    report = net.report
    assert report.lanes == len(crossing.road.lanes)
    assert report.connections == 27
    assert not report.lost_lanes
    assert not report.lost_connections
    assert not report.lost_signals
    assert set(net.pieces) == set(crossing.road.lanes)
    assert 0 < report.error_mean_m < 0.02
    assert report.error_p99_m <= report.error_max_m <= 0.03
    assert report.seconds > 0


def test_sumo_loads_the_net_without_a_word_and_the_configuration_opens(net):
    assert load_in_sumo(net) == ""
    sumo_tools.run("sumo", "-c", str(net.file.parent / "scene.sumocfg"), "--no-step-log", "-e", "1")


def test_pieces_cover_each_lane_in_driving_order(net, crossing):
    for lane_id, pieces in net.pieces.items():
        lane = crossing.road.lanes[lane_id]
        length = (
            np.hypot(*np.diff(lane.centre_m, axis=0).T).sum() if len(lane.centre_m) > 1 else 0.0
        )
        starts = [piece.start_m for piece in pieces]
        assert starts == sorted(starts)
        assert min(starts) == pytest.approx(0.0, abs=0.01)
        reach = max(piece.start_m + piece.length_m for piece in pieces)
        assert reach == pytest.approx(length, abs=0.05)
        assert all(lane_id in net.lane_of[piece.sumo_lane] for piece in pieces)


def test_lanes_that_cross_have_foes(net):
    root = ET.parse(net.file).getroot()
    links = [row for row in root.iter("request") if "1" in row.get("foes")]
    assert len(links) >= 12


def test_an_overpass_shares_no_junction_with_the_road_below(net):
    below = {
        node
        for key in net.pieces
        if key != "over" and not net.pieces[key][0].sumo_lane.startswith(":")
        for node in junctions(net, key)
    }
    assert not below & set(junctions(net, "over"))


def test_each_signalled_lane_has_its_link_and_its_light_the_state(net, crossing):
    root = ET.parse(net.file).getroot()
    programme = {tl.get("id"): len(tl.find("phase").get("state")) for tl in root.iter("tlLogic")}
    assert set(net.signals) == set(crossing.signals.lane_ids)
    for lane_id, links in net.signals.items():
        assert len(links) == 1
        assert links[0].index < programme[links[0].light]
        behind = [
            link.onto
            for link in read_net(net.file).links
            if (link.light, link.index) == (links[0].light, links[0].index)
        ]
        assert net.lane_of[behind[0]] == (lane_id,)


def test_a_dead_end_goes_on_straight_on_a_lane_that_is_not_the_scenes(net):
    end = net.pieces["far"][-1].sumo_lane
    after = [link.target for link in read_net(net.file).links if link.origin == end]
    assert len(after) == 1
    assert net.lane_of[after[0]] == ()
    line = shape(net, after[0])[:, :2]
    assert line[0] == pytest.approx([150.0, -1.75], abs=1e-3)
    assert line[-1] == pytest.approx([350.0, -1.75], abs=1e-3)


def test_a_bike_lane_is_for_bicycles_and_limits_are_kept(net):
    edges = read_net(net.file).edges
    lanes = {lane.id: lane for edge in edges.values() for lane in edge.lanes}
    assert lanes[net.pieces["bike"][0].sumo_lane].allow == {"bicycle"}
    assert lanes[net.pieces["in0"][0].sumo_lane].speed_mps == 15.0
    assert lanes[net.pieces["in0"][0].sumo_lane].allows("passenger")


def test_nobody_has_to_brake_where_two_lanes_touch(road_of, scene_of, tmp_path):
    # Seen from end to end these two turn sharply; where they touch they go straight on.
    rows = [
        ("a", [(0, 0), (0, 60), (60, 60)], {"speed_limit_mps": 15.0}),
        ("b", [(60, 60), (120, 60), (120, 0)], {"speed_limit_mps": 15.0}),
    ]
    road = road_of(rows, [("a", "b")])
    net = network.convert(scene_of(road, path=[(0, 0), (0, 40)]), tmp_path / "net")
    lanes = [lane for edge in read_net(net.file).edges.values() for lane in edge.lanes]
    assert all(lane.speed_mps == 15.0 for lane in lanes)


def test_crosswalks_are_drawn(net):
    shapes = [poly.get("shape") for poly in ET.parse(net.additional).getroot().iter("poly")]
    assert [points(text)[0, :2].tolist() for text in shapes] == [[-16.0, -8.0]]


def test_the_same_scene_gives_the_same_bytes_whatever_the_hash_seed(crossing, net, tmp_path):
    script = (
        "import pickle, sys; from pathlib import Path; from deepmf_sumo.sumo import network;"
        "network.convert(pickle.load(open(sys.argv[1], 'rb')), Path(sys.argv[2]))"
    )
    import pickle

    (tmp_path / "scene").write_bytes(pickle.dumps(crossing))
    subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "scene"), str(tmp_path / "again")],
        env={**os.environ, "PYTHONHASHSEED": "77", "PYTHONPATH": os.pathsep.join(sys.path)},
        check=True,
    )
    for file in net.file.parent.iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes(), file.name


def test_a_net_read_back_is_the_one_written(net):
    again = network.read(net.file.parent)
    assert again.pieces.keys() == net.pieces.keys()
    assert again.lane_of == net.lane_of
    assert again.signals == net.signals
    assert again.report.error_max_m == net.report.error_max_m
    assert again.file == net.file


def test_an_av_off_the_lanes_gets_a_ghost_edge_along_its_path(crossing, scene_of, tmp_path):
    path = [(120.0, 60.0), (150.0, 62.0), (160.0, 80.0)]
    net = network.convert(scene_of(crossing.road, path=path), tmp_path / "lot")
    assert net.ghost_edge
    lane = f"{net.ghost_edge}_0"
    assert net.lane_of[lane] == ()
    assert net.report.error_max_m <= 0.03
    line = shape(net, lane)[:, :2]
    from deepmf_sumo.scene.geometry import polylines

    assert polylines.project(line, np.array(path)).distance_m.max() < 0.3
    assert polylines.arc_lengths(line)[-1] > 230
    assert load_in_sumo(net) == ""


def test_an_av_on_the_lanes_gets_none(net):
    assert net.ghost_edge is None


def test_an_av_parked_off_the_lanes_gets_a_straight_ghost_edge(crossing, scene_of, tmp_path):
    scene = scene_of(crossing.road, path=[(120.0, 60.0), (120.001, 60.0)])
    net = network.convert(scene, tmp_path / "parked")
    line = shape(net, f"{net.ghost_edge}_0")[:, :2]
    assert line[:, 1] == pytest.approx(60.0, abs=1e-3)
    assert line[0, 0] == pytest.approx(100.0)
    assert line[-1, 0] == pytest.approx(320.0)


@pytest.mark.parametrize(
    ("signs", "kind"), [(0, "priority"), (2, "priority_stop"), (4, "allway_stop")]
)
def test_stop_signs_make_the_junctions_type(stop_crossing, tmp_path, signs, kind):
    net = network.convert(stop_crossing(signs), tmp_path / "net")
    node = junctions(net, "in0")[1]
    types = {junction.id: junction.type for junction in read_net(net.file).junctions}
    assert types[node] == kind
    states = {
        link.origin.rpartition("_")[0]: link.state
        for link in read_net(net.file).links
        if not link.origin.startswith(":")
    }
    for arm in range(signs):
        state = states[net.pieces[f"in{arm}"][0].sumo_lane.rpartition("_")[0]]
        assert state == ("w" if signs == 4 else "s")


def test_parallel_lanes_are_one_edge_from_right_to_left(two_lanes, scene_of, tmp_path):
    net = network.convert(scene_of(two_lanes, path=[(5, 0), (100, 0)]), tmp_path / "net")
    edge = net.pieces["r1"][0].sumo_lane.rpartition("_")[0]
    assert net.pieces["r1"][0].sumo_lane == f"{edge}_0"
    assert net.pieces["l1"][0].sumo_lane == f"{edge}_1"


def test_a_join_over_a_gap_gets_a_way_and_is_reported(road_of, scene_of, tmp_path):
    road = road_of([("a", [(0, 0), (50, 0)], {}), ("b", [(65, 15), (65, 60)], {})], [("a", "b")])
    net = network.convert(scene_of(road, path=[(0, 0), (40, 0)]), tmp_path / "net")
    assert not net.report.lost_connections
    assert net.report.bridged_connections == (("a", "b", "21.2 m"),)
    assert net.report.error_max_m <= 0.03
    assert load_in_sumo(net) == ""


def test_joins_that_cannot_be_are_lost_with_a_reason(road_of, scene_of, tmp_path):
    road = road_of(
        [("a", [(0, 0), (50, 0)], {}), ("b", [(500, 0), (560, 0)], {})],
        [("a", "b"), ("b", "nowhere")],
    )
    report = network.convert(scene_of(road, path=[(0, 0), (40, 0)]), tmp_path / "net").report
    assert report.connections == 2
    assert report.lost_connections == (
        ("a", "b", "their ends are 450.0 m apart"),
        ("b", "nowhere", "lane nowhere is not in the map"),
    )


def test_a_join_that_netconvert_leaves_out_is_lost_with_a_reason(
    road_of, scene_of, tmp_path, monkeypatch
):
    road = road_of([("a", [(0, 0), (50, 0)], {}), ("b", [(50, 0), (90, 0)], {})], [("a", "b")])
    write_link = plain_net._link
    nothing = '<connection from="ea"/>'
    monkeypatch.setattr(
        plain_net, "_link", lambda link: nothing if link.target[0] == "eb" else write_link(link)
    )
    report = network.convert(scene_of(road, path=[(0, 0), (40, 0)]), tmp_path / "net").report
    assert report.lost_connections == (("a", "b", "netconvert left it out"),)


def test_a_single_point_at_an_end_belongs_to_the_lane_it_touches(road_of, scene_of, tmp_path):
    rows = [("a", [(0, 0), (50, 0)], {}), ("p", [(50, 0)], {}), ("alone", [(9, 9)], {})]
    net = network.convert(
        scene_of(road_of(rows, [("a", "p")]), path=[(0, 0), (40, 0)]), tmp_path / "net"
    )
    assert net.pieces["p"][0].sumo_lane == net.pieces["a"][-1].sumo_lane
    assert net.report.lost_lanes == (("alone", "it is a single point that joins nothing"),)
    assert not net.report.lost_connections


def test_a_ring_is_no_edge_from_a_junction_to_itself(road_of, scene_of, tmp_path):
    angle = np.linspace(0, 2 * np.pi, 60)
    ring = 20 * np.column_stack([np.cos(angle), np.sin(angle)])
    road = road_of(
        [("ring", ring, {}), ("in", [(20, -60), (20, 0)], {})], [("ring", "ring"), ("in", "ring")]
    )
    net = network.convert(scene_of(road, path=[(20, -50), (20, 0)]), tmp_path / "net")
    assert not net.report.lost_connections
    edges = read_net(net.file).edges.values()
    assert all(edge.start != edge.end for edge in edges if not edge.function)
    assert net.report.error_max_m <= 0.03


def test_a_signalled_lane_that_nothing_leads_to_is_reported(road_of, scene_of, tmp_path):
    road = road_of([("a", [(0, 0), (50, 0)], {})], [])
    scene = scene_of(road, path=[(0, 0), (40, 0)], signalled=["a"])
    net = network.convert(scene, tmp_path / "net")
    assert net.report.lost_signals == (("a", "nothing leads onto the lane"),)


def test_a_scene_without_lanes_is_an_error_that_says_so(crossing, scene_of, tmp_path):
    scene = scene_of(RoadMap(lanes={}), path=[(0, 0), (40, 0)])
    with pytest.raises(ConversionError, match="no lane with a length"):
        network.convert(scene, tmp_path / "net")
    assert not list(tmp_path.iterdir())


def test_a_folder_with_something_else_is_not_replaced(crossing, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(ConversionError, match="something other than a converted net"):
        network.convert(crossing, tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "keep"


def test_a_side_file_of_another_format_is_refused(net, tmp_path):
    document = json.loads((net.file.parent / "mapping.json").read_text())
    (tmp_path / "mapping.json").write_text(json.dumps({**document, "format": 0}))
    with pytest.raises(ConversionError, match="format 0"):
        network.read(tmp_path)


def test_recorded_scenes_convert_without_loss(womd: Path, tmp_path):
    from deepmf_sumo.scene import readers

    found = readers.scenes([womd / "val" / "val-00001-of-00004.tfrecord.gz"])
    scenes = [scene for scene in islice(found, 3) if isinstance(scene, Scene)]
    assert scenes
    for scene in scenes:
        net = network.convert(scene, tmp_path / scene.name)
        assert net.report.error_max_m <= 0.03
        assert not net.report.lost_lanes
        assert load_in_sumo(net) == ""


@pytest.mark.timeout(10)
def test_a_pipe_in_place_of_the_side_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / mapping.MAPPING_FILE)
    with pytest.raises(ConversionError, match="it is a pipe, not a regular file"):
        mapping.read(tmp_path)
