"""Each rule on a network in which one thing is wrong; sound ones have no such finding."""

import itertools
import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
import sumolib

from deepmf_sumo.cli import _moments
from deepmf_sumo.roadcheck.screening import GUIDELINES, right_of_way, screen, signals
from deepmf_sumo.roadcheck.screening.findings import Judged
from deepmf_sumo.roadcheck.screening.roads import common_place, opened
from deepmf_sumo.sumo.network import sumo_tools

NETS = Path(__file__).resolve().parents[3] / "sumo_nets"
PHASE = '<phase duration="32" state="GGGrrrrrGGGrrrrr" name="n-s straight"/>'
YELLOW = '<phase duration="3"  state="yyyrrrrryyyrrrrr"/>'
RED = '<phase duration="2"  state="rrrrrrrrrrrrrrrr"/>'


def of(screened, rule):
    return [one for one in screened.findings if one.worst.rule == rule]


def rules(screened):
    return {one.worst.rule for one in screened.findings}


def test_sound_networks(changed):
    assert rules(changed("roundabout")) == set()
    assert rules(changed("rural")) == set()
    assert rules(changed("highway")) == {"speed_step"}, "120 to 80 km/h on the off-ramp"
    assert rules(changed("four_way")) == {"intergreen", "permissive_left"}
    assert rules(changed("arterial")) == {"intergreen", "permissive_left"}, "3 s and no red"


def test_foes_whose_ways_are_apart_need_no_rule(tmp_path):
    """Networks call ways foes that pass beside each other: who gives way there does not matter."""
    file = NETS / "arterial" / "arterial.net.xml"
    roads = opened(file)
    one, two = next(
        (one, two) for ways in roads.ways.values() for one, two in itertools.combinations(ways, 2)
        if one.lane.edge != two.lane.edge and not (one.link.light or two.link.light)
        and None not in {one.row, two.row} and common_place(one, two) is None
    )  # fmt: skip
    tree = ET.parse(file)
    [junction] = [each for each in tree.iter("junction") if each.get("id") == one.junction]
    for mine, its in ((one.row, two.row), (two.row, one.row)):
        request = junction.findall("request")[mine]
        bits = list(request.get("foes"))
        bits[-1 - its] = "1"
        request.set("foes", "".join(bits))
    tree.write(tmp_path / "a.net.xml")
    before, after = (screen(net, GUIDELINES["rilsa"]) for net in (file, tmp_path / "a.net.xml"))
    assert rules(after) == rules(before)
    new = Counter(after.not_judged) - Counter(before.not_judged)
    assert new == {"right of way of foes whose ways do not come near each other": 1}


@pytest.mark.sumo
@pytest.mark.parametrize(("book", "mps"), [("ite", 14), ("rilsa", 17)])
def test_a_network_and_its_mirror_image_have_the_same_yellows(tmp_path, book, mps):
    """Left turns of the one are right turns of the other, where traffic keeps left."""
    arms = {"w": (-200, 0), "e": (200, 0), "n": (0, 200), "s": (0, -200)}
    nodes = "".join(f'<node id="{arm}" x="{x}" y="{y}"/>' for arm, (x, y) in arms.items())
    edges = "".join(
        f'<edge id="{start}{to}" from="{start}" to="{to}" numLanes="3" speed="{mps}"/>'
        for arm in arms for start, to in ((arm, "m"), ("m", arm))
    )  # fmt: skip
    middle = '<node id="m" x="0" y="0" type="traffic_light"/>'
    (tmp_path / "a.nod.xml").write_text(f"<nodes>{middle}{nodes}</nodes>")
    (tmp_path / "a.edg.xml").write_text(f"<edges>{edges}</edges>")
    found = []
    for name, options in (("r", ()), ("l", ("--lefthand",))):
        sumo_tools.run(
            "netconvert", "-n", str(tmp_path / "a.nod.xml"), "-e", str(tmp_path / "a.edg.xml"),
            "-o", str(tmp_path / f"{name}.net.xml"), "--no-turnarounds", "true",
            "--tls.yellow.time", "3", *options,
        )  # fmt: skip
        roads, judged = opened(tmp_path / f"{name}.net.xml"), Judged()
        signals.judge(roads, GUIDELINES[book], judged)
        turns = {way.said: way.turn for ways in roads.ways.values() for way in ways}
        yellows = [one for one in judged.cases if one.rule == "yellow"]
        short = Counter(turns[one.said.partition(" has ")[0]] for one in yellows)
        found.append((short["straight"], short["left"], short["right"]))
    straight, left, right = found[0]
    assert straight > 0
    assert found[1] == (straight, right, left)


