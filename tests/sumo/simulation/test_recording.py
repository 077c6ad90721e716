"""Scenes recorded from SUMO traffic."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import sumo
from click.testing import CliRunner

from deepmf_sumo.cli.data import record as command
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.readers import npz, read_by
from deepmf_sumo.training.recording.many import Recording, record

PROGRAMS = Path(sumo.SUMO_HOME) / "bin"
FLOWS = """<routes><vType id="car" carFollowModel="Krauss"/>
<flow id="we" type="car" from="A1B1" to="C1D1" begin="0" end="200" period="4"/>
<flow id="sn" type="car" from="B0B1" to="B1B2" begin="0" end="200" period="5"/>
<flow id="ne" type="car" from="C3C2" to="C1D1" begin="0" end="200" period="6"/></routes>"""


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    folder = tmp_path_factory.mktemp("grid")
    grid = ["--grid", "--grid.number", "4", "--grid.length", "90", "-L", "2", "-j", "traffic_light"]
    subprocess.run(
        [PROGRAMS / "netgenerate", *grid, "-o", "grid.net.xml"],
        cwd=folder,
        check=True,
        capture_output=True,
    )
    (folder / "grid.rou.xml").write_text(FLOWS)
    file = folder / "grid.sumocfg"
    file.write_text(
        '<configuration><input><net-file value="grid.net.xml"/><route-files value="grid.rou.xml"/>'
        '</input><processing><lanechange.duration value="3"/></processing></configuration>'
    )
    return file


@pytest.fixture(scope="module")
def scenes(config):
    return list(record(Recording(config=config, seed=4, start_s=30.0, stop_s=75.0)))


def test_scenes_are_complete(scenes):
    assert len(scenes) == 5
    assert len({scene.name for scene in scenes}) == len(scenes)
    for scene in scenes:
        tracks = scene.tracks
        av = tracks.row(scene.av_id)
        assert (tracks.steps, scene.now) == (91, 10)
        assert tracks.valid[av].all()
        assert tracks.agents > 3
        assert set(scene.interest) <= set(tracks.ids)
        assert scene.av_id in scene.to_predict
        assert scene.road.lanes.keys() >= set(scene.signals.lane_ids)
        assert scene.signals.at(scene.now)


def test_motion_is_smooth_and_consistent(scenes):
    for scene in scenes:
        tracks = scene.tracks
        both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
        acceleration = np.hypot(*np.moveaxis(np.diff(tracks.velocity_mps, axis=1), -1, 0)) / 0.1
        assert acceleration[both].max() < 12.0
        way = np.diff(tracks.position_m, axis=1)
        mean = (tracks.velocity_mps[:, 1:] + tracks.velocity_mps[:, :-1]) / 2
        assert np.abs(way / 0.1 - mean)[both].max() < 0.6
        driving = tracks.valid & (tracks.speed_mps > 3.0)
        course = np.arctan2(tracks.velocity_mps[..., 1], tracks.velocity_mps[..., 0])
        slip = np.abs(frames.difference(course, tracks.heading_rad))[driving]
        assert np.percentile(slip, 99) < 0.2


def test_a_moment_gives_scenes_around_several_avs_and_the_road_near_them(config):
    recording = Recording(
        config=config, seed=4, start_s=55.0, stop_s=64.5, avs=3, radius_m=60.0, map_radius_m=40.0
    )
    scenes = list(record(recording))
    assert len(scenes) == 3
    assert len({scene.av_id for scene in scenes}) == 3
    assert len({scene.name for scene in scenes}) == 3
    everywhere = set().union(*(scene.road.lanes for scene in scenes))
    for scene in scenes:
        assert len(scene.road.lanes) < len(everywhere)
        assert scene.road.lanes.keys() >= set(scene.signals.lane_ids)
        for lane in scene.road.lanes.values():
            assert {*lane.next, *lane.previous} <= scene.road.lanes.keys()
        row = scene.tracks.row(scene.av_id)
        away = np.linalg.norm(scene.tracks.position_m - scene.tracks.position_m[row], axis=-1)
        assert np.where(scene.tracks.valid, away, np.inf).min(axis=1).max() < 60.0


def test_drivers_ease_into_motion(scenes):
    """Accelerations from rest build up, and are those of people."""
    peaks, first = [], []
    for scene in scenes:
        for speed, valid in zip(scene.tracks.speed_mps, scene.tracks.valid, strict=True):
            known = speed[valid]
            starts = np.flatnonzero((known[:-1] < 0.2) & (known[1:] >= 0.2))
            if len(starts) and known[starts[-1] :].max() > 3.0:
                acceleration = np.gradient(known[starts[-1] :], 0.1)
                peaks.append(acceleration.max())
                first.append(acceleration[:5].mean())
    assert len(peaks) > 2
    assert 0.7 < np.median(peaks) < 3.0
    assert np.median(first) < 0.75 * np.median(peaks)


def test_poses_are_on_the_lanes(scenes):
    scene = scenes[0]
    points = np.concatenate([lane.centre_m for lane in scene.road.lanes.values()])
    centre = scene.tracks.position_m[:, scene.now][scene.tracks.valid[:, scene.now]]
    away = np.hypot(*np.moveaxis(centre[:, None] - points, -1, 0)).min(axis=1)
    assert np.median(away) < 25.0  # lanes' points are as far apart as straight lanes are long
    assert len({tuple(size) for size in scene.tracks.size_m}) > 1  # drivers are mixed


def test_same_seed_same_scenes_and_another_seed_others(config, scenes):
    again = list(record(Recording(config=config, seed=4, start_s=30.0, stop_s=75.0)))
    assert [scene.name for scene in again] == [scene.name for scene in scenes]
    for one, other in zip(scenes, again, strict=True):
        assert one.tracks.position_m.tobytes() == other.tracks.position_m.tobytes()
        assert one.source == other.source
    third = next(record(Recording(config=config, seed=5, start_s=30.0, stop_s=75.0)))
    assert third.source.sha256 != scenes[0].source.sha256
    assert third.tracks.position_m.shape != scenes[0].tracks.position_m.shape or not np.allclose(
        third.tracks.position_m, scenes[0].tracks.position_m
    )


def test_command_writes_files_that_can_be_read(config, tmp_path):
    out = tmp_path / "scenes"
    arguments = [
        str(config),
        "--out",
        str(out),
        "--scenes",
        "2",
        "--seed",
        "4",
        "--set",
        "start_s=30",
    ]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    assert "2 scenes" in result.output
    files = sorted(out.glob("grid-4/*.npz"))
    assert len(files) == 2
    assert [scene.tracks.steps for file in files for scene in read_by(npz, file)] == [91, 91]
