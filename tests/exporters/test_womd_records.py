"""Scenarios of the Waymo Open Motion Dataset: checksums, other readers, and back through ours."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.exporters import womd
from deepmf_sumo.exporters._numbers import Numbers
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import readers

from tests.exporters.test_scenarionet import run, same
from tests.exporters.test_ssam import collision
from tests.support.foreign_readers import (
    boxes_of,
    crc32c,
    first_contact,
    largest_error_m,
    tfrecords,
    wire,
    womd_boxes,
)
from tests.support.rollout_doubles import case_of


@pytest.fixture
def folder(tmp_path):
    womd.write(run(), tmp_path / "womd", womd.Settings())
    return tmp_path / "womd"


def names_of(folder):
    """Number -> id by kind, of those whose id is not the number."""
    with (folder / "ids.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(row["kind"], row["number"]): row["id"] for row in rows}


def test_the_checksum_of_the_test_is_the_standards():
    assert crc32c(b"123456789") == 0xE3069283  # of the catalogue of CRCs
    assert crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, B.4


def test_a_changed_byte_is_noticed(folder):
    content = bytearray((folder / "run.tfrecord").read_bytes())
    assert len(tfrecords(bytes(content))) == 1
    content[100] ^= 1
    with pytest.raises(AssertionError, match="byte 12"):
        tfrecords(bytes(content))


def test_boxes_and_contact_are_those_of_the_run(folder):
    rollout = collision()
    found = womd_boxes(folder)
    there = {key: box for key, box in found.items() if key[0] < rollout.tracks.steps}
    assert largest_error_m(there, boxes_of(rollout.tracks)) < 1e-5
    assert first_contact(there, "av", "b") == rollout.contacts[0].step


@pytest.mark.sumo
def test_our_reader_gets_the_scene_back_but_for_the_ids(folder):
    expected, names = scene_of(run()), names_of(folder)
    [scene] = readers.scenes([folder / "run.tfrecord"])
    assert scene.repairs == ()
    assert (scene.name, scene.now) == (expected.name, expected.now)
    assert names["track", scene.av_id] == expected.av_id
    assert [names["track", one] for one in scene.interest] == list(expected.interest)
    assert scene.to_predict == scene.interest
    assert np.array_equal(scene.timestamps_s, expected.timestamps_s)
    ids = tuple(names["track", one] for one in scene.tracks.ids)
    same(replace(scene.tracks, ids=ids), expected.tracks)
    lights = tuple(names["lane", one] for one in scene.signals.lane_ids)
    same(replace(scene.signals, lane_ids=lights), expected.signals)
    assert [names["lane", key] for key in scene.road.lanes] == list(expected.road.lanes)
    for lane, one in zip(scene.road.lanes.values(), expected.road.lanes.values(), strict=True):
        same(named(lane, names), one)
    for name, kind in (("lines", "line"), ("edges", "edge"), ("polygons", "polygon")):
        for found, one in zip(getattr(scene.road, name), getattr(expected.road, name), strict=True):
            same(replace(found, id=names[kind, found.id]), one)
    [sign] = scene.road.stop_signs
    lanes = tuple(names["lane", one] for one in sign.lane_ids)
    [stop] = expected.road.stop_signs
    same(replace(sign, id=names["stop_sign", sign.id], lane_ids=lanes), stop)


def named(lane, names):
    def of(ids):
        return tuple(names["lane", one] for one in ids)

    return replace(
        lane,
        id=names["lane", lane.id],
        next=of(lane.next),
        previous=of(lane.previous),
        left=tuple(replace(one, lane_id=names["lane", one.lane_id]) for one in lane.left),
        left_boundaries=tuple(
            replace(one, feature_id=names["line", one.feature_id]) for one in lane.left_boundaries
        ),
    )


def test_ids_that_are_numbers_stay_and_others_get_free_ones():
    ids = [("lane", "7"), ("lane", "a"), ("lane", "1"), ("line", "7"), ("line", "007"),
           ("line", "99999999999"), ("line", "²")]  # fmt: skip
    found = Numbers(ids)
    assert found.of == {
        ("lane", "7"): 7, ("lane", "1"): 1, ("lane", "a"): 2, ("line", "7"): 3,
        ("line", "007"): 4, ("line", "99999999999"): 5, ("line", "²"): 6,
    }  # fmt: skip
    assert found.known("lane", ["a", "gone"]) == [2]


def test_types_and_the_av_are_those_of_the_format(tmp_path):
    rollout = collision()
    kinds = ("vehicle", "cyclist", "pedestrian", "other")
    rollout = replace(rollout, tracks=replace(rollout.tracks, kinds=kinds))
    womd.write(Exportable.of(rollout, case_of()), tmp_path / "womd", womd.Settings())
    [payload] = tfrecords((tmp_path / "womd" / "run.tfrecord").read_bytes())
    message = wire(payload)
    assert [wire(one)[2] for one in message[2]] == [[1], [3], [2], [4]]
    assert message[6] == [0]  # sdc_track_index
    assert message[10] == [10]  # current_time_index
    assert {len(wire(one)[3]) for one in message[2]} == {91}
