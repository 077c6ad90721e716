"""OpenSCENARIO and OpenDRIVE, read back by their description, and by ASAM's checker where it is."""

import gzip
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.exporters import openscenario
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.sumo.network.sumo_net import read_once

from tests.exporters.test_ssam import collision
from tests.support.foreign_readers import (
    boxes_of,
    esmini_log,
    first_contact,
    largest_error_m,
    played,
    xosc_boxes,
)
from tests.support.rollout_doubles import case_of, in_traffic, rollout_of, straight

pytestmark = pytest.mark.sumo

NET = Path(__file__).resolve().parents[2] / "sumo_nets" / "four_way" / "four_way.net.xml"
CHECKER = shutil.which("qc_openscenario")
ESMINI = shutil.which("esmini")
PLAYED = Path(__file__).parent / "esmini"


def written(rollout, folder, **settings):
    case = replace(in_traffic(case_of()), net_file=NET)
    path = folder / "openscenario"
    openscenario.write(Exportable.of(rollout, case), path, openscenario.Settings(**settings))
    return path


def named(rollout):
    """Ids as names of entities."""
    plain = re.compile(r"[A-Za-z0-9_][\w.\-]*")
    return {
        agent: agent if plain.fullmatch(agent) else f"agent_{row}"
        for row, agent in enumerate(rollout.tracks.ids)
    }


def expected(rollout, first=0):
    names, boxes = named(rollout), boxes_of(rollout.tracks)
    return {(step - first, names[agent]): box
            for (step, agent), box in boxes.items() if step >= first}  # fmt: skip


def with_gap():
    """As `collision`; the third vehicle is away in between, and once there for a single step."""
    rollout = collision()
    valid = rollout.tracks.valid.copy()
    valid[2, 25:28] = valid[2, 29:33] = False
    kinds = ("vehicle", "vehicle", "cyclist", "pedestrian")
    return replace(rollout, tracks=replace(rollout.tracks, valid=valid, kinds=kinds))


@pytest.mark.parametrize("rollout_of_kind", [collision, with_gap])
def test_boxes_and_contact_are_those_of_the_run(rollout_of_kind, tmp_path):
    rollout = rollout_of_kind()
    found = xosc_boxes(written(rollout, tmp_path) / "scenario.xosc")
    assert largest_error_m(found, expected(rollout)) < 1e-3
    assert first_contact(found, "av", "b") == rollout.contacts[0].step


def check_played(found, rollout):
    assert largest_error_m(found, expected(rollout)) < 1e-3
    assert found.first_contact("av", "b") == rollout.contacts[0].step


@pytest.mark.parametrize("rollout_of_kind", [collision, with_gap])
@pytest.mark.skipif(ESMINI is None, reason="esmini is not on the path")
def test_esmini_plays_the_run(rollout_of_kind, tmp_path):
    rollout = rollout_of_kind()
    check_played(played(ESMINI, written(rollout, tmp_path)), rollout)


@pytest.mark.parametrize("rollout_of_kind", [collision, with_gap])
def test_esmini_has_played_the_run(rollout_of_kind):
    """By its log, kept from esmini 3.6.0 (77028d83) and the files of the test above."""
    text = gzip.decompress((PLAYED / f"{rollout_of_kind.__name__}.csv.gz").read_bytes()).decode()
    check_played(esmini_log(text), rollout_of_kind())


def test_the_reference_point_is_the_rear_axle(tmp_path):
    rollout = collision()
    root = ET.parse(written(rollout, tmp_path) / "scenario.xosc").getroot()
    [place] = root.findall(".//Private[@entityRef='av']//WorldPosition")
    tracks = rollout.tracks
    assert float(place.get("x")) == pytest.approx(tracks.position_m[0, 0, 0] - 0.28 * 4.8, abs=1e-4)
    [av] = root.findall(".//ScenarioObject[@name='av']")
    assert float(next(av.iter("RearAxle")).get("positionX")) == 0
    assert float(next(av.iter("FrontAxle")).get("positionX")) == pytest.approx(0.56 * 4.8)
    roles = {one.get("name"): [p.get("value") for p in one.iter("Property")]
             for one in root.iter("ScenarioObject")}  # fmt: skip
    assert roles["av"] == ["av", "av"]
    assert roles["b"] == ["b", "opponent"]
    assert roles["agent_2"] == ['late, "c"', "other"]


