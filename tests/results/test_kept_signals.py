"""``signals.csv.gz`` of a run, and what exports and the page make of it."""

import gzip
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from deepmf_sumo.exporters import openscenario
from deepmf_sumo.exporters.base import Exportable, signals_of
from deepmf_sumo.report.page.replay import lights
from deepmf_sumo.results import signals
from deepmf_sumo.scene import SignalState
from deepmf_sumo.sumo.network.sumo_road import road_of_net, signal_links

from tests.support.rollout_doubles import case_of, in_traffic, rollout_of, straight

NET = Path(__file__).resolve().parents[2] / "sumo_nets" / "four_way" / "four_way.net.xml"
LEFT, RIGHT, OFF = ":centre_7_0", ":centre_4_0", ":centre_0_0"
GO, CAUTION, STOP = SignalState.GO, SignalState.CAUTION, SignalState.STOP


@pytest.fixture(scope="module")
def road():
    return road_of_net(NET)


@pytest.fixture
def rollout(road):
    """Twenty steps before the lights; one of them changes, and one is not known at first."""
    x, y = road.lanes[LEFT].centre_m[0]
    paths = {
        "av": straight(x + 20, y, 5, steps=31, heading=np.pi),
        "b": straight(x + 40, y, 5, steps=31, heading=np.pi),
    }
    shown = [{LEFT: GO, RIGHT: STOP, "elsewhere": GO} for _ in range(8)]
    shown += [{LEFT: CAUTION, RIGHT: STOP, OFF: STOP} for _ in range(12)]
    return replace(rollout_of(paths), signals=tuple(shown))


def test_changes_are_written_and_states_are_read_back(rollout, road, tmp_path):
    file = tmp_path / signals.FILE
    signals.write_signals(file, rollout, road)
    lines = gzip.decompress(file.read_bytes()).decode().splitlines()
    assert lines == [
        "step,time_s,lane,state",
        f"10,0.0,{LEFT},go",
        f"10,0.0,{RIGHT},stop",
        f"18,0.8,{LEFT},caution",
        f"18,0.8,{OFF},stop",
    ]
    found = signals.read_signals(file, rollout.now, rollout.tracks.steps)
    known = [{lane: one[lane] for lane in one if lane != "elsewhere"} for one in rollout.signals]
    assert list(found) == known


def test_a_light_that_is_not_seen_any_more_is_not_known(rollout, road, tmp_path):
    gap = ({LEFT: STOP},) * 5 + ({},) * 5 + ({LEFT: GO},) * 10
    file = tmp_path / signals.FILE
    signals.write_signals(file, replace(rollout, signals=gap), road)
    assert signals.read_signals(file, rollout.now, rollout.tracks.steps) == gap


def test_a_lane_without_a_direction_has_no_bar(rollout, road):
    place = road.lanes[LEFT].centre_m[0]
    still = replace(road.lanes[LEFT], centre_m=np.tile(place, (3, 1)), previous=())
    assert not lights(rollout, replace(road, lanes={LEFT: still}), place)


def test_no_file_is_written_without_lights_near(rollout, road, tmp_path):
    file = tmp_path / signals.FILE
    signals.write_signals(file, replace(rollout, signals=()), road)
    far = rollout.tracks.position_m + 1000.0
    away = replace(rollout, tracks=replace(rollout.tracks, position_m=far))
    signals.write_signals(file, away, road)
    assert not file.exists()
    assert signals.read_signals(file, 10, 31) == ()


def test_exports_have_them_from_the_current_step_on_at_the_begin_of_the_lane(rollout, road):
    found = signals_of(rollout, road)
    assert found.lane_ids == (LEFT, RIGHT, OFF)
    assert not found.seen[:, :10].any()
    assert found.at(17) == {LEFT: GO, RIGHT: STOP}
    assert found.at(18) == {LEFT: CAUTION, RIGHT: STOP, OFF: STOP}
    assert np.array_equal(found.stop_m[0], road.lanes[LEFT].centre_m[0])
    assert signals_of(replace(rollout, signals=()), road) is None


@pytest.mark.sumo
@pytest.mark.parametrize(
    ("how", "shown"),
    [("words", ("green", "yellow")), ("lamps", ("off;off;on", "off;on;off")), ("none", None)],
)
def test_openscenario_has_phases_of_the_signals_of_the_road(rollout, road, tmp_path, how, shown):
    case = replace(in_traffic(case_of()), net_file=NET, road=road)
    settings = openscenario.Settings(signals=how)
    openscenario.write(Exportable.of(rollout, case), tmp_path / "openscenario", settings)
    root = ET.parse(tmp_path / "openscenario" / "scenario.xosc").getroot()
    phases = [
        (float(phase.get("duration")),
         {one.get("trafficSignalId"): one.get("state") for one in phase})
        for phase in root.iter("Phase")
    ]  # fmt: skip
    if shown is None:
        assert not phases
        return
    (link,) = signal_links(NET)[LEFT]
    name = f"{link.light}_{link.index}"
    assert [duration for duration, _ in phases] == pytest.approx([1.8, 1.3 + 3600.0])
    assert tuple(states[name] for _, states in phases) == shown
    drawn = ET.parse(tmp_path / "openscenario" / "road.xodr").getroot()
    there = {one.get("id") for one in drawn.iter("signal")}
    assert {one for _, states in phases for one in states} <= there


def test_the_page_draws_a_bar_across_each_lane(rollout, road):
    """Of two lanes that begin at one place the left one has the left half."""
    place = road.lanes[LEFT].centre_m[0]
    bars = lights(rollout, road, place)
    (bar,) = [one for one in bars if one[-1][0][1] == "go"]
    x, y, to_x, to_y, changes = bar
    assert changes == [[10, "go"], [18, "caution"]]
    width = road.lanes[LEFT].width_m
    assert np.hypot(to_x - x, to_y - y) == pytest.approx(0.84 * width, abs=0.02)
    assert abs((x + to_x) / 2) + abs((y + to_y) / 2) < 0.1
    three = (f":centre_{number}" for number in ("4_0", "5_0"))
    shared = replace(rollout, signals=(dict.fromkeys(three, STOP),) * 20)
    right, straight_on = sorted(lights(shared, road, place), key=lambda one: -one[1])
    assert right[:4] != straight_on[:4]
    assert np.hypot(right[2] - right[0], right[3] - right[1]) == pytest.approx(
        0.42 * width, abs=0.02
    )
