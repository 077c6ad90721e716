"""Traces of OSI ground truth, read back by ASAM's own library and by the format's description."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.errors import PluginError
from deepmf_sumo.exporters import osi
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.results.exports import Format

from tests.exporters.test_scenarionet import road
from tests.exporters.test_ssam import collision
from tests.support.foreign_readers import (
    boxes_of,
    first_contact,
    largest_error_m,
    osi_boxes,
)
from tests.support.rollout_doubles import case_of


def test_without_the_extra_it_is_refused_before_any_run(monkeypatch):
    monkeypatch.setitem(sys.modules, "osi3", None)
    monkeypatch.setattr(osi, "find_spec", lambda name: None)
    with pytest.raises(PluginError, match=r'needs osi-python.*pip install "deepmf-sumo\[osi\]"'):
        Format.named("osi")


@pytest.fixture
def folder(tmp_path):
    pytest.importorskip("osi_utilities", reason="not installed: pip install deepmf-sumo[osi]")
    return written(collision(), tmp_path)


def written(rollout, folder, **settings):
    case = replace(case_of(), road=road())
    osi.write(Exportable.of(rollout, case), folder / "osi", osi.Settings(**settings))
    return folder / "osi"


def messages(path):
    """All messages, by ASAM's reader."""
    from osi_utilities import create_reader

    with create_reader(path) as reader:
        assert reader.open(path)
        return [found.message for found in reader]


def test_boxes_and_contact_are_those_of_the_run(folder):
    rollout = collision()
    found = osi_boxes(folder)
    assert largest_error_m(found, boxes_of(rollout.tracks)) < 1e-9
    assert first_contact(found, "av", "b") == rollout.contacts[0].step


def test_asams_reader_finds_the_same_messages_in_both_files(folder):
    traced, recorded = messages(folder / "run_gt.osi"), messages(folder / "run.mcap")
    rollout = collision()
    assert [one.SerializeToString() for one in traced] == [
        one.SerializeToString() for one in recorded
    ]
    assert len(traced) == rollout.tracks.steps
    times = [one.timestamp.seconds + one.timestamp.nanos / 1e9 for one in traced]
    assert times == pytest.approx(np.arange(len(traced)) * rollout.dt_s)
    for step, one in enumerate(traced):
        there = {user.source_reference[0].identifier[0]: user for user in one.moving_object}
        rows = np.flatnonzero(rollout.tracks.valid[:, step])
        assert list(there) == [rollout.tracks.ids[row] for row in rows]
        assert one.host_vehicle_id == there["av"].id
        speed = rollout.tracks.velocity_mps[rollout.tracks.row("b"), step]
        assert (there["b"].base.velocity.x, there["b"].base.velocity.y) == tuple(speed)


def test_accelerations_are_differences_of_velocities(tmp_path):
    pytest.importorskip("osi_utilities", reason="not installed: pip install deepmf-sumo[osi]")
    rollout = collision()
    tracks = rollout.tracks
    faster = 1 + 0.1 * np.arange(tracks.steps)[:, None] ** 2
    tracks = replace(tracks, velocity_mps=tracks.velocity_mps * faster)
    traced = messages(written(replace(rollout, tracks=tracks), tmp_path) / "run_gt.osi")
    row, found = tracks.row('late, "c"'), {}
    for step, one in enumerate(traced):
        for user in one.moving_object:
            if user.source_reference[0].identifier[0] == 'late, "c"':
                found[step] = (user.base.acceleration.x, user.base.acceleration.y)
    assert list(found) == list(range(20, tracks.steps))
    for step in range(21, tracks.steps):
        difference = (tracks.velocity_mps[row, step] - tracks.velocity_mps[row, step - 1]) / 0.1
        assert found[step] == pytest.approx(tuple(difference))
        assert found[step][0] > 30  # 8 m/s times 0.1 times (2 step - 1) / 0.1 s
    assert found[20] == found[21]  # its first step


def test_types_heights_and_axles(tmp_path):
    pytest.importorskip("osi_utilities", reason="not installed: pip install deepmf-sumo[osi]")
    rollout = collision()
    kinds = ("vehicle", "vehicle", "cyclist", "pedestrian")
    tracks = replace(rollout.tracks, kinds=kinds)
    traced = messages(written(replace(rollout, tracks=tracks), tmp_path) / "run_gt.osi")
    users = traced[25].moving_object
    assert [one.Type.Name(one.type) for one in users] == [
        "TYPE_VEHICLE", "TYPE_VEHICLE", "TYPE_VEHICLE", "TYPE_PEDESTRIAN",
    ]  # fmt: skip
    types = users[0].VehicleClassification.Type
    assert [one.vehicle_classification.type for one in users[:3]] == [
        types.Value(name) for name in ("TYPE_CAR", "TYPE_HEAVY_TRUCK", "TYPE_BICYCLE")
    ]
    assert not users[3].HasField("vehicle_classification")
    assert users[0].base.position.z == 0.75  # half of 1.5 m
    assert users[0].vehicle_attributes.bbcenter_to_rear.x == pytest.approx(-0.28 * 4.8)


def test_lines_and_edges_near_the_way_are_there_and_the_others_counted(tmp_path, folder):
    first = messages(folder / "run_gt.osi")[0]
    kinds = first.lane_boundary[0].Classification
    found = {
        one.source_reference[0].identifier[0]: (
            kinds.Type.Name(one.classification.type), kinds.Color.Name(one.classification.color),
        )
        for one in first.lane_boundary
    }  # fmt: skip
    assert found == {
        "a": ("TYPE_SOLID_LINE", "COLOR_WHITE"), "l": ("TYPE_SOLID_LINE", "COLOR_YELLOW"),
        "e": ("TYPE_ROAD_EDGE", "COLOR_NONE"), "f": ("TYPE_ROAD_EDGE", "COLOR_NONE"),
    }  # fmt: skip
    points = [(one.position.x, one.position.y, one.position.z)
              for one in first.lane_boundary[0].boundary_line]  # fmt: skip
    assert points == [(0, 2, 0), (100, 2, 0), (110, 3, 1)]
    numbers = [one.id.value for one in (*first.lane_boundary, *first.moving_object)]
    assert len(set(numbers)) == len(numbers)
    for around, left_out in ((0.0, 4), (1.0, 4), (3.0, 0)):  # the lines are 2 m beside the way
        about = written(collision(), tmp_path, around_m=around) / "about.json"
        assert json.loads(about.read_text())["lane_boundaries_left_out"] == left_out
