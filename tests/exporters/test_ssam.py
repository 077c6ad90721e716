"""Trajectories for SSAM, read back by the file format's description."""

import json
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.errors import PluginError
from deepmf_sumo.exporters import ssam
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.results.exports import Format

from tests.support.foreign_readers import (
    boxes_of,
    first_contact,
    largest_error_m,
    read_trj,
    ssam_boxes,
)
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

NOW = 10


def collision(steps=61, offset=(0.0, 0.0)):
    """The AV drives into a vehicle that crosses; the two touch at the last step.

    A third vehicle appears at step 20, and a fourth leaves at step 30.
    """
    paths = {
        "av": straight(0, 0, 10, steps=steps),
        "b": straight(30.0, -22.0, 6.0, steps=steps, heading=1.5, accel=1.0),
        'late, "c"': straight(-60, 3.5, 8, steps=steps),
        "leaves": straight(80, 3.5, 8, steps=steps),
    }
    rollout = rollout_of(paths)
    tracks = rollout.tracks
    valid = tracks.valid.copy()
    valid[2, :20], valid[3, 30:] = False, False
    tracks = replace(
        tracks,
        position_m=(tracks.position_m + np.array(offset)) * valid[..., None],
        heading_rad=tracks.heading_rad * valid,
        velocity_mps=tracks.velocity_mps * valid[..., None],
        size_m=np.array([[4.8, 2.0, 1.5], [12.0, 2.5, 3.2], [4.3, 1.8, 1.4], [5.0, 1.9, 1.5]]),
        valid=valid,
    )
    step = first_contact(boxes_of(tracks), "av", "b")
    cut = tracks.window(0, step + 1)
    contact = contact_of(step=step)
    return replace(rollout, tracks=cut, driver=rollout.driver[:, : step + 1], contacts=(contact,))


def written(rollout, folder, **settings):
    ssam.write(Exportable.of(rollout, case_of()), folder / "ssam", ssam.Settings(**settings))
    return folder / "ssam"


@pytest.mark.parametrize("version", ["1.04", "3.0"])
def test_boxes_and_contact_are_those_of_the_run(version, tmp_path):
    rollout = collision()
    folder = written(rollout, tmp_path, version=version)
    found, expected = ssam_boxes(folder), boxes_of(rollout.tracks)
    assert largest_error_m(found, expected) < 1e-4
    assert first_contact(found, "av", "b") == rollout.contacts[0].step > 20
    header, steps = read_trj((folder / "run.trj").read_bytes())
    assert (header["version"], header["units"], header["scale"]) == (float(version), 1, 1.0)
    assert [round(time, 3) for time, _ in steps] == [round(0.1 * n, 3) for n in range(len(steps))]


def test_sizes_are_each_vehicle_s_own_and_heights_are_in_3_0_alone(tmp_path):
    rollout = collision()
    tracks = replace(rollout.tracks, z_m=np.where(rollout.tracks.valid, 5.5, 0.0))
    rollout = replace(rollout, tracks=tracks)
    for version, z in (("1.04", None), ("3.0", (5.5, 5.5))):
        folder = written(rollout, tmp_path, version=version)
        _, steps = read_trj((folder / "run.trj").read_bytes())
        seen = {one.number: (round(one.length, 3), round(one.width, 3), one.z)
                for _, vehicles in steps for one in vehicles}  # fmt: skip
        assert seen == {
            1: (4.8, 2.0, z), 2: (12.0, 2.5, z), 3: (4.3, 1.8, z), 4: (5.0, 1.9, z),
        }  # fmt: skip


