"""Limits of what is planned for pedestrians and cyclists, whatever is asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.scene import DT_S
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS

from tests.support.people_views import people_view
from tests.support.predictor_doubles import STEPS

WALKS = ROAD_USERS["pedestrian"].motion
RIDES = ROAD_USERS["bicycle"].motion
LENGTHS = {"pedestrian": 0.6, "cyclist": 1.8}


def begin(kind, speed, heading=0.0):
    view = people_view({"av": ("vehicle", 0, 0, 0, 0.0), "p": (kind, 5, -3, heading, speed)})
    return Start.of(view, "p")


def driven(start, tracked):
    """(M, F + 1) positions with the start, and (M, F + 1) speeds."""
    count = len(tracked.position_m)
    here = np.tile(start.position_m, (count, 1, 1))
    speed = np.column_stack([np.full(count, start.speed_mps), tracked.speed_mps])
    return np.concatenate([here, tracked.position_m], axis=1), speed


@settings(max_examples=60, deadline=None)
@given(
    kind=st.sampled_from(["pedestrian", "cyclist"]),
    speed=st.floats(0.0, 12.0),
    heading=st.floats(-3.1, 3.1),
    seed=st.integers(0, 2**32 - 1),
)
def test_limits_hold_whatever_the_reference(kind, speed, heading, seed):
    rng = np.random.default_rng(seed)
    wild = rng.normal(scale=rng.uniform(0, 2), size=(6, 80, 2)).cumsum(1)
    start, motion = begin(kind, speed, heading), WALKS if kind == "pedestrian" else RIDES
    limits = motion.planned
    tracked = track(start.position_m + wild, start, limits.rows(6))
    position, fast = driven(start, tracked)
    change = np.diff(fast, axis=1) / DT_S
    assert np.isfinite(tracked.position_m).all()
    assert change.max() <= limits.accel + 1e-6
    assert change.min() >= -limits.brake - 1e-6
    assert fast.min() >= 0.0
    assert fast.max() <= max(motion.fastest_mps, start.speed_mps) + 1e-9
    # No pose is farther from the one before than its speeds explain, so the first is reachable.
    moved = np.hypot(*np.moveaxis(np.diff(position, axis=1), -1, 0))
    assert (moved <= (fast[:, 1:] + fast[:, :-1]) / 2 * DT_S + 1e-9).all()
    # v times turn of the course per second, as seen from outside: from positions.
    step = np.diff(position, axis=1)
    course = np.arctan2(step[..., 1], step[..., 0])
    turn = np.abs(frames.difference(course[:, 1:], course[:, :-1]))
    if kind == "pedestrian":
        turn[fast[:, 1:-1] <= 0.05] = 0.0  # at rest it turns freely
    turn[np.minimum(moved[:, 1:], moved[:, :-1]) < 1e-6] = 0.0
    sideways = (moved[:, 1:] + moved[:, :-1]) / 2 / DT_S * turn / DT_S
    assert sideways.max() <= limits.lateral * 1.02 + 1e-6


@pytest.mark.parametrize("side", np.linspace(-np.pi, np.pi, 9))
def test_a_pedestrian_at_rest_starts_towards_any_side(side):
    start = begin("pedestrian", 0.0)
    along = np.where(STEPS < 1, 0.7 * STEPS**2, 0.7 + 1.4 * (STEPS - 1))
    reference = start.position_m + along[:, None] * frames.unit(side)
    tracked = track(reference[None], start, WALKS.planned.rows(1))
    assert tracked.bent_m[0] < 0.1
    gone = tracked.position_m[0, -1] - start.position_m
    np.testing.assert_allclose(gone / np.hypot(*gone), frames.unit(side), atol=1e-2)
    faced = np.append(start.heading_rad, tracked.heading_rad[0])
    turned = np.abs(frames.difference(faced[1:], faced[:-1]))
    assert turned.max() <= 0.5 + 1e-9
    walks = tracked.speed_mps[0] > 1.0
    off = np.abs(frames.difference(tracked.heading_rad[0, walks], side))
    assert off.max() < 0.02  # faces the way that it goes


def test_a_pedestrian_who_stays_keeps_its_heading():
    start = begin("pedestrian", 0.0, heading=1.2)
    tracked = track(np.tile(start.position_m, (1, 80, 1)), start, WALKS.planned.rows(1))
    np.testing.assert_array_equal(tracked.position_m[0], np.tile(start.position_m, (80, 1)))
    np.testing.assert_allclose(tracked.heading_rad, 1.2)


def test_a_pedestrian_gets_as_far_as_it_can_run_and_no_farther():
    """1.6 m/s2 up to 3.5 m/s takes 2.1875 s and 3.828 m; then 3.5 m/s: 24.17 m in 8 s."""
    start = begin("pedestrian", 0.0)
    far = start.position_m + np.stack([50.0 * STEPS, np.zeros(80)], -1)
    tracked = track(far[None], start, WALKS.planned.rows(1))
    gone = tracked.position_m[0, -1, 0] - start.position_m[0]
    assert gone == pytest.approx(3.5**2 / 3.2 + 3.5 * (8 - 3.5 / 1.6), abs=0.02)


def test_a_pedestrian_turns_back_by_stopping():
    start = begin("pedestrian", 1.4)
    back = start.position_m - np.stack([1.4 * STEPS, np.zeros(80)], -1)
    tracked = track(back[None], start, WALKS.planned.rows(1))
    x = tracked.position_m[0, :, 0] - start.position_m[0]
    # 1.4 m/s with 2 m/s2 takes 0.49 m to stop.
    assert 0.3 < x.max() < 0.7
    assert x[-1] < -9.0
    assert np.abs(tracked.position_m[0, :, 1] - start.position_m[1]).max() < 0.4


def test_a_faster_cyclist_is_not_slowed_down_at_once_and_gets_no_faster():
    start = begin("cyclist", 11.0)
    ahead = start.position_m + np.stack([15.0 * STEPS, np.zeros(80)], -1)
    tracked = track(ahead[None], start, RIDES.planned.rows(1))
    assert tracked.speed_mps.max() == pytest.approx(11.0)


@pytest.mark.parametrize(("radius", "follows"), [(2.0, True), (0.6, False)])
def test_a_cyclist_turns_as_narrowly_as_its_handlebar_allows(radius, follows):
    """The narrowest circle has the radius 0.3 * 1.8 m / sin(0.45) = 1.24 m; a car's has 4.4 m."""
    start = begin("cyclist", 1.2)
    turned = np.minimum(1.2 * STEPS / radius, np.pi)
    after = np.maximum(1.2 * STEPS - np.pi * radius, 0.0)
    way = np.stack([radius * np.sin(turned) - after, radius * (1 - np.cos(turned))], -1)
    tracked = track((start.position_m + way)[None], start, RIDES.planned.rows(1))
    assert (tracked.bent_m[0] < 0.7) == follows
    position, _ = driven(start, tracked)
    step = np.diff(position[0], axis=0)
    course = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs(frames.difference(course[1:], course[:-1]))
    bend = turn / np.hypot(*((step[1:] + step[:-1]) / 2).T)
    assert bend.max() <= 1 / 1.24 + 0.02


def test_the_twin_in_a_mirror_walks_the_mirrored_way():
    start = begin("pedestrian", 1.2)
    rng = np.random.default_rng(3)
    way = start.position_m + rng.normal(size=(5, 80, 2)).cumsum(1) * 0.2
    mirror = np.array([1.0, -1.0])
    one = track(way, start, WALKS.planned.rows(5))
    twin = Start(
        position_m=start.position_m * mirror,
        heading_rad=-start.heading_rad,
        course_rad=-start.course_rad,
        speed_mps=start.speed_mps,
        length_m=start.length_m,
        motion=start.motion,
    )
    other = track(way * mirror, twin, WALKS.planned.rows(5))
    np.testing.assert_allclose(other.position_m * mirror, one.position_m, atol=1e-9)
    np.testing.assert_allclose(other.speed_mps, one.speed_mps, atol=1e-9)


def test_noise_of_a_recorded_person_who_stands_is_no_walk():
    assert begin("pedestrian", 0.2).speed_mps == 0.0
    assert begin("pedestrian", 0.5).speed_mps == pytest.approx(0.5)
