"""What rules measure, against SUMO's own reader, SUMO's own lights, and shapely by hand."""

import itertools
import math
import subprocess
from pathlib import Path

import pytest
import sumo
import sumolib

from deepmf_sumo.roadcheck.screening import GUIDELINES, screen, signals
from deepmf_sumo.roadcheck.screening.findings import Judged
from deepmf_sumo.roadcheck.screening.roads import common_place, opened

from tests.roadcheck.screening.conftest import NETS

NAMES = ("arterial", "four_way", "highway", "roundabout", "rural")


@pytest.mark.parametrize("name", NAMES)
def test_foes_and_right_of_way_are_those_of_sumolib(name):
    compare(NETS / name / f"{name}.net.xml", name)


def compare(file, name):
    """All pairs of movements from two edges."""
    roads, net = opened(file), sumolib.net.readNet(str(file), withInternal=True)
    compared = 0
    for junction, ways in roads.ways.items():
        node = net.getNode(junction)
        theirs = {}
        for way in ways:
            lanes = net.getLane(way.lane.id).getOutgoing()
            (theirs[id(way)],) = [one for one in lanes if one.getToLane().getID() == way.target.id]
        mine = {(id(one), id(two)) for one, two in roads.pairs(junction)}
        for one, two in itertools.combinations(ways, 2):
            rows = [node.getLinkIndex(theirs[id(way)]) for way in (one, two)]
            assert [one.row, two.row] == rows
            if one.lane.edge != two.lane.edge:
                compared += 1
                assert ((id(one), id(two)) in mine) == node.areFoes(*rows)
                forbids = node.forbids(theirs[id(two)], theirs[id(one)])
                assert roads.waits(one, two) == forbids
    assert compared or name == "highway"


@pytest.mark.sumo
@pytest.mark.parametrize("name", NAMES)
def test_and_so_without_lanes_inside_junctions(name, tmp_path):
    file = tmp_path / "plain.net.xml"
    netconvert = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
    source = NETS / name / f"{name}.net.xml"
    command = [netconvert, "-s", source, "-o", file, "--no-internal-links", "true"]
    subprocess.run(command, check=True, capture_output=True)
    assert not any(way.inner for ways in opened(file).ways.values() for way in ways)
    compare(file, name)
    rules = {one.worst.rule for one in screen(file, GUIDELINES["rilsa"]).findings}
    assert "no_priority" not in rules


def test_where_two_straight_ways_cross():
    """Lanes 4.8 m and 1.6 m from the middle of the road; the stop lines are the ends of lanes."""
    roads = opened(NETS / "four_way" / "four_way.net.xml")
    straight = {
        (way.lane.edge, way.lane.index): way
        for way in roads.ways["centre"]
        if way.turn == "straight"
    }
    for one, two in itertools.product(straight.values(), repeat=2):
        if {one.lane.edge[0], two.lane.edge[0]} in ({"e", "n"}, {"w", "s"}):
            (x, y), (u, v) = one.lane.shape_m[-1, :2], two.lane.shape_m[-1, :2]
            level = abs(x) > abs(y)
            meets = (u, y) if level else (x, v)
            over, to = common_place(one, two)
            assert over == pytest.approx(math.dist((x, y), meets), abs=0.02)
            assert to == pytest.approx(math.dist((u, v), meets), abs=0.02)


@pytest.mark.sumo
def test_intergreen_times_are_those_that_sumo_shows():
    """Two cycles of plain SUMO, by the second: least time between the greens of each pair."""
    import libsumo

    file = NETS / "four_way" / "four_way.net.xml"
    libsumo.start(["sumo", "-n", str(file), "--step-length", "1", "--no-step-log", "true"])
    shown = []
    for _ in range(200):
        shown.append(libsumo.trafficlight.getRedYellowGreenState("centre"))
        libsumo.simulationStep()
    libsumo.close()
    roads = opened(file)
    light = signals._Light(
        roads, GUIDELINES["rilsa"], roads.programs[0], roads.ways["centre"], Judged()
    )
    compared = 0
    for one, two in itertools.chain.from_iterable(
        ((a, b), (b, a)) for a, b in roads.pairs("centre")
    ):
        mine = [time[0] for end in light._ends(one) if (time := light._until(one, two, end))]
        theirs = _gaps(
            [state[one.link.index] for state in shown], [s[two.link.index] for s in shown]
        )
        assert bool(mine) == bool(theirs)
        if mine:
            compared += 1
            assert min(mine) == min(theirs)
    assert compared > 50


def _gaps(one, two):
    """Seconds from each end of the first one's green to the other's, without one between."""
    found = []
    for end in range(1, len(one)):
        if one[end - 1] in "Gg" and one[end] not in "Gg" and two[end - 1] not in "Gg":
            for later in range(end, len(one)):
                if two[later] in "Gg":
                    found.append(later - end)
                    break
                if one[later] in "Gg":
                    break
    return found
