import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.deepmf.tracking import Start, joined, track
from deepmf_sumo.scene import DT_S
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import MotionLimits

from tests.support.predictor_doubles import STEPS, fan, view_of

DEFAULT = MotionLimits(accel=3.0, brake=4.0, lateral=3.0)


def start(speed=10.0, heading=0.0, course=None):
    return Start(
        position_m=np.array([5.0, -3.0]),
        heading_rad=heading,
        course_rad=heading if course is None else course,
        speed_mps=speed,
        length_m=4.8,
    )


def straight(begin, speed):
    along = speed * STEPS
    return begin.position_m + along[:, None] * frames.unit(begin.heading_rad)


def accelerations(tracked, begin):
    """(M, F) along, across the course, and (M, F) turn of the course per step."""
    position = np.concatenate(
        [np.tile(begin.position_m, (len(tracked.position_m), 1, 1)), tracked.position_m], axis=1
    )
    speed = np.concatenate(
        [np.full((len(position), 1), begin.speed_mps), tracked.speed_mps], axis=1
    )
    step = np.diff(position, axis=1)
    course = np.arctan2(step[..., 1], step[..., 0])
    turn = np.abs(frames.difference(course[:, 1:], course[:, :-1]))
    length = np.hypot(step[..., 0], step[..., 1])
    turn[(length[:, 1:] < 1e-6) | (length[:, :-1] < 1e-6)] = 0.0
    return np.diff(speed, axis=1) / DT_S, turn, length


@settings(max_examples=40, deadline=None)
@given(
    speed=st.floats(0.0, 35.0),
    heading=st.floats(-3.1, 3.1),
    slip=st.floats(-0.2, 0.2),
    seed=st.integers(0, 2**32 - 1),
    limits=st.tuples(st.floats(1.0, 8.0), st.floats(1.0, 8.0), st.floats(1.0, 5.0)),
)
def test_limits_hold_whatever_the_reference(speed, heading, slip, seed, limits):
    rng = np.random.default_rng(seed)
    wild = rng.normal(scale=rng.uniform(0, 3), size=(6, 80, 2)).cumsum(1)
    begin = start(speed, heading, heading + slip)
    bounds = MotionLimits(accel=limits[0], brake=limits[1], lateral=limits[2])
    tracked = track(begin.position_m + wild, begin, bounds.rows(6))
    along, turn, length = accelerations(tracked, begin)
    assert np.isfinite(tracked.position_m).all()
    assert along.max() <= limits[0] + 1e-6
    assert along.min() >= -limits[1] - 1e-6
    assert tracked.speed_mps.min() >= 0
    # Course between two steps is the mean of their turns; each keeps v * turn rate <= lateral.
    mean = (length[:, 1:] + length[:, :-1]) / 2 / DT_S
    assert (mean * turn / DT_S).max() <= limits[2] * 1.02 + 1e-6
    # Steering: no circle of the centre is tighter than at full lock (4.4 m for this length).
    assert (turn - 0.225 * (length[:, 1:] + length[:, :-1]) / 2).max() < 1e-3


