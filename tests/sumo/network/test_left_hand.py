"""Networks in which traffic keeps left."""

import numpy as np
import pytest

from deepmf_sumo.results.risk.places import read
from deepmf_sumo.study.moments.choice import turns_of
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_net import read_once
from deepmf_sumo.sumo.network.sumo_road import road_of_net

pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module", params=[False, True], ids=["right", "left"])
def road(request, tmp_path_factory):
    file = tmp_path_factory.mktemp("grid") / "grid.net.xml"
    side = ["--lefthand"] if request.param else []
    sumo_tools.run("netgenerate", "--grid", "--grid.number", "2", "-L", "2", *side, "-o", str(file))
    return road_of_net(file)


def left_of(line_m, point_m):
    """How far a point is to the left of a line's first piece."""
    along = (line_m[1] - line_m[0]) / np.hypot(*(line_m[1] - line_m[0]))
    x, y = point_m - line_m[0]
    return float(along[0] * y - along[1] * x)


def test_neighbours_are_on_the_side_that_their_name_says(road):
    pairs = 0
    for lane in road.lanes.values():
        for neighbour in lane.left:
            pairs += 1
            assert left_of(lane.centre_m, road.lanes[neighbour.lane_id].centre_m[0]) > 2
        for neighbour in lane.right:
            assert left_of(lane.centre_m, road.lanes[neighbour.lane_id].centre_m[0]) < -2
    assert pairs >= 8


def test_the_double_line_separates_opposite_directions(road):
    double = {line.id.rpartition(":")[0]: line for line in road.lines if line.kind == 7}
    assert len(double) == 8
    for edge, line in double.items():
        lanes = [road.lanes[f"{edge}_{index}"].centre_m for index in (0, 1)]
        away = [abs(left_of(lane, line.points_m[0])) for lane in lanes]
        assert away == pytest.approx([4.8, 1.6], abs=0.05)


@pytest.mark.parametrize("side", [[], ["--lefthand"]], ids=["right", "left"])
def test_who_turns_back_does_not_go_straight_on(side, tmp_path):
    """SUMO has a letter of its own for turning back where traffic keeps left."""
    file, grid = tmp_path / "grid.net.xml", ["--grid", "--grid.number", "2", "-o"]
    more = ["--grid.attach-length", "50", *side]
    sumo_tools.run("netgenerate", *grid, str(file), *more)
    places, turns = read(file), turns_of(read_once(file))
    edges = places.net.edges
    back = {
        (one.origin, one.target)
        for one in places.movements.values()
        if edges[one.origin].start == edges[one.target].end
    }
    assert len(back) == 24
    assert {turns[ends] for ends in back} == {"turnaround"}
    named = places.movements.values()
    assert {(one.origin, one.target) for one in named if one.turn == "turnaround"} == back
