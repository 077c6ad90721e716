"""Heights of boxes: below them in our tracks, of their middles in most formats."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.exporters import fcd, osi, scenarionet, womd

from tests.exporters.test_ssam import collision
from tests.scene.readers.test_common_exam import in_scenarionet, in_womd
from tests.support import recordings_by_hand as by_hand

MIDDLE_M = 8.0


def recorded():
    message = by_hand.scenario()
    for state in message.tracks[0].states:
        state.center_z = MIDDLE_M
    return message


@pytest.mark.parametrize("read", [in_womd, in_scenarionet])
def test_a_recording_is_written_with_the_middles_that_it_came_with(read, tmp_path):
    """The independent reader is protobuf for the one, and pickle for the other."""
    scene = read(recorded(), tmp_path)
    tracks = womd._tracks(scene, lambda _, name: int(name))
    (track,) = (one for one in tracks if one.id == 7)
    assert {state.center_z for state in track.states if state.valid} == {MIDDLE_M}
    found = scenarionet.described(scene)["tracks"]["7"]["state"]["position"]
    assert set(found[:, 2].tolist()) == {MIDDLE_M}


def test_osi_of_a_recording_has_the_middle_and_sumo_the_ground(tmp_path):
    scene = in_womd(recorded(), tmp_path)
    row = scene.tracks.row("7")
    height = float(scene.tracks.size_m[row, 2])
    user = _user(scene.tracks, row)
    assert user.base.position.z == pytest.approx(MIDDLE_M)
    rollout = replace(collision(), tracks=scene.tracks, av_id=scene.av_id)
    line = fcd._fcd(rollout, scene.tracks.valid, ()).split('id="7"')[1].splitlines()[0]
    assert f'z="{MIDDLE_M - height / 2:.2f}"' in line


def _user(tracks, row):
    message = pytest.importorskip("osi3.osi_groundtruth_pb2").GroundTruth()
    user = message.moving_object.add()
    osi._fill(user, tracks, (row, 10), np.zeros(2), float(tracks.size_m[row, 2]))
    return user