@pytest.mark.sumo
@pytest.mark.parametrize(("spread", "cases"), [("center", 7), ("right", 0), ("roadCenter", 0)])
def test_lanes_of_both_directions_on_each_other(tmp_path, spread, cases):
    """As netconvert spreads lanes: in the middle of a line that both directions have."""
    file = tmp_path / "grid.net.xml"
    sumo_tools.run(
        *("netgenerate", "--grid", "--grid.x-number", "2", "--grid.y-number", "3"),
        *("--grid.length", "100", "-L", "1", "--default.speed", "13.9"),
        *("--default.spreadtype", spread, "-o", str(file)),
    )
    overlaps = of(screen(file, GUIDELINES["rilsa"]), "overlap")
    assert sum(one.cases for one in overlaps) == cases
    assert all(one.severity == "error" for one in overlaps)
    for one in overlaps:
        net = sumolib.net.readNet(str(file))
        mine, its = (net.getEdge(edge).getLane(0) for edge in one.worst.edges)
        assert mine.getShape() == its.getShape()[::-1]
        assert one.worst.measured == pytest.approx(mine.getLength(), abs=0.1)
    text = file.read_text()
    for one in overlaps:
        for edge, other in (one.worst.edges, one.worst.edges[::-1]):
            text = text.replace(f'<edge id="{edge}"', f'<edge id="{edge}" bidi="{other}"')
    shared = tmp_path / "shared.net.xml"
    shared.write_text(text)
    left = screen(shared, GUIDELINES["rilsa"])
    on_purpose = left.not_judged.get("pair of edges that share a lane on purpose (bidi)", 0)
    assert sum(one.cases for one in of(left, "overlap")) == cases - on_purpose
    assert on_purpose == len(overlaps)
    told = list(_moments._of_the_network(SimpleNamespace(net=file)))
    assert len(told) == bool(cases), "attack says it, too"


def test_oncoming_movements_on_a_lane_of_both_need_no_priority():
    edges = {
        name: SimpleNamespace(bidi=other)
        for pair in (("in", "back"), ("on", "again"), ("side", ""))
        for name, other in (pair, pair[::-1])
    }
    roads = SimpleNamespace(net=SimpleNamespace(edges=edges))

    def way(before, behind):
        return SimpleNamespace(
            lane=SimpleNamespace(edge=before), target=SimpleNamespace(edge=behind)
        )

    assert right_of_way._opposed(roads, way("in", "on"), way("again", "back"))
    assert not right_of_way._opposed(roads, way("in", "on"), way("side", "back"))
    assert not right_of_way._opposed(roads, way("side", "on"), way("again", "side"))


def test_short_yellow(changed):
    short = YELLOW.replace('"3" ', '"2" ')
    (found,) = of(changed("four_way", (YELLOW, short)), "yellow")
    assert (found.severity, found.worst.measured, found.worst.required) == ("error", 2.0, 3.0)
    assert found.cases == 6, "right turns and two straight lanes of two approaches"
    assert "has a yellow of 2 s, 3 s are required at 50 km/h (5 more" in found.sentence
    (found,) = of(changed("four_way", book="ite"), "yellow")
    assert (found.severity, round(found.worst.required, 2)) == ("warning", 3.79)


def test_no_yellow(changed):
    (found,) = of(changed("four_way", (YELLOW, "")), "yellow")
    assert found.worst.measured == 0
    assert "has no yellow, 3 s are required" in found.sentence


def test_intergreen(changed):
    (was,) = of(changed("four_way"), "intergreen")
    (found,) = of(changed("four_way", (RED, "")), "intergreen")
    assert (was.severity, was.worst.measured) == ("warning", 5.0)
    assert (found.severity, found.worst.measured) == ("error", 3.0)
    assert found.worst.required == was.worst.required
    longer = RED.replace('"2" ', '"3" ')
    assert not of(changed("four_way", (RED, longer)), "intergreen"), "6 s are more than 5.7"


def test_conflicting_greens(changed):
    (found,) = of(
        changed("four_way", (PHASE, PHASE.replace("GGGr", "GGGG", 1))), "conflicting_greens"
    )
    assert found.severity == "error"
    assert found.worst.measured == 32
    assert "n_in -> e_out and s_in -> n_out meet and have a protected green" in found.sentence
    permissive = PHASE.replace("GGGr", "GGGg", 1)
    assert not of(changed("four_way", (PHASE, permissive)), "conflicting_greens")


