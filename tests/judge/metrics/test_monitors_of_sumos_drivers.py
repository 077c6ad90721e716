"""SUMO's own driver keeps the rules of the road; where it does, no monitor complains."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from deepmf_sumo.judge.metrics import measure
from deepmf_sumo.planners import constant_velocity
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_road import road_of_net
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.episode import plain

pytestmark = pytest.mark.sumo

PLACES = {"w": (-150, 0), "m": (0, 0), "e": (150, 0), "n": (0, 150), "s": (0, -150)}
CALM = '<vType id="t" sigma="0" speedDev="0"/>'


def built(folder, middle, edges):
    """The network of a crossing; ``edges``: attributes by id, which are two letters."""
    nodes = "".join(
        f'<node id="{name}" x="{x}" y="{y}" type="{middle if name == "m" else "dead_end"}"/>'
        for name, (x, y) in PLACES.items()
    )
    roads = "".join(
        f'<edge id="{name}" from="{name[0]}" to="{name[1]}" speed="13.9" {more}/>'
        for name, more in edges.items()
    )
    (folder / "a.nod.xml").write_text(f"<nodes>{nodes}</nodes>")
    (folder / "a.edg.xml").write_text(f"<edges>{roads}</edges>")
    (folder / "a.add.xml").write_text("<additional/>")
    net = folder / "a.net.xml"
    sumo_tools.run(
        "netconvert", "-n", str(folder / "a.nod.xml"), "-e", str(folder / "a.edg.xml"),
        "-o", str(net), "--no-turnarounds", "true",
    )  # fmt: skip
    return net


def case_of(folder, demand, start_s=1.5, steps=150):
    """Of the AV ``av`` in a demand on the network there."""
    (folder / "a.rou.xml").write_text(f"<routes>{CALM}{demand}</routes>")
    config = folder / "a.sumocfg"
    config.write_text(
        '<configuration><net-file value="a.net.xml"/><route-files value="a.rou.xml"/>'
        '<additional-files value="a.add.xml"/></configuration>'
    )
    return network_case(config, start_s, "av", steps)


def monitored(case, *names):
    return [one.value for one in measure(plain(case), case, names)]


def vehicle(name, edges, more="", inside="", kind="t"):
    return (
        f'<vehicle id="{name}" type="{kind}" depart="0" {more}><route edges="{edges}"/>'
        f"{inside}</vehicle>"
    )


ALL = ("wm", "mw", "em", "me", "nm", "mn", "sm", "ms")


@pytest.mark.parametrize("other_at_m", [10, 30, 45])
def test_who_stops_first_at_an_all_way_stop_goes_first(tmp_path, other_at_m):
    built(tmp_path, "allway_stop", dict.fromkeys(ALL, 'priority="2"'))
    first = vehicle("av", "wm me", 'departPos="60" departSpeed="10"')
    then = vehicle("other", "sm mn", f'departPos="{other_at_m}" departSpeed="13"')
    rules = "av_right_of_way_taken", "av_unexplained_braking", "av_unexplained_stop"
    assert monitored(case_of(tmp_path, first + then), *rules) == pytest.approx([0, 0, 0], abs=0.2)


@pytest.mark.parametrize(
    "stop",
    ['endPos="140"', 'endPos="137.3"', 'endPos="140" parking="true"', 'endPos="99" parking="true"'],
)
def test_a_stop_of_the_route_is_a_reason_and_a_bay_is_no_lane_left(tmp_path, stop):
    """Also where SUMO stands a hair's breadth beyond it, as drivers without errors do."""
    built(tmp_path, "priority", {"wm": "", "me": ""})
    halt = f'<stop lane="wm_0" {stop} duration="6"/>'
    av = vehicle("av", "wm me", 'departPos="5" departSpeed="13.9"', halt)
    case = case_of(tmp_path, av, 3.0, 250)
    rules = "av_unexplained_stop", "av_unexplained_braking", "av_off_lane"
    stands, brakes, off_lane = monitored(case, *rules)
    assert (stands < 0.5, brakes, off_lane) == (True, 0.0, pytest.approx(0.0, abs=0.05))


