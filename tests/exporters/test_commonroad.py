"""CommonRoad scenarios: by a reader of our own, and by commonroad-io in an environment of its own.

commonroad-io needs another protobuf than this project: `DEEPMF_SUMO_COMMONROAD` names the Python of
an environment with ``commonroad-io==2024.3``.
"""

import json
import os
import subprocess
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from deepmf_sumo.errors import RunError
from deepmf_sumo.exporters import commonroad
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import Lane, Neighbour, RoadMap

from tests.exporters.test_ssam import collision
from tests.support.foreign_readers import boxes_of, commonroad_boxes, largest_error_m
from tests.support.rollout_doubles import case_of

THEIRS = os.environ.get("DEEPMF_SUMO_COMMONROAD")


def road():
    """Two lanes side by side, the left one goes on around a bend; one of the other direction."""
    left = Neighbour(lane_id="b", self_start=0, self_end=1, other_start=0, other_end=1)
    right = Neighbour(lane_id="a", self_start=0, self_end=1, other_start=0, other_end=1)
    facing = Neighbour(lane_id="d", self_start=0, self_end=1, other_start=0, other_end=1)
    bend = [(100 + 20 * np.sin(a), 23.5 - 20 * np.cos(a)) for a in np.linspace(0, np.pi / 2, 10)]

    def lane(points, **more):
        return {"centre_m": points, "z_m": [0.0] * len(points), "width_m": 3.5, **more}

    return RoadMap(
        lanes={
            "a": Lane(id="a", kind="street", speed_limit_mps=13.89, left=(left,),
                      **lane([(-50, 0), (100, 0)])),
            "b": Lane(id="b", kind="street", speed_limit_mps=13.89, right=(right,), left=(facing,),
                      next=("c", "gone"), **lane([(-50, 3.5), (100, 3.5)])),
            "c": Lane(id="c", kind="freeway", speed_limit_mps=8.0, previous=("b",), **lane(bend)),
            "d": Lane(id="d", kind="bike", **lane([(100, 7), (-50, 7)])),
        }
    )  # fmt: skip


def run(rollout=None):
    case = case_of()
    case = replace(case, road=road(), scene=replace(case.scene, road=road()), duration_steps=80)
    return Exportable.of(rollout or collision(), case)


def written(tmp_path, rollout=None, **settings):
    path = tmp_path / commonroad.FILE
    commonroad.write(run(rollout), path, commonroad.Settings(**settings))
    return path


def since_now(scene):
    boxes = boxes_of(scene.tracks).items()
    return {(step - scene.now, name): box for (step, name), box in boxes if step >= scene.now}


def test_boxes_are_those_of_the_run(tmp_path):
    expected = since_now(scene_of(run()))
    found = commonroad_boxes(written(tmp_path, av="obstacle"))
    assert largest_error_m(found, expected) < 1e-4
    without = {key: box for key, box in expected.items() if key[1] != "av"}
    assert largest_error_m(commonroad_boxes(written(tmp_path)), without) < 1e-4


def test_one_that_comes_back_is_two_obstacles(tmp_path):
    rollout = collision()
    valid = rollout.tracks.valid.copy()
    valid[rollout.tracks.row("b"), 15:20] = False
    gone = replace(rollout, tracks=replace(rollout.tracks, valid=valid))
    root = ET.parse(written(tmp_path, gone)).getroot()
    ids = [one.get("id") for one in root if one.get("id")]
    assert len(ids) == len(set(ids))
    found = commonroad_boxes(written(tmp_path, gone))
    assert {step for step, name in found if name == "b"} >= {4, 10}
    assert not {step for step, name in found if name == "b"} & set(range(5, 10))


@pytest.mark.parametrize("name", ["a--b", "a---b", "----", "-"])
def test_an_id_of_dashes_leaves_the_file_well_formed(tmp_path, name):
    rollout = collision()
    ids = tuple(name if one == "b" else one for one in rollout.tracks.ids)
    renamed = replace(rollout, tracks=replace(rollout.tracks, ids=ids))
    path = written(tmp_path, renamed)
    assert ET.parse(path).getroot().tag == "commonRoad"