def test_left_turns_through_gaps(changed):
    (found,) = of(changed("four_way"), "permissive_left")
    assert found.worst.edges in {("e_in", "s_out"), ("w_in", "n_out")}
    assert (found.cases, found.worst.measured, found.worst.unit) == (2, 2.0, "lanes")
    assert not of(changed("four_way", book="ite"), "permissive_left"), "up to 3 lanes"
    protected = ('state="rrrrGGGgrrrrGGGg"', 'state="rrrrGGGrrrrrGGGr"')
    assert not of(changed("four_way", protected), "permissive_left")


def test_signals_at_speed(changed):
    found = of(changed("four_way", ('speed="13.89"', 'speed="25.00"')), "signal_speed")
    assert [one.worst.measured for one in found] == [pytest.approx(90.0)]


def test_nobody_gives_way(changed):
    row = re.compile(r'response="[01]+"')
    sound = changed("rural")
    text = sound.roads.file.read_text()
    zero = [(one, re.sub("1", "0", one)) for one in sorted(set(row.findall(text))) if "1" in one]
    (found,) = of(changed("rural", *zero), "no_priority")
    assert (found.severity, found.worst.junction) == ("error", "crossing")
    assert found.worst.measured == pytest.approx(60, abs=1)
    assert "neither gives way" in found.sentence


def test_priority_from_the_right_at_speed(changed):
    kind = ('id="crossing" type="priority_stop"', 'id="crossing" type="right_before_left"')
    (found,) = of(changed("rural", kind), "right_before_left")
    assert (found.severity, found.worst.required) == ("warning", pytest.approx(50))


def test_short_acceleration_lane(changed):
    lane = re.compile(r'(id="middle-AddedOnRampEdge_\d".*?length=")[\d.]+')
    text = changed("highway").roads.file.read_text()
    short = {(one[0], f"{one[1]}100.00") for one in lane.finditer(text)}
    (found,) = of(changed("highway", *short), "merge")
    assert (found.severity, found.worst.measured, found.worst.required) == ("error", 100, 250)


def test_missing_links(changed):
    text = changed("four_way").roads.file.read_text()
    lane_0 = re.findall(r'    <connection from="n_in" to="\w+" fromLane="0".*?/>\n', text)
    assert lane_0
    (found,) = of(changed("four_way", *((one, "") for one in lane_0)), "missing_link")
    assert found.sentence.startswith("centre: lane 0 of n_in has no connection, though the road")
    every = re.findall(r'    <connection from="n_in" .*?/>\n', text)
    found = of(changed("four_way", *((one, "") for one in every)), "missing_link")
    assert any("centre: n_in has no connection" in one.sentence for one in found)


def test_tight_turns(changed):
    inner = re.compile(r'(<lane id=":centre_\d+_\d" index="\d" [^>]*?speed=")([\d.]+)')
    text = changed("four_way").roads.file.read_text()
    fast = {(one[0], f"{one[1]}13.89") for one in inner.finditer(text)}
    (found,) = of(changed("four_way", *fast), "tight_turn")
    radius = float(re.search(r"radius of (\d+) m", found.sentence)[1])
    assert found.worst.measured == pytest.approx(13.89**2 / radius / 9.81, rel=0.1)
    assert found.worst.measured > 1.5


def test_what_cannot_be_judged_is_counted(changed):
    loose = YELLOW.replace("/>", ' minDur="2" maxDur="5"/>')
    actuated = ('type="static"', 'type="actuated"')
    why = changed("four_way", actuated, (YELLOW, loose)).not_judged
    assert why["yellow without a fixed length"] == 6
    why = changed("four_way", ('type="static"', 'type="NEMA"')).not_judged
    assert why["program whose phases do not follow each other as listed (NEMA, next)"] == 1
    why = changed("four_way", ('state="', 'state="'), ('linkIndex="15"', 'linkIndex="25"'))
    assert why.not_judged["program with fewer signals than its light has"] == 1
    assert not of(why, "intergreen")


def test_programs_of_additional_files_are_judged(changed, tmp_path):
    changed("four_way")
    (tmp_path / "more.add.xml").write_text(
        '<additional><tlLogic id="centre" type="static" programID="night" offset="0">'
        f'{PHASE}{YELLOW.replace("3", "1", 1)}<phase duration="9" state="{"r" * 16}"/>'
        "</tlLogic></additional>"
    )
    config = tmp_path / "a.sumocfg"
    config.write_text(
        '<configuration><input><net-file value="four_way.net.xml"/>'
        '<additional-files value="more.add.xml"/></input></configuration>'
    )
    (found,) = of(screen(config, GUIDELINES["rilsa"]), "yellow")
    assert "a yellow of 1 s of program 'night'" in found.sentence
