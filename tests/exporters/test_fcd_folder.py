"""The folder for sumo-gui: it replays what happened."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sumo

from deepmf_sumo.exporters import fcd
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.planners import idm
from deepmf_sumo.scene import Polygon
from deepmf_sumo.sumo.network.sumo_road import road_of_net
from deepmf_sumo.sumo.simulation import simulate

from tests.support.rollout_doubles import in_traffic, rollout_of, straight
from tests.support.simulated_worlds import LANE_M, case_of, scene_of, straight_motion, straight_road

pytestmark = pytest.mark.sumo


def write(rollout, case, path):
    fcd.write(Exportable.of(rollout, case), path, fcd.Settings())


def poses(file):
    """(time, id) -> x, y, angle of an FCD file."""
    found, time = {}, 0.0
    for line in Path(file).read_text().splitlines():
        if moment := re.search(r'<timestep time="([\d.]+)"', line):
            time = round(float(moment[1]), 1)
        pattern = r'<vehicle id="([^"]+)" x="([-\d.]+)" y="([-\d.]+)" angle="([-\d.]+)"'
        if one := re.search(pattern, line):
            found[time, one[1]] = tuple(float(value) for value in one.groups()[1:])
    return found


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    motions = {
        "av": straight_motion(60.0, 0.4, 0.0, 12.0),
        "other": straight_motion(95.0, LANE_M - 0.5, 0.0, 8.0),
        "parked": straight_motion(120.0, -9.0, 0.3, 0.0),
        "walker": straight_motion(100.0, -6.0, 1.5, 0.8),
    }
    scene = scene_of(straight_road(), motions, kinds={"walker": "pedestrian"})
    case = case_of(scene, folder)
    rollout = simulate(case, idm.build(idm.Settings()), None, rng=np.random.default_rng(0))
    write(rollout, case, folder / "sumo")
    return rollout, folder / "sumo"


def test_sumo_replays_the_vehicles_where_they_were(exported, tmp_path):
    rollout, folder = exported
    out = tmp_path / "seen.xml"
    program = Path(sumo.SUMO_HOME) / "bin" / "sumo"
    run = subprocess.run(
        [program, "-c", folder / fcd.CONFIG, "--fcd-output", out, "--precision", "4"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    seen = poses(out)
    tracks = rollout.tracks
    for agent in ("av", "other"):
        row = tracks.row(agent)
        # in its first step SUMO puts a vehicle on the middle of the lane
        for step in range(1, tracks.steps):
            x, y, angle = seen[round(step * 0.1, 1), agent]
            half = tracks.size_m[row, 0] / 2
            heading = tracks.heading_rad[row, step]
            centre = np.array([x, y]) - half * np.array([np.cos(heading), np.sin(heading)])
            assert np.abs(centre - tracks.position_m[row, step]).max() < 0.01
            assert angle == pytest.approx(90.0 - np.degrees(heading), abs=0.01)


def test_fcd_has_everybody_and_the_parked_car_is_a_polygon(exported):
    _, folder = exported
    fcd_ids = {agent for _, agent in poses(folder / fcd.FCD)}
    assert fcd_ids >= {"av", "other", "walker"}
    assert {agent for _, agent in poses(folder / fcd.REPLAY)} == {"av", "other"}
    assert 'id="box_parked"' in (folder / fcd.SHAPES).read_text()


def test_sumo_takes_the_polygon_of_a_person(exported, tmp_path):
    _, folder = exported
    waits = np.tile([60.0, 9.0, 0.0], (91, 1))
    rollout = rollout_of({"av": straight(60, 0, 12), "person p.1": waits}, opponent_id=None)
    rollout = replace(rollout, tracks=replace(rollout.tracks, kinds=("vehicle", "pedestrian")))
    present = rollout.tracks.valid & np.array([[True], [False]])
    shapes = tmp_path / "shapes.add.xml"
    shapes.write_text(fcd._shapes(rollout, present))
    assert shapes.read_text().count("<poly") == 1
    program = Path(sumo.SUMO_HOME) / "bin" / "sumo"
    command = [program, "-n", folder / fcd.NET, "-a", shapes, "--end", "1"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")


@pytest.mark.parametrize("links", [True, False])
def test_where_all_are_replayed_the_disk_holds_them_once(tmp_path, monkeypatch, links):
    def refused(*_):
        raise OSError(1, "Operation not permitted")

    if not links:
        monkeypatch.setattr(fcd.os, "link", refused)
    motions = {"av": straight_motion(60.0, 0.0, 0.0, 12.0)}
    case = case_of(scene_of(straight_road(), motions), tmp_path)
    rollout = simulate(case, idm.build(idm.Settings()), None, rng=np.random.default_rng(0))
    write(rollout, case, tmp_path / "sumo")
    everybody, replayed = tmp_path / "sumo" / fcd.FCD, tmp_path / "sumo" / fcd.REPLAY
    assert everybody.samefile(replayed) == links
    assert everybody.read_bytes() == replayed.read_bytes()


def test_writing_again_replaces_the_folder(exported):
    rollout, folder = exported
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    case = case_of_folder(folder, rollout)
    write(rollout, case, folder)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def case_of_folder(folder, rollout):
    """The case again: its net lies beside the exported folder."""
    from deepmf_sumo.scene import RecordedCase
    from deepmf_sumo.sumo import network

    tracks = rollout.tracks
    motions = {
        name: np.column_stack(
            [tracks.position_m[row], tracks.heading_rad[row], tracks.speed_mps[row]]
        )
        for row, name in enumerate(tracks.ids)
    }
    scene = scene_of(straight_road(), motions, kinds={"walker": "pedestrian"})
    return RecordedCase(
        name="again",
        road=scene.road,
        av_id="av",
        duration_steps=80,
        traffic="log",
        seed=0,
        scene=scene,
        net=network.read(folder.parent / "net"),
    )


def test_heights_are_written_where_there_are_any(exported, tmp_path):
    rollout, folder = exported
    assert ' z="' not in (folder / fcd.FCD).read_text()
    case = case_of(
        scene_of(straight_road(), {"av": straight_motion(60.0, 0.4, 0.0, 12.0)}), tmp_path
    )
    tracks = replace(rollout.tracks, z_m=np.full(rollout.tracks.z_m.shape, 8.0))
    write(replace(rollout, tracks=tracks), case, tmp_path / "sumo")
    text = (tmp_path / "sumo" / fcd.FCD).read_text()
    assert text.count(' z="8.00"/>') == text.count("<vehicle ") == rollout.tracks.valid.sum()


def test_buildings_and_water_beside_a_network_are_in_the_folder(tmp_path):
    """They hide people: whoever reads the folder must know them. Crossings are in the network."""
    scene = scene_of(straight_road(), {"av": straight_motion(60.0, 0.4, 0.0, 12.0)})
    case = case_of(scene, tmp_path)
    rollout = rollout_of({"av": straight(60, 0, 12)}, opponent_id=None)
    areas = {
        kind: Polygon(id=name, kind=kind, points_m=np.eye(3, 2) * 9 + 0.25, z_m=np.zeros(3))
        for kind, name in {"building": "h", "water": "w", "crosswalk": ":x_c0"}.items()
    }
    road = replace(
        case.road,
        polygons=(areas["crosswalk"],),
        buildings=(areas["building"],),
        water=(areas["water"],),
    )
    traffic = replace(in_traffic(case), road=road, net_file=case.net.file)
    write(rollout, traffic, tmp_path / "sumo")
    back = road_of_net(tmp_path / "sumo" / "net.net.xml", [tmp_path / "sumo" / fcd.MAP])
    assert [one.kind for one in (*back.buildings, *back.water)] == ["building", "water"]
    np.testing.assert_allclose(back.buildings[0].points_m, areas["building"].points_m)
    assert fcd.MAP in (tmp_path / "sumo" / fcd.CONFIG).read_text()
    write(rollout, replace(traffic, road=case.road), tmp_path / "plain")
    assert not (tmp_path / "plain" / fcd.MAP).exists()


@pytest.mark.parametrize(
    ("permission", "cars_m"),
    [
        ("bus", 0),
        ("tram", 0),
        ("subway", 0),
        ("ship", 0),
        ("bicycle", 0),
        ("tram", 80),
        ("tram", 120),
    ],
)
def test_sumo_replays_what_begins_on_a_lane_that_is_not_for_cars(tmp_path, permission, cars_m):
    """Each pose is the one that was written. ``cars_m``: how far a lane for cars is, 0 for none."""
    cars = (
        '<edge id="c" from="a" to="b"><lane id="c_0" index="0" allow="passenger" speed="20" '
        f'length="300" shape="0,{cars_m} 300,{cars_m}"/></edge>'
    )
    net = tmp_path / "track.net.xml"
    net.write_text(
        '<net version="1.20"><location netOffset="0,0" convBoundary="0,0,300,0" '
        'origBoundary="0,0,300,0" projParameter="!"/><edge id="e" from="a" to="b"><lane id="e_0" '
        f'index="0" allow="{permission}" speed="20" length="300" shape="0,0 300,0"/></edge>'
        f"{cars if cars_m else ''}"
        '<junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,1"/>'
        '<junction id="b" type="dead_end" x="300" y="0" incLanes="e_0" intLanes="" '
        'shape="300,0 300,1"/></net>'
    )
    scene = scene_of(straight_road(), {"av": straight_motion(60.0, 0.4, 0.0, 12.0)})
    case = in_traffic(case_of(scene, tmp_path))
    rollout = rollout_of({"av": straight(60, 0, 12)}, opponent_id=None)
    write(rollout, replace(case, road=road_of_net(net), net_file=net), tmp_path / "sumo")
    out = tmp_path / "seen.xml"
    program = Path(sumo.SUMO_HOME) / "bin" / "sumo"
    command = [program, "-c", tmp_path / "sumo" / fcd.CONFIG, "--fcd-output", out]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    seen = poses(out)
    written = poses(tmp_path / "sumo" / fcd.FCD)
    assert seen.keys() == written.keys()
    np.testing.assert_allclose([seen[one] for one in written], [*written.values()], atol=0.01)
