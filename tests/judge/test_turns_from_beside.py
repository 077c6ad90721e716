"""A turn across the lane beside: the network's own right of way tells who had to wait."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge.conflict_types import Course, conflict_type
from deepmf_sumo.judge.hits import hit_of
from deepmf_sumo.judge.ladder import verdict
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.judge.metrics.av_rules import av_right_of_way_taken
from deepmf_sumo.report.picture import happened
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_road import road_of_net

from tests.support.drawn_people import CAR, NOW, Drawn, episode
from tests.support.rollout_doubles import case_of, in_traffic, rollout_of

NODES = """<nodes><node id="w" x="-200" y="0"/><node id="m" x="0" y="0" type="priority"/>
<node id="e" x="200" y="0"/><node id="n" x="0" y="200"/><node id="s" x="0" y="-200"/></nodes>"""
ARMS = ("wm", "me", "em", "mw", "sm", "ms", "nm", "mn")
BESIDE = {
    "bus": 'numLanes="2" speed="13.8" priority="3"><lane index="0" allow="bus"/></edge>',
    "cyclist": 'numLanes="1" speed="13.8" priority="3" bikeLaneWidth="1.5"/>',
}
RIDER = Drawn(np.zeros((91, 3)), "cyclist", (1.8, 0.8, 1.75))
BUS = Drawn(np.zeros((91, 3)), "vehicle", (12.0, 2.5, 3.0))


def built(folder, beside, *options):
    """The road of a crossing whose main road has a lane beside that cars may not use."""
    edges = "".join(
        f'<edge id="{name}" from="{name[0]}" to="{name[1]}"'
        + (f" {BESIDE[beside]}" if set(name) <= set("wme") else ' speed="13.8" priority="1"/>')
        for name in ARMS
    )
    (folder / "a.nod.xml").write_text(NODES)
    (folder / "a.edg.xml").write_text(f"<edges>{edges}</edges>")
    sumo_tools.run(
        "netconvert", "-n", str(folder / "a.nod.xml"), "-e", str(folder / "a.edg.xml"),
        "-o", str(folder / "a.net.xml"), *options,
    )  # fmt: skip
    return road_of_net(folder / "a.net.xml")


def way(road, begin, edge):
    """Lanes from one to an edge, as the network joins them."""
    ways = [[begin]]
    while ways:
        lanes = ways.pop(0)
        if lanes[-1].startswith(f"{edge}_"):
            return lanes
        ways += [[*lanes, after] for after in road.lanes[lanes[-1]].next]
    raise AssertionError(f"no way from {begin} to {edge}")


def drives(road, lanes, speed, to_stop_line_m):
    """(T, 3) poses of what is so far from the stop line when the attack begins."""
    line = np.concatenate([road.lanes[name].centre_m for name in lanes])
    line = line[np.r_[True, np.hypot(*np.diff(line, axis=0).T) > 1e-6]]
    begin = polylines.arc_lengths(road.lanes[lanes[0]].centre_m)[-1] - to_stop_line_m
    place, heading = polylines.points_at(line, begin + speed * (np.arange(91) - NOW) * 0.1)
    return np.column_stack([place, np.unwrap(heading)])


SIDES = [((), "ms", "right"), (("--lefthand",), "mn", "left")]


AHEAD_M = np.arange(-16.0, 17.0, 2.0)
"""Of the one that goes straight on, when the other is 20 m before the stop line."""


@pytest.mark.sumo
@pytest.mark.parametrize(("options", "to", "turn"), SIDES)
@pytest.mark.parametrize(("beside", "who", "speed"), [("bus", BUS, 8.0), ("cyclist", RIDER, 4.5)])
def test_who_turns_across_the_lane_beside_waits_for_it(
    beside, who, speed, options, to, turn, tmp_path
):
    road = built(tmp_path, beside, *options)
    across = drives(road, way(road, "wm_1", to), 6.0, 20.0)
    hits = []
    for ahead_m in AHEAD_M:
        straight = drives(road, way(road, "wm_0", "me"), speed, 20.0 - ahead_m)
        found = episode(across, who._replace(path=straight), road=road, alone=straight)
        hit, said = hit_of(found), verdict(found)
        if hit is None:
            continue
        hits.append(said.rung)
        assert (hit.conflict, hit.turned) == (f"{turn} turn across path", "AV")
        assert (hit.side, hit.priority) == (turn, "opponent")
        assert (said.av_error, said.opponent_error) == ("took_priority", "")
        title = f"{turn.capitalize()} turn of the AV across the opponent"
        assert happened(hit) == title
    assert "A" in hits
    assert len(hits) >= 3


@pytest.mark.sumo
@pytest.mark.parametrize(("options", "to", "turn"), SIDES)
def test_lanes_inside_the_junction_alone_tell_the_same(options, to, turn, tmp_path):
    """As conflicts of plain traffic are told, by the lanes of the second before."""
    road = built(tmp_path, "cyclist", *options)

    def course(edge, begin, size_m):
        inside = way(road, begin, edge)[1]
        line = road.lanes[inside].centre_m
        heading = float(np.arctan2(*(line[1] - line[0])[::-1]))
        return Course.on_lanes(road, (inside,), line[0], heading, np.array(size_m[:2]))

    car, rider = course(to, "wm_1", CAR), course("me", "wm_0", RIDER.size_m)
    assert conflict_type(car, rider, road, from_beside=True) == f"{turn} turn across path"
    assert conflict_type(rider, car, road, from_beside=True) == f"{turn} turn across path"


@pytest.mark.sumo
def test_cyclists_have_the_priority_of_vehicles(tmp_path):
    """The same motion on the cycle lane: the AV takes as much of the right of way."""
    road = built(tmp_path, "cyclist")
    across = drives(road, way(road, "wm_1", "ms"), 5.0, 20.0)
    asked = []
    for behind_m in (4.0, 8.0, 12.0):
        straight = drives(road, way(road, "wm_0", "me"), 6.0, 20.0 + behind_m)
        found = rollout_of({"av": across, "b": straight}, opponent_id=None)
        case = replace(in_traffic(case_of()), road=road)
        pair = []
        for kind in ("vehicle", "cyclist"):
            size_m = np.array([CAR, RIDER.size_m])
            tracks = replace(found.tracks, kinds=("vehicle", kind), size_m=size_m)
            one = Episode(replace(found, tracks=tracks), case)
            pair.append(av_right_of_way_taken.compute(one))
        asked.append(pair)
    assert all(vehicle == cyclist for vehicle, cyclist in asked)
    assert max(asked)[0] > 3.0


@pytest.mark.sumo
@pytest.mark.parametrize(("options", "to", "turn"), SIDES)
def test_an_opponent_that_turns_across_the_av_takes_its_priority(options, to, turn, tmp_path):
    road = built(tmp_path, "bus", *options)
    across = drives(road, way(road, "wm_1", to), 6.0, 20.0)
    hits = 0
    for ahead_m in AHEAD_M:
        straight = drives(road, way(road, "wm_0", "me"), 8.0, 20.0 - ahead_m)
        found = episode(straight, Drawn(across, "vehicle", CAR), road=road)
        hit, said = hit_of(found), verdict(found)
        if hit is None:
            continue
        hits += 1
        assert (hit.conflict, hit.turned) == (f"{turn} turn across path", "opponent")
        assert hit.priority == "AV"
        assert (said.av_error, said.opponent_error) == ("", "took_priority")
    assert hits >= 3


@pytest.mark.sumo
def test_who_leaves_the_lane_beside_cuts_in(tmp_path):
    """No way of the network crosses the other there."""
    road = built(tmp_path, "bus")
    av = drives(road, way(road, "wm_1", "me"), 8.0, 100.0)
    path = drives(road, way(road, "wm_0", "me"), 8.0, 98.0)
    path[NOW:, 1] += np.minimum(np.arange(91 - NOW) * 0.08, 3.3)
    path[NOW : NOW + 41, 2] += np.arctan2(0.8, 8.0)
    found = episode(av, Drawn(path, "vehicle", CAR), road=road)
    assert hit_of(found).conflict == "lane change"
    assert verdict(found).opponent_error == "cut_in"