def test_headings_do_not_jump_by_a_turn(tmp_path):
    paths = {"av": straight(0, 0, 10, steps=21)}
    paths["av"][:, 2] = np.pi + 0.02 * np.arange(21) - 0.1
    rollout = rollout_of(paths, opponent_id=None)
    wrapped = replace(rollout.tracks, heading_rad=np.angle(np.exp(1j * paths["av"][None, :, 2])))
    rollout = replace(rollout, tracks=wrapped)
    assert np.abs(np.diff(wrapped.heading_rad)).max() > 6
    file = written(rollout, tmp_path) / "scenario.xosc"
    headings = [float(v.find(".//WorldPosition").get("h")) for v in ET.parse(file).iter("Vertex")]
    assert np.abs(np.diff(headings)).max() < 0.03
    assert largest_error_m(xosc_boxes(file), expected(rollout)) < 1e-3


def test_without_the_av_it_stands_at_its_start_with_a_route(tmp_path):
    rollout = collision()
    file = written(rollout, tmp_path, without_av=True) / "scenario.xosc"
    root = ET.parse(file).getroot()
    assert not root.findall(".//ManeuverGroup/Actors/EntityRef[@entityRef='av']")
    [private] = root.findall(".//Private[@entityRef='av']")
    [speed] = private.iter("AbsoluteTargetSpeed")
    assert float(speed.get("value")) == pytest.approx(10.0)
    points = [float(one.find(".//WorldPosition").get("x")) for one in private.iter("Waypoint")]
    axle = 0.28 * 4.8
    driven = rollout.tracks.position_m[0, rollout.now :, 0] - axle
    assert points[0] == pytest.approx(driven[0], abs=1e-3)
    assert points[-1] == pytest.approx(driven[-1], abs=1e-3)
    assert np.diff(points).min() > 0
    found = xosc_boxes(file)
    others = {key: box for key, box in expected(rollout, rollout.now).items() if key[1] != "av"}
    assert largest_error_m({k: b for k, b in found.items() if k[1] != "av"}, others) < 1e-3


def test_the_road_is_where_sumo_has_it_and_has_no_time_of_its_own(tmp_path):
    folder = written(collision(), tmp_path)
    first = (folder / "road.xodr").read_bytes()
    assert b"<!--" not in first
    openscenario._converted.cache_clear()
    assert (written(collision(), tmp_path) / "road.xodr").read_bytes() == first
    root = ET.fromstring(first)
    net = read_once(NET)
    ends = np.array([lane.shape_m[end][:2] for edge in net.edges.values() for lane in edge.lanes
                     for end in (0, -1)])  # fmt: skip
    roads = [road for road in root.iter("road") if road.get("junction") == "-1"]
    assert len(roads) == sum(not edge.function for edge in net.edges.values())
    for road in roads:
        start = road.find("planView/geometry")
        place = float(start.get("x")), float(start.get("y"))
        assert (
            np.hypot(*(ends - place).T).min() < 3.3
        )  # its left border, a lane's end is its middle


def test_a_network_that_netconvert_refuses_is_named_and_nothing_is_left(tmp_path):
    net = tmp_path / "net.net.xml"
    net.write_text("<net")
    case = replace(in_traffic(case_of()), net_file=net)
    with pytest.raises(ConversionError, match="netconvert failed"):
        openscenario.write(
            Exportable.of(collision(), case), tmp_path / "out", openscenario.Settings()
        )
    assert list(tmp_path.iterdir()) == [net]


@pytest.mark.skipif(CHECKER is None, reason="ASAM's checker qc_openscenario is not installed")
@pytest.mark.parametrize("without_av", [False, True])
@pytest.mark.parametrize("rollout_of_kind", [collision, with_gap])
def test_asams_checker_finds_nothing(rollout_of_kind, without_av, tmp_path):
    folder = written(rollout_of_kind(), tmp_path, without_av=without_av)
    out, config = tmp_path / "out.xqar", tmp_path / "config.xml"
    config.write_text(
        f'<Config><Param name="InputFile" value="{folder}/scenario.xosc"/>'
        '<CheckerBundle application="xoscBundle">'
        f'<Param name="resultFile" value="{out}"/></CheckerBundle></Config>'
    )
    subprocess.run([CHECKER, "-c", config], check=True, capture_output=True)
    checkers = list(ET.parse(out).iter("Checker"))
    assert len(checkers) >= 15
    assert {one.get("status") for one in checkers} == {"completed"}
    assert [issue.attrib for one in checkers for issue in one.iter("Issue")] == []