def test_acceleration_is_the_difference_of_speeds(tmp_path):
    rollout = collision()
    folder = written(rollout, tmp_path)
    _, steps = read_trj((folder / "run.trj").read_bytes())
    speeds = {}
    for step, (_, vehicles) in enumerate(steps[: rollout.tracks.steps]):
        for one in vehicles:
            speeds[one.number, step] = one.speed, one.acceleration
    later = [(key, one) for key, one in speeds.items() if (key[0], key[1] - 1) in speeds]
    assert len(later) > 80
    for (number, step), (speed, acceleration) in later:
        assert acceleration == pytest.approx((speed - speeds[number, step - 1][0]) / 0.1, abs=1e-3)
    assert speeds[2, 20][1] == pytest.approx(1.0, abs=0.01)
    assert speeds[3, 20][1] == speeds[3, 21][1]  # its first step
    assert max(abs(acceleration) for _, acceleration in speeds.values()) < 1.1


def test_seconds_follow_the_contact_in_which_the_two_stand_and_then_part(tmp_path):
    rollout = collision()
    folder = written(rollout, tmp_path)
    _, steps = read_trj((folder / "run.trj").read_bytes())
    last = rollout.contacts[0].step
    assert len(steps) == last + 1 + 140
    assert json.loads((folder / "about.json").read_text())["made_up_steps"] == 140
    after = steps[last + 1 :]
    assert {tuple(one.number for one in vehicles) for _, vehicles in after} == {(1, 2)}
    av = np.array([vehicles[0].front for _, vehicles in after])
    other = np.array([vehicles[1].front for _, vehicles in after])
    assert np.ptp(av[:10], axis=0).max() == 0
    assert np.allclose(np.diff(av[10:, 0]), 0.3, atol=1e-3)
    assert [vehicles[0].speed for _, vehicles in after] == [0.0] * 10 + [3.0] * 130
    assert {vehicles[1].speed for _, vehicles in after} == {0.0}
    assert np.ptp(other, axis=0).max() == 0
    assert np.hypot(*(av[-1] - other[-1])) > 20
    assert all(one.acceleration == 0 for _, vehicles in after for one in vehicles)


def test_nothing_is_made_up_without_a_contact_or_long_after_it(tmp_path):
    rollout = collision()
    without = written(replace(rollout, contacts=()), tmp_path)
    assert json.loads((without / "about.json").read_text())["made_up_steps"] == 0
    assert len(read_trj((without / "run.trj").read_bytes())[1]) == rollout.tracks.steps
    earlier = replace(rollout, contacts=(replace(rollout.contacts[0], step=12),))
    folder = written(earlier, tmp_path, after_s=1.0)
    assert json.loads((folder / "about.json").read_text())["made_up_steps"] == 0
    others = replace(
        rollout, contacts=(replace(rollout.contacts[0], first_id="b", second_id="leaves"),)
    )
    folder = written(others, tmp_path)
    assert json.loads((folder / "about.json").read_text())["made_up_steps"] == 0


def test_far_coordinates_keep_their_millimetres(tmp_path):
    rollout = collision(offset=(678_912.25, 5_403_210.5))
    folder = written(rollout, tmp_path)
    header, _ = read_trj((folder / "run.trj").read_bytes())
    assert max(map(abs, header["area"])) < 2000
    assert json.loads((folder / "about.json").read_text())["origin_m"] == [678_000.0, 5_403_000.0]
    assert largest_error_m(ssam_boxes(folder), boxes_of(rollout.tracks)) < 1e-3


def test_all_vehicles_are_within_the_area(tmp_path):
    folder = written(collision(), tmp_path)
    header, steps = read_trj((folder / "run.trj").read_bytes())
    points = np.array([p for _, vs in steps for one in vs for p in (one.front, one.rear)])
    low, top = np.array(header["area"][:2]), np.array(header["area"][2:])
    assert (points >= low + 9).all()
    assert (points <= top - 9).all()


@pytest.mark.parametrize("values", [{"version": "2"}, {"after_s": "-1"}, {"after_s": "long"}])
def test_settings_that_are_wrong_are_refused(values):
    with pytest.raises(PluginError, match=r"exporters 'ssam': '(version|after_s)' is"):
        Format.named("ssam", values)
