"""ScenarioNet's pickles: MetaDrive's rules, both numpys, and back through our reader."""

import pickle
import pickletools
from dataclasses import fields, replace

import numpy as np
import pytest

from deepmf_sumo.exporters import scenarionet
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import (
    Boundary,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Signals,
    StopSign,
    readers,
)

from tests.exporters.test_ssam import collision
from tests.support.foreign_readers import (
    boxes_of,
    check_scenario,
    first_contact,
    largest_error_m,
    scenario_boxes,
)
from tests.support.rollout_doubles import case_of


def road():
    """All kinds of features; the first line has the id of a lane, as in SUMO networks."""
    beside = Neighbour(lane_id="b", self_start=0, self_end=1, other_start=0, other_end=1)
    border = Boundary(start=0, end=1, feature_id="a", kind=2)
    points = {"points_m": [(0, 2), (100, 2), (110, 3)], "z_m": [0, 0, 1]}
    lane = {"centre_m": [(0, 0), (100, 0)], "z_m": [0.0, 2.0]}
    return RoadMap(
        lanes={
            "a": Lane(id="a", kind="freeway", speed_limit_mps=13.89, next=("b",), left=(beside,),
                      left_boundaries=(border,), **lane),
            "b": Lane(id="b", kind="unknown", interpolating=True, previous=("a",), **lane),
            "c": Lane(id="c", kind="bike", **lane),
        },
        lines=(Polyline(id="a", kind=2, **points), Polyline(id="l", kind=7, **points)),
        edges=(Polyline(id="e", kind=2, **points), Polyline(id="f", kind=0, **points)),
        polygons=(Polygon(id="p", kind="crosswalk", **points),
                  Polygon(id="q", kind="driveway", **points)),
        stop_signs=(StopSign(id="s", position_m=(5, 5), z_m=1.0, lane_ids=("b", "c")),),
    )  # fmt: skip


def run():
    case = case_of()
    state = np.tile(np.array([4, 6], np.uint8)[:, None], (1, 91))
    seen = np.ones((2, 91), bool)
    seen[1, ::2] = False
    signals = Signals(lane_ids=("a", "b"), state=np.where(seen, state, 0), seen=seen,
                      stop_m=[(1, 2), (3, 4)], stop_z_m=[0.5, 0.0])  # fmt: skip
    scene = replace(case.scene, signals=signals)
    return Exportable.of(collision(), replace(case, road=road(), scene=scene, duration_steps=80))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / scenarionet.FILE
    scenarionet.write(run(), path, scenarionet.Settings())
    return path


def test_metadrives_rules_hold(file):
    check_scenario(pickle.loads(file.read_bytes()))


def test_metadrives_own_check_passes(file):
    module = pytest.importorskip("metadrive.scenario.scenario_description")
    found = pickle.loads(file.read_bytes())
    module.ScenarioDescription.sanity_check(found, check_self_type=True, valid_check=True)


def test_both_numpys_know_what_it_names(file):
    operations = list(pickletools.genops(file.read_bytes()))
    named = {argument for one, argument, _ in operations if one.name == "GLOBAL"}
    assert named == {"numpy.core.multiarray _reconstruct", "numpy ndarray", "numpy dtype"}
    assert {one.name for one, _, _ in operations} & {"STACK_GLOBAL", "EXT1", "REDUCE"} == {"REDUCE"}


@pytest.mark.sumo
def test_our_reader_gets_the_scene_back(file):
    expected = scene_of(run())
    [scene] = readers.scenes([file])
    assert scene.repairs == ()
    for name in ("name", "now", "av_id", "interest"):
        assert getattr(scene, name) == getattr(expected, name)
    assert np.array_equal(scene.timestamps_s, expected.timestamps_s)
    same(scene.tracks, expected.tracks)
    same(scene.signals, expected.signals)
    assert scene.road.lanes.keys() == expected.road.lanes.keys()
    for key, lane in expected.road.lanes.items():
        renamed = tuple(replace(one, feature_id="a:line") for one in lane.left_boundaries)
        same(scene.road.lanes[key], replace(lane, left_boundaries=renamed))
    assert [one.id for one in scene.road.lines] == ["a:line", "l"]
    same(scene.road.lines[0], replace(expected.road.lines[0], id="a:line"))
    for name in ("edges", "polygons", "stop_signs"):
        for found, one in zip(getattr(scene.road, name), getattr(expected.road, name), strict=True):
            same(found, one)


def same(found, expected):
    for field in fields(expected):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(other, np.ndarray | float):
            assert np.allclose(one, other, rtol=0, atol=1e-6), field.name
        else:
            assert one == other, field.name


def test_boxes_and_contact_are_those_of_the_run(file):
    rollout = collision()
    found = scenario_boxes(pickle.loads(file.read_bytes()))
    there = {key: box for key, box in found.items() if key[0] < rollout.tracks.steps}
    assert largest_error_m(there, boxes_of(rollout.tracks)) < 1e-6
    assert first_contact(there, "av", "b") == rollout.contacts[0].step


def test_an_unknown_height_is_a_usual_one(tmp_path):
    rollout = collision()
    flat = replace(rollout.tracks, size_m=rollout.tracks.size_m * [1, 1, 0])
    path = tmp_path / scenarionet.FILE
    scenarionet.write(
        Exportable.of(replace(rollout, tracks=flat), case_of()), path, scenarionet.Settings()
    )
    found = pickle.loads(path.read_bytes())["tracks"]["av"]["state"]["height"]
    assert set(found[found > 0]) == {1.5}
