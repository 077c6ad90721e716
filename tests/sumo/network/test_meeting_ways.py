"""Ways through junctions that cross or end on one edge."""

from pathlib import Path

import pytest

from deepmf_sumo.sumo.network.sumo_net import junctions, meeting_ways, read_net

from tests.support.crossing_network import build

OVER, UP, LEFT, RIGHT = (
    ("west", "east"), ("south", "north"), ("west", "north"), ("south", "east"),
)  # fmt: skip
FOUR_WAY = Path(__file__).resolve().parents[3] / "sumo_nets" / "four_way" / "four_way.net.xml"


@pytest.mark.sumo
@pytest.mark.parametrize("option", ["--lefthand", "--no-internal-links", "--no-turnarounds"])
def test_ways_that_cross_or_end_on_one_edge_meet(tmp_path, option):
    """Without a rule, of which there is no request; ways of one edge are no encounter."""
    net = read_net(
        build(tmp_path, option, net="crossing.net.xml.gz").parent / "crossing.net.xml.gz"
    )
    pairs = meeting_ways(net, [OVER, UP, LEFT, RIGHT, ("east", "far"), ("west", "nowhere")])
    assert {frozenset(pair) for pair in pairs} == {
        frozenset((OVER, UP)),  # cross
        frozenset((LEFT, UP)),  # end on one edge
        frozenset((OVER, RIGHT)),
    }
    assert len(pairs) == 6
    assert meeting_ways(net, [OVER, LEFT]) == meeting_ways(net, []) == frozenset()


def test_left_turns_meet_oncoming_traffic_and_right_turns_do_not():
    net = read_net(FOUR_WAY)
    links = {(link.origin[:-2], link.target[:-2], link.direction) for link in net.links}
    ways = {key: (one, two) for one, two, key in links if one == "w_in"}
    oncoming = next((one, two) for one, two, key in links if one == "e_in" and key == "s")
    pairs = meeting_ways(net, [*ways.values(), oncoming])
    assert {pair for pair in pairs if oncoming == pair[0]} == {(oncoming, ways["l"])}


@pytest.mark.sumo
def test_a_junction_is_where_vehicles_of_several_edges_come_together(tmp_path):
    net = read_net(build(tmp_path).parent / "crossing.net.xml")
    assert junctions(net) == dict.fromkeys(("west", "south", "east", "north"), "mid")