@settings(max_examples=30, deadline=None)
@given(speed=st.floats(0.0, 30.0), offset=st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_joins_the_current_state_without_a_jump(speed, offset):
    begin = start(speed)
    tracked = track(straight(begin, speed)[None] + offset, begin, DEFAULT.rows(1))
    first = tracked.position_m[0, 0] - begin.position_m - [speed * DT_S, 0.0]
    assert np.hypot(*first) <= 5.0 * DT_S**2 / 2 + 1e-9
    assert abs(tracked.heading_rad[0, 0] - begin.heading_rad) < 0.05


@pytest.mark.parametrize("speed", [0.0, 3.0, 15.0, 33.0])
def test_a_drivable_reference_is_reproduced(speed):
    begin = start(speed, heading=0.4)
    tracked = track(straight(begin, speed)[None], begin, DEFAULT.rows(1))
    assert tracked.bent_m[0] < 1e-6
    np.testing.assert_allclose(tracked.speed_mps, speed, atol=1e-6)
    np.testing.assert_allclose(tracked.heading_rad, 0.4, atol=1e-6)


def test_curves_within_the_limits_are_followed_and_wild_ones_bent():
    view = view_of({"av": (0, 0, 0, 1.0), "b": (20, 0, 1.0, 8.0)})
    begin = Start.of(view, "b")
    position, heading, _ = fan(view, "b", 56)
    tracked = track(position, begin, DEFAULT.rows(len(position)))
    steps = np.diff(position, axis=1)
    speed = np.hypot(steps[..., 0], steps[..., 1]) / DT_S
    turn = np.abs(frames.difference(heading[:, 1:], heading[:, :-1])) / DT_S
    easy = (turn * speed).max(1) < 2.2
    assert 20 < easy.sum() < len(easy)
    assert tracked.bent_m[easy].max() < 0.6
    off = np.abs(frames.difference(tracked.heading_rad, heading))[easy]
    assert np.median(off) < 0.03
    hard = (turn * speed).max(1) > 6.0
    assert (tracked.bent_m[hard] > 2.0).all()


def test_brakes_for_a_reference_that_stops_and_then_stands_still():
    begin = start(10.0)
    along = np.minimum(10 * STEPS - STEPS**2, 25.0)
    along[STEPS > 5] = 25.0
    reference = begin.position_m + along[:, None] * [1.0, 0.0]
    tracked = track(reference[None], begin, DEFAULT.rows(1))
    assert tracked.bent_m[0] < 0.3
    assert tracked.speed_mps[0, -10:].max() < 0.02
    assert np.ptp(tracked.heading_rad[0]) < 0.01


def test_slows_down_ahead_of_a_sharp_turn():
    begin = start(14.0)
    corner = begin.position_m + np.array([60.0, 0.0])
    along = 14 * STEPS
    reference = np.where(
        along[:, None] < 60,
        begin.position_m + along[:, None] * [1.0, 0.0],
        corner + np.maximum(along - 60, 0)[:, None] * [0.0, 1.0],
    )
    tracked = track(reference[None], begin, DEFAULT.rows(1))
    turning = np.abs(tracked.position_m[0] - corner).max(1) < 4
    assert turning.any()
    assert tracked.speed_mps[0, turning].max() < 6.0
    off = np.minimum(
        np.abs(tracked.position_m[0, :, 1] - corner[1]),
        np.abs(tracked.position_m[0, :, 0] - corner[0]),
    )
    assert off.max() < 3.0


def test_each_candidate_has_its_own_limits():
    begin = start(5.0)
    reference = np.repeat(straight(begin, 25.0)[None], 2, axis=0)
    limits = np.array([[1.0, 4.0, 3.0], [3.0, 4.0, 3.0]])
    tracked = track(reference, begin, limits)
    assert tracked.speed_mps[0, 19] == pytest.approx(7.0, abs=1e-6)
    assert tracked.speed_mps[1, 19] == pytest.approx(11.0, abs=1e-6)


def test_candidates_do_not_influence_one_another():
    view = view_of({"av": (0, 0, 0, 1.0), "b": (20, 0, 1.0, 8.0)})
    begin = Start.of(view, "b")
    position, _, _ = fan(view, "b", 20)
    together = track(position, begin, DEFAULT.rows(20))
    alone = track(position[7:8], begin, DEFAULT.rows(1))
    np.testing.assert_allclose(alone.position_m[0], together.position_m[7], atol=1e-9)


def test_start_of_a_vehicle():
    view = view_of({"av": (0, 0, 0, 1.0), "b": (20, 1.0, 1.0, 8.0), "c": (0, 9, 0, -2.0)})
    begin = Start.of(view, "b")
    assert (begin.speed_mps, begin.heading_rad, begin.length_m) == (pytest.approx(8.0), 1.0, 4.8)
    assert begin.course_rad == pytest.approx(1.0)
    assert Start.of(view, "c").speed_mps == 0.0


def test_join_fades_out():
    begin = start(10.0)
    moved = joined(straight(begin, 10.0)[None] + [0.0, 2.0], begin)[0]
    np.testing.assert_allclose(moved[0], begin.position_m + np.array([1.0, 0.0]))
    np.testing.assert_allclose(moved[15:, 1], begin.position_m[1] + 2.0)


def test_mild_limits_are_calm_and_never_above_the_full_ones():
    assert MotionLimits(accel=8, brake=8, lateral=5).mild() == MotionLimits(
        accel=3.0, brake=4.0, lateral=2.5
    )
    mild = DEFAULT.mild()
    assert (mild.accel, mild.brake, mild.lateral) == pytest.approx((2.1, 2.8, 2.1))