def test_the_green_lane_counts_whatever_the_width_of_the_roads_behind(tmp_path):
    """Straight on is green, and both turns, into narrower roads, are red."""
    narrow = dict.fromkeys(("mn", "ms", "nm", "sm"), 'width="2.8"')
    edges = {"wm": "", "me": "", **narrow}
    net = built(tmp_path, "traffic_light", edges)
    road = road_of_net(net)
    ahead = {one: road.lanes[one].next[0] for one in road.lanes["wm_0"].next}
    assert set(ahead.values()) == {"me_0", "mn_0", "ms_0"}
    links = [one for one in ET.parse(net).getroot().iter("connection") if one.get("tl")]
    ways = {int(one.get("linkIndex")): (one.get("from"), one.get("to")) for one in links}
    state = "".join("G" if ways[at] == ("wm", "me") else "r" for at in range(len(ways)))
    program = '<tlLogic id="m" type="static" programID="9" offset="0">'
    program += f'<phase duration="500" state="{state}"/></tlLogic>'
    (tmp_path / "a.add.xml").write_text(f"<additional>{program}</additional>")
    case = case_of(tmp_path, vehicle("av", "wm me", 'departPos="10" departSpeed="13.9"'), steps=120)
    rules = "av_signal_braking", "av_red_run", "av_late_at_signal"
    assert monitored(case, *rules) == [0.0, 0.0, 0.0]


TRUCK = '<vType id="lorry" sigma="0" speedDev="0" accel="1.2" length="18" vClass="truck"/>'
TRAM = '<vType id="tram" vClass="tram" maxSpeed="20" length="40" sigma="0" speedDev="0"/>'


@pytest.mark.parametrize("tram_at_m", [10, 30, 50, 70, 90])
def test_a_tram_that_goes_first_is_a_reason_to_wait(tmp_path, tram_at_m):
    rail = 'allow="tram" priority="9"'
    net = built(tmp_path, "priority", {"wm": "", "me": "", "sm": rail, "mn": rail})
    assert any(one.gives_way_to for one in road_of_net(net).lanes.values())
    demand = TRUCK + TRAM
    demand += vehicle("av", "wm me", 'departPos="60" departSpeed="10"', kind="lorry")
    demand += vehicle("tram", "sm mn", f'departPos="{tram_at_m}" departSpeed="13.5"', kind="tram")
    case = case_of(tmp_path, demand)
    rules = "av_unexplained_braking", "av_unexplained_stop", "av_right_of_way_taken"
    assert monitored(case, *rules) == pytest.approx([0, 0, 0], abs=0.2)


def test_an_av_that_drives_on_takes_the_priority_of_a_tram(tmp_path):
    rail = 'allow="tram" priority="9"'
    built(tmp_path, "priority", {"wm": "", "me": "", "sm": rail, "mn": rail})
    planner = constant_velocity.build(constant_velocity.Settings())
    taken = []
    for tram_at_m in (10, 25, 40, 55, 70, 85):
        demand = TRUCK + TRAM
        demand += vehicle("av", "wm me", 'departPos="60" departSpeed="10"', kind="lorry")
        demand += vehicle(
            "tram", "sm mn", f'departPos="{tram_at_m}" departSpeed="13.5"', kind="tram"
        )
        case = case_of(tmp_path, demand)
        rollout = simulate(case, planner, None, rng=np.random.default_rng(0))
        taken += [one.value for one in measure(rollout, case, ["av_right_of_way_taken"])]
    assert max(taken) > 3.0


@pytest.mark.parametrize("apart", [False, True])
def test_a_variable_speed_sign_that_shows_more_allows_it(tmp_path, apart):
    """In the additional file, or in a file of its own that this names."""
    built(tmp_path, "priority", {"wm": "", "me": ""})
    steps = '<step time="0" speed="20"/><step time="300" speed="8"/><step time="400" speed="-1"/>'
    (tmp_path / "signs.xml").write_text(f"<vss>{steps}</vss>")
    named, inside = (' file="signs.xml"', "") if apart else ("", steps)
    sign = f'<variableSpeedSign id="v" lanes="wm_0 me_0"{named}>{inside}</variableSpeedSign>'
    demand = vehicle("av", "wm me", 'departPos="5" departSpeed="13.9"')
    case_of(tmp_path, demand)  # writes the files
    (tmp_path / "a.add.xml").write_text(f"<additional>{sign}</additional>")
    case = case_of(tmp_path, demand, steps=100)
    rollout = plain(case)
    assert rollout.tracks.speed_mps[rollout.tracks.row("av")].max() > 18.0
    assert [one.value for one in measure(rollout, case, ["av_over_limit"])] == [0.0]
    assert case.road.lanes["wm_0"].speed_limit_mps == 20.0
