import numpy as np
import pytest
import sumolib

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.results.risk import elements, places
from deepmf_sumo.sumo.network import sumo_tools

from tests.support import risk_doubles

NETS = risk_doubles.NET.parents[1]


@pytest.fixture(scope="module")
def four_way():
    return places.read(risk_doubles.NET)


def test_a_movement_is_called_as_engineers_call_it(four_way):
    title = four_way.title("movement", "centre: w_in -> n_out")
    assert title == "centre: from west to north (left, permissive)"
    title = four_way.title("movement", "centre: e_in -> w_out")
    assert title == "centre: from east to west (straight, protected)"
    assert four_way.title("edge", "w_in") == "w_in (w_pocket to centre)"
    assert four_way.title("lane", "w_in_2") == "w_in, lane 2"
    assert four_way.title("lane", ":centre_15_0").endswith("permissive), lane :centre_15_0")


def test_a_way_over_a_junction_has_all_lanes_inside(four_way):
    left = four_way.movement("w_in", "n_out")
    assert left.lanes == (":centre_15_0", ":centre_17_0")
    assert {four_way.spot(lane).movement for lane in left.lanes} == {left.id}
    assert four_way.movement("w_in", "w_out") is None


def test_every_lane_is_on_an_edge_or_a_movement_never_on_both(four_way):
    spots = [four_way.spot(lane) for lane in four_way.lanes]
    assert all(bool(spot.edge) != bool(spot.movement) for spot in spots)
    assert four_way.count("lane") == len(spots)
    assert four_way.count("movement") == 16


def test_within_a_junction(four_way):
    assert four_way.within(np.array([0.0, 0.0]), 0.0) == "centre"
    assert four_way.within(np.array([0.0, 0.0]), 6.0) == ""  # above it
    assert four_way.within(np.array([100.0, 100.0]), 0.0) == ""
    left = four_way.movement("w_in", "n_out")
    assert four_way.in_junction("centre", left).movement == left.id
    assert four_way.in_junction("n_pocket", left).movement == ""


def test_who_gives_way_at_a_roundabout():
    ring = places.read(NETS / "roundabout" / "roundabout.net.xml")
    enters = [one for one in ring.movements.values() if one.id.startswith("e_enter: e_in")]
    assert [one.rule for one in enters] == ["give way"]


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """The four-way junction with names of two streets."""
    text = risk_doubles.NET.read_text("utf-8")
    streets = {"w_in": "High  Street", "e_out": "High Street", "n_out": "Mill &lt;Lane&gt;"}
    for edge, street in streets.items():
        assert text.count(f'<edge id="{edge}"') == 1
        text = text.replace(f'<edge id="{edge}"', f'<edge id="{edge}" name="{street}"')
    file = tmp_path_factory.mktemp("named") / "net.net.xml"
    file.write_text(text, "utf-8")
    return places.read(file)


def test_streets_are_named_and_ids_stay(named):
    corner = "High Street / Mill <Lane> (centre)"
    assert named.title("junction", "centre") == corner
    title = named.title("movement", "centre: w_in -> n_out")
    assert title == f"{corner}: from High Street (west) to Mill <Lane> (north) (left, permissive)"
    title = named.title("movement", "centre: w_in -> e_out")
    assert title.startswith(f"{corner}: on High Street from west to east (straight")
    title = named.title("movement", "centre: s_in -> n_out")
    assert title.startswith(f"{corner}: from south to Mill <Lane> (north) (straight")
    assert named.title("edge", "w_in") == "High Street, w_pocket to Mill <Lane> (w_in)"
    assert named.title("lane", "w_in_2") == "High Street (w_in), lane 2"
    assert named.title("edge", "s_in").startswith("s_in (")


def test_a_junction_has_the_name_that_the_network_gives_it(tmp_path):
    text = risk_doubles.NET.read_text("utf-8")
    file = tmp_path / "net.net.xml"
    file.write_text(text.replace('<junction id="centre"', '<junction id="centre" name="Market"'))
    market = places.read(file)
    assert market.title("junction", "centre") == "Market (centre)"
    assert market.title("edge", "w_in") == "w_in (w_pocket to Market)"


def test_a_connection_to_a_missing_edge_is_one_sentence(tmp_path):
    text = risk_doubles.NET.read_text("utf-8")
    broken = tmp_path / "broken.net.xml"
    broken.write_text(
        text.replace('<connection from="w_in" to="', '<connection from="w_in" to="x_', 1)
    )
    with pytest.raises(SimulationError, match=r"from edge 'w_in' to edge 'x_.*', but no edge 'x_"):
        places.read(broken)


@pytest.mark.sumo
@pytest.mark.parametrize("first", ["right_before_left", "left_before_right"])
def test_the_side_that_goes_first_is_the_one_that_sumo_was_asked_for(tmp_path, first):
    """Each crossing of a grid, as sumolib reads it; its straight ways give way to that side."""
    file = tmp_path / "grid.net.xml"
    sumo_tools.run(
        *("netgenerate", "--grid", "--grid.number", "3", "-j", first, "--lefthand"),
        *("--no-turnarounds", "-o", str(file)),
    )
    said = first.replace("_", " ")
    found = places.read(file)
    net = sumolib.net.readNet(str(file))
    crossings = {node.getID() for node in net.getNodes() if node.getType() == first}
    assert {one.rule for one in found.movements.values() if one.junction in crossings} <= {
        said, "priority", "give way",
    }  # fmt: skip
    assert any(one.rule == said for one in found.movements.values())
    named = elements.everywhere(found)[elements.Element("junction", said)]
    assert {found.movements[one].junction for kind, one in named if kind == "movement"} == {
        node.getID() for node in net.getNodes() if node.getID() in crossings
        and len(node.getNeighboringNodes()) > 2
    }  # fmt: skip
