"""Names and directions of drawn collisions."""

import dataclasses

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES, accident_type_of
from deepmf_sumo.scene.geometry import boxes

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight


def collision(av, other):
    """The two paths up to their first overlap, and the contact there."""
    size = np.array([4.8, 2.0])
    hit = boxes.overlap(av[:, :2], av[:, 2], size, other[:, :2], other[:, 2], size)
    step = int(np.flatnonzero(hit)[0])
    contact = dataclasses.replace(
        contact_of(step=step), pose_first=av[step], pose_second=other[step]
    )
    return rollout_of({"av": av[: step + 1], "b": other[: step + 1]}, contacts=[contact])


def sliding(path, begin, end, to_y):
    """The path, shifted sideways between two steps."""
    moved = path.copy()
    moved[:, 1] += np.interp(np.arange(len(path)), [begin, end], [0, to_y - path[0, 1]])
    return moved


AHEAD_SLOW = straight(20, 0, 4)
SITUATIONS = {
    "rear_end": [
        (straight(0, 0, 10), AHEAD_SLOW),
        (straight(0, 0, 4), straight(-20, 0.8, 10)),  # the opponent from behind
        (straight(0, 0, 0), straight(-20, 0, 10)),  # a standing AV
        # a lane change more than 3 s before
        (straight(0, 0, 10), sliding(straight(45, 3.5, 1), 11, 20, 0)),
    ],
    "cut_in": [
        (straight(0, 0, 10), sliding(straight(14, 3.5, 5), 11, 26, 0)),
        (sliding(straight(14, 3.5, 5), 11, 26, 0), straight(0, 0, 10)),  # the AV cuts in
    ],
    "t_bone": [
        (straight(-20, 0, 10), straight(0, -20, 10, heading=np.pi / 2)),
        (straight(-20, 0, 10), straight(0, 0, 0, heading=-np.pi / 2)),
        # into the side at 40 degrees: too steep for a sideswipe
        (straight(-2, 0, 10), straight(-3, -4, 13, heading=np.radians(40))),
    ],
    "head_on": [(straight(0, 0, 10), straight(60, 0.5, 8, heading=np.pi))],
    "sideswipe": [
        (straight(0, 0, 10), sliding(straight(1, 3.5, 10), 11, 30, 0)),
        (straight(0, 0, 10), sliding(straight(35, 3.5, 10, heading=np.pi), 24, 29, 1.0)),
    ],
}


@pytest.mark.parametrize(
    ("name", "paths"), [(name, paths) for name, every in SITUATIONS.items() for paths in every]
)
def test_names(name, paths):
    rollout = collision(*paths)
    assert accident_type_of(rollout) == name
    value = plugins.load("metrics", "accident_type").measure(rollout, case_of()).value
    assert ACCIDENT_TYPES[int(value)] == name


def test_a_leader_on_a_bend_did_not_cut_in():
    """Both on one circle of 30 m: 3 s ago the leader was beside the AV's present direction."""
    angle = (np.arange(91) - 10) * 0.1

    def on_circle(start_m, speed):
        turned = (start_m + speed * angle) / 30
        place = 30 * np.stack([np.sin(turned), 1 - np.cos(turned)], -1)
        return np.column_stack([place, turned])

    rollout = collision(on_circle(0, 10), on_circle(20, 5))
    assert accident_type_of(rollout) == "rear_end"


def test_no_collision_has_no_name():
    rollout = rollout_of({"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
    with pytest.raises(ValueError, match="did not collide"):
        accident_type_of(rollout)
    for name in ("accident_type", "pdof", "collision_speed_difference"):
        assert "did not collide" in plugins.load("metrics", name).measure(rollout, case_of()).reason


@pytest.mark.parametrize(
    ("av", "other", "expected"),
    [
        (straight(0, 0, 10), AHEAD_SLOW, 0.0),
        (straight(0, 0, 4), straight(-20, 0, 10), np.pi),
        # from the right at equal speeds: half from ahead, half from the right
        (straight(-20, 0, 10), straight(0, -20, 10, heading=np.pi / 2), -np.pi / 4),
        # the same, seen by an AV that drives north
        (straight(0, -20, 10, heading=np.pi / 2), straight(-20, 0, 10), np.pi / 4),
    ],
)
def test_principal_direction_of_force(av, other, expected):
    value = plugins.load("metrics", "pdof").measure(collision(av, other), case_of()).value
    assert np.cos(value - expected) == pytest.approx(1.0)


def test_speeds_at_the_contact():
    rollout = collision(straight(-20, 0, 10), straight(0, -20, 9, heading=np.pi / 2))
    metric = plugins.load("metrics", "collision_speed_difference")
    assert metric.measure(rollout, case_of()).value == pytest.approx(1.0)
    early = plugins.load("metrics", "collision_time_restricted_s")
    step = rollout.contacts[0].step
    assert early.measure(rollout, case_of()).value == pytest.approx((step - 10) * 0.1)
    missed = rollout_of({"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
    assert early.measure(missed, case_of()).value == pytest.approx(8.0)