def test_lanelets_lie_beside_their_lane(tmp_path):
    root = ET.parse(written(tmp_path)).getroot()
    lanelets = list(root.iter("lanelet"))
    assert len(lanelets) == 4

    def points(bound):
        return np.array([[float(p.findtext(axis)) for axis in "xy"] for p in bound.iter("point")])

    for lanelet, lane in zip(lanelets, road().lanes.values(), strict=True):
        left, right = (points(lanelet.find(name)) for name in ("leftBound", "rightBound"))
        np.testing.assert_allclose((left + right) / 2, lane.centre_m, atol=1e-3)
        np.testing.assert_allclose(np.hypot(*(left - right).T), 3.5, atol=1e-3)
    a, b, c, d = lanelets
    assert a.find("adjacentLeft").attrib == {"ref": b.get("id"), "drivingDir": "same"}
    assert b.find("adjacentLeft").attrib == {"ref": d.get("id"), "drivingDir": "opposite"}
    assert [one.get("ref") for one in b.iter("successor")] == [c.get("id")]
    signs = {one.get("id"): one.findtext("trafficSignElement/additionalValue")
             for one in root.iter("trafficSign")}  # fmt: skip
    limits = [signs[one.find("trafficSignRef").get("ref")] for one in (a, b, c)]
    assert limits == ["13.8900", "13.8900", "8.0000"]
    assert d.find("trafficSignRef") is None


def test_the_problem_is_the_avs_and_lasts_to_the_end(tmp_path):
    scene = scene_of(run())
    problem = ET.parse(written(tmp_path)).getroot().find("planningProblem")
    row = scene.tracks.row("av")
    place = [float(problem.findtext(f"initialState/position/point/{axis}")) for axis in "xy"]
    np.testing.assert_allclose(place, scene.tracks.position_m[row, scene.now], atol=1e-4)
    assert problem.findtext("goalState/time/intervalEnd") == str(scene.tracks.steps - 1 - scene.now)


def test_without_the_av_there_is_no_problem(tmp_path):
    rollout = collision()
    valid = rollout.tracks.valid.copy()
    valid[rollout.tracks.row("av"), rollout.now] = False
    gone = replace(rollout, tracks=replace(rollout.tracks, valid=valid))
    with pytest.raises(RunError, match="the AV is not there at the begin of the attack"):
        written(tmp_path, gone)
    assert not (tmp_path / commonroad.FILE).exists()


READ = """
import json, sys
from commonroad.common.file_reader import CommonRoadFileReader
scenario, problems = CommonRoadFileReader(sys.argv[1]).open()
lanelets = {one.lanelet_id: one for one in scenario.lanelet_network.lanelets}
states = [
    [state.time_step, *map(float, state.position), float(state.orientation),
     one.obstacle_shape.length, one.obstacle_shape.width]
    for one in scenario.dynamic_obstacles
    for state in [one.initial_state, *one.prediction.trajectory.state_list]
]
print(json.dumps({
    "dt": scenario.dt, "lanelets": len(lanelets), "states": sorted(states),
    "left": [one.adj_left for one in lanelets.values()],
    "problems": len(problems.planning_problem_dict),
}))
"""


@pytest.mark.sumo
def test_commonroad_io_reads_it(tmp_path):
    if not THEIRS:
        pytest.skip("DEEPMF_SUMO_COMMONROAD names no Python with commonroad-io")
    file = written(tmp_path)
    done = subprocess.run([THEIRS, "-c", READ, file], check=True, capture_output=True, text=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert (found["dt"], found["lanelets"], found["problems"]) == (0.1, 4, 1)
    assert found["left"] == [2, 4, None, None]
    expected = sorted(
        [step, box.x, box.y, box.heading, box.length, box.width]
        for (step, name), box in since_now(scene_of(run())).items()
        if name != "av"
    )
    np.testing.assert_allclose(found["states"], expected, atol=1e-3)
