"""Reference drivers against cases worked by hand."""

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st

from deepmf_sumo.judge.avoidability import reference_drivers
from deepmf_sumo.judge.avoidability.av_path import AvPath, VehicleState
from deepmf_sumo.judge.avoidability.grading import (
    AvAhead,
    OpponentFutures,
    TakeOver,
    avoidable,
)
from deepmf_sumo.judge.avoidability.reference_drivers import Approach, drive

CAR = np.array([4.8, 2.0])
DT = 0.1
STEPS = 80


def leaders(gap_m, speed_mps, left_m=0.0, aside_mps=0.0, steps=STEPS, heading=0.0):
    """A car so far ahead of the AV's bumper, now and later; it moves aside until on the line."""
    seconds = np.arange(steps + 1) * DT
    x = gap_m + CAR[0] + speed_mps * seconds
    y = np.sign(left_m) * np.maximum(abs(left_m) - aside_mps * seconds, 0.0)
    now = VehicleState(np.array([x[0], y[0]]), heading, speed_mps)
    return now, np.stack([x, y], -1)[None, 1:], np.full((1, steps), heading)


NO_PATH = np.empty((0, 2))


def given(start, now, position, heading, path=NO_PATH):
    """The AV and the opponent's futures, both of the size of a car."""
    futures = OpponentFutures(now=now, size_m=CAR, position_m=position, heading_rad=heading)
    return AvAhead(now=start, size_m=CAR, path_m=path), futures, DT


def avoids(by, speed_mps, *where, path=NO_PATH):
    start = VehicleState(np.zeros(2), 0.0, speed_mps)
    return bool(avoidable(*given(start, *where, path), by)[0])


def stopping_way(closing_mps):
    """Way on which the competent and careful driver loses a closing speed: fine integration."""
    fine, way, time = 1e-3, 0.0, 0.0
    while closing_mps > 0:
        way += closing_mps * fine
        ramp = 12.65 * (time - 0.75)
        closing_mps -= min(max(ramp, 0.4), 0.774 * 9.81) * fine
        time += fine
    return way


def test_a_standing_car_is_avoided_up_to_the_speed_whose_stopping_way_is_two_seconds():
    speeds = np.arange(13.0, 16.5, 0.25)
    limit = speeds[np.array([stopping_way(v) < 2 * v for v in speeds]).argmin()]
    assert 13.5 < limit < 16.0
    for speed, expected in [(limit - 0.5, True), (limit + 0.5, False)]:
        # 3 s ahead, a centimetre less: 2.0 s is reached at a step
        assert avoids("cc", speed, *leaders(3 * speed - 0.01, 0.0)) is expected


def test_the_other_drivers_see_a_standing_car_from_afar():
    for by in ("fsm", "rss"):
        assert avoids(by, 20.0, *leaders(100.0, 0.0))
    assert not avoids("cc", 20.0, *leaders(100.0, 0.0))


@pytest.mark.parametrize("closing", [6.0, 8.0, 10.0])
def test_cut_in_just_avoidable_and_just_not(closing):
    speed, aside = 20.0, 1.8
    # risk is perceived at the first step at which the car has come 1.095 m sideways
    perceived = np.ceil(1.095 / aside / DT) * DT
    needed = stopping_way(closing)
    assert needed < 2 * closing  # else the driver would wait for the 2 s
    for margin, expected in [(0.4, True), (-0.4, False)]:
        gap = needed + margin + closing * perceived
        cut_in = leaders(gap, speed - closing, left_m=3.5, aside_mps=aside)
        assert avoids("cc", speed, *cut_in) is expected


def test_a_car_beside_that_stays_in_its_lane_bothers_nobody():
    now, position, heading = leaders(5.0, 5.0, left_m=3.5)
    for by in reference_drivers.MODELS:
        assert avoids(by, 20.0, now, position, heading)


def test_an_oncoming_car_on_the_av_path_cannot_be_braked_away():
    oncoming = leaders(80.0, -15.0, heading=np.pi)
    assert not avoids("any", 15.0, *oncoming)


def test_a_crossing_car_is_let_through():
    seconds = np.arange(1, STEPS + 1) * DT
    x, speed = 40.0, 10.0
    position = np.stack([np.full(STEPS, x), -40.0 + speed * seconds], -1)[None]
    now = VehicleState(np.array([x, -40.0]), np.pi / 2, speed)
    crossing = now, position, np.full((1, STEPS), np.pi / 2)
    assert avoids("all", 10.0, *crossing)
    unaware = np.abs(10.0 * seconds - x) + np.abs(position[0, :, 1])
    assert unaware.min() < 1.0  # without braking they meet


def test_nobody_brakes_for_what_comes_from_behind():
    now, position, heading = leaders(-30.0, 20.0)
    assert not avoids("any", 10.0, now, position, heading)
    path = AvPath.through(np.zeros((1, 2)), np.zeros(1), np.empty((0, 2)))
    approach = Approach.of(path, position, heading, CAR, CAR, DT)
    unchanged = 10.0 * DT * np.arange(STEPS)
    driven = drive(list(reference_drivers.MODELS.values()), approach, unchanged)
    until = int(np.flatnonzero(position[0, :, 0] > unchanged - 4.8)[0])
    np.testing.assert_array_equal(driven[:, 0, :until], np.tile(unchanged[:until], (3, 1)))


def test_the_fuzzy_driver_drops_back_from_a_leader_as_fast_as_itself():
    """At 20 m/s: 15 + 50 - 400/14 + 2 m are safe, 2 m more are kept; at 10 m it brakes."""
    path = AvPath.through(np.zeros((1, 2)), np.zeros(1), np.empty((0, 2)))
    unchanged = 20.0 * DT * np.arange(STEPS)
    lag = []
    for gap in (10.0, 42.0):
        approach = Approach.of(path, *leaders(gap, 20.0)[1:], CAR, CAR, DT)
        lag.append(
            unchanged[-1] - drive([reference_drivers.MODELS["fsm"]], approach, unchanged)[0, 0, -1]
        )
    assert lag[0] > 5.0
    assert lag[1] == 0.0


def test_the_fuzzy_driver_brakes_no_faster_than_a_foot_can():
    """12.65 m/s3: it takes half a second to 6 m/s2."""
    path = AvPath.through(np.zeros((1, 2)), np.zeros(1), np.empty((0, 2)))
    approach = Approach.of(path, *leaders(25.0, 8.0)[1:], CAR, CAR, DT)
    unchanged = 20.0 * DT * np.arange(STEPS)
    along = drive([reference_drivers.MODELS["fsm"]], approach, unchanged)[0, 0]
    braking = -np.diff(along, 2) / DT**2
    assert braking.max() > 5.0
    assert np.abs(np.diff(braking[: int(braking.argmax()) + 1])).max() < 12.7 * DT


def test_who_enters_the_corridor_when():
    """Cars of 4.8 x 2 m at the path's left, 4 m from its line, 2 m/s towards it."""
    path = AvPath.through(np.zeros((1, 2)), np.zeros(1), np.empty((0, 2)))
    aside = 4.0 - 2.0 * DT * np.arange(4)
    along = np.stack([np.full(4, 30.0), aside], -1)[None]
    lane_change = Approach.of(path, along, np.full((1, 4), -0.0), CAR, CAR, DT)
    crossing = Approach.of(path, along, np.full((1, 4), -np.pi / 2), CAR, CAR, DT)
    left = Approach.of(path, along[:, ::-1], np.full((1, 4), 0.0), CAR, CAR, DT)
    # half widths 1 + 1 m, of the crossing car half its length: 2.4 + 1 m
    np.testing.assert_allclose(lane_change.clearance_m[0], aside - 2.0)
    np.testing.assert_allclose(crossing.clearance_m[0], aside - 3.4)
    np.testing.assert_allclose(lane_change.enters_s[0], (aside - 2.0) / 2)
    np.testing.assert_allclose(crossing.enters_s[0], np.maximum(aside - 3.4, 0) / 2, atol=1e-12)
    np.testing.assert_allclose(crossing.leaves_s[0], (aside + 3.4) / 2)
    assert np.isinf(lane_change.leaves_s).all()
    assert np.isinf(left.enters_s).all()
    np.testing.assert_allclose(lane_change.aside_mps, 2.0)
    np.testing.assert_allclose(lane_change.sideways_m[0], 4.0 - aside, atol=1e-12)
    np.testing.assert_allclose(crossing.rear_m, 29.0)


@settings(max_examples=12, deadline=None)
@drawn(
    by=st.sampled_from(["cc", "fsm", "rss"]),
    speed=st.floats(4.0, 25.0),
    closing=st.floats(2.0, 12.0),
    steps=st.integers(1, 35),
)
def test_more_gap_is_never_worse(by, speed, closing, steps):
    """Gaps of whole steps of closing, so that risk is looked for at the same distances."""
    closing = min(closing, speed)
    gaps = closing * DT * np.arange(steps, steps + 30, 6)
    found = [avoids(by, speed, *leaders(gap, speed - closing)) for gap in gaps]
    assert found == sorted(found)


@settings(max_examples=8, deadline=None)
@drawn(angle=st.floats(-3.1, 3.1), shift=st.floats(-500, 500), gap=st.floats(2.0, 25.0))
def test_the_frame_does_not_matter(angle, shift, gap):
    now, position, heading = leaders(gap, 8.0, left_m=3.5, aside_mps=1.2)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    start = VehicleState(np.full(2, shift), angle, 15.0)
    moved = VehicleState(now.position_m @ turn + shift, now.heading_rad + angle, now.speed_mps)
    there = avoidable(*given(start, moved, position @ turn + shift, heading + angle))
    assert there[0] == avoids("any", 15.0, now, position, heading)


def test_many_futures_at_once_are_the_same_as_one_by_one():
    rng = np.random.default_rng(0)
    now, _, _ = leaders(15.0, 8.0, left_m=3.5)
    seconds = np.arange(1, STEPS + 1) * DT
    x = now.position_m[0] + rng.uniform(0, 12, (8, 1)) * seconds
    y = 3.5 - np.minimum(rng.uniform(0, 3, (8, 1)) * seconds, 3.5)
    position, heading = np.stack([x, y], -1), np.zeros((8, STEPS))
    start = VehicleState(np.zeros(2), 0.0, 14.0)
    for by in ("any", "all", "rss"):
        together = avoidable(*given(start, now, position, heading), by)
        alone = [
            avoids(by, 14.0, now, position[row : row + 1], heading[row : row + 1])
            for row in range(8)
        ]
        assert together.tolist() == alone
    assert 0 < together.sum() < 8


def step_by_step(model, approach, av_along_m, start):
    """(N, K) as `drive`, by the words of its description: each motion and step by itself."""
    speeds = np.maximum(np.gradient(av_along_m, DT), 0.0)
    along = np.tile(av_along_m, (len(start), 1))
    for row, begin in enumerate(start):
        one, aware, since = approach.among(np.array([row])), False, 0.0
        speed, braking = speeds[:1], np.zeros(1)
        for step in range(approach.steps - 1):
            seen = one.seen(step, along[row, step : step + 1], speed, braking)
            since = since + DT if aware else 0.0
            risk, wanted = model.respond(seen, np.full(1, since))
            aware = aware or bool(risk[0] and step >= begin)
            if aware:
                braking = wanted
                slower = np.clip(speed - braking * DT, 0.0, speeds[step + 1])
                along[row, step + 1] = along[row, step] + (speed[0] + slower[0]) / 2 * DT
                speed = slower
            else:
                along[row, step + 1] = along[row, step] + av_along_m[step + 1] - av_along_m[step]
                speed = speeds[step + 1 : step + 2]
    return along


def test_drivers_drive_as_described_step_by_step():
    rng = np.random.default_rng(2)
    seconds = np.arange(STEPS) * DT
    x = 18.0 + rng.uniform(-4, 14, (12, 1)) * seconds
    y = rng.choice([-1, 1], (12, 1)) * np.abs(4.0 - rng.uniform(0, 4, (12, 1)) * seconds)
    path = AvPath.through(np.zeros((1, 2)), np.zeros(1), np.empty((0, 2)))
    approach = Approach.of(path, np.stack([x, y], -1), np.zeros((12, STEPS)), CAR, CAR, DT)
    driven, start = 13.0 * seconds + 0.1 * seconds**2, rng.integers(0, 30, 12)
    found = drive(list(reference_drivers.MODELS.values()), approach, driven, start)
    for one, model in zip(found, reference_drivers.MODELS.values(), strict=True):
        expected = step_by_step(model, approach, driven, start)
        np.testing.assert_allclose(one, expected, atol=1e-9)
        braked = np.abs(expected - driven).max(axis=1) > 0.1
        assert braked.any()
    assert not (np.abs(found - driven).max(axis=-1) > 0.1).all()


def test_any_and_all_are_what_each_driver_says():
    """Also where each driver takes over at another time: futures that leave what was expected."""
    rng = np.random.default_rng(1)
    now, _, _ = leaders(12.0, 8.0, left_m=3.5)
    seconds = np.arange(1, STEPS + 1) * DT
    x = now.position_m[0] + rng.uniform(0, 12, (40, 1)) * seconds
    y = 3.5 - np.minimum(rng.uniform(0, 4, (40, 1)) * seconds, 3.5)
    futures = np.stack([x, y], -1), np.zeros((40, STEPS))
    expected = np.stack([now.position_m[0] + 8.0 * np.arange(81) * DT, np.full(81, 3.5)], -1)
    start = VehicleState(np.zeros(2), 0.0, 14.0)

    def by(who):
        return avoidable(*given(start, now, *futures), who, TakeOver(expected_m=expected))

    each = np.stack([by(name) for name in reference_drivers.MODELS])
    np.testing.assert_array_equal(by("any"), each.any(axis=0))
    np.testing.assert_array_equal(by("all"), each.all(axis=0))
    assert each.all(axis=0).any()
    assert (each.any(axis=0) & ~each.all(axis=0)).any()
    assert not each.any(axis=0).all()


def test_the_path_ahead_is_followed():
    """A car that stands on the straight is of no concern to an AV that turns off before it."""
    bend = np.linspace(0, np.pi / 2, 40)
    turning = np.stack([15 * np.sin(bend), 15 * (1 - np.cos(bend))], -1)
    standing = leaders(25.0, 0.0)
    assert avoids("cc", 8.0, *standing, path=turning)
    assert avoids("all", 8.0, *standing, path=turning)
    assert not avoids("cc", 20.0, *standing)


def test_proactive_safety_by_hand():
    # 20 m/s behind 10 m/s: safe 15 + 50 - 100/14 + 2, unsafe 15 + 400/12 - 100/14, of gap - 2
    safe, unsafe = 67 - 100 / 14, 15 + 400 / 12 - 100 / 14
    gaps = np.array([safe, unsafe, (safe + unsafe) / 2, 200.0, 0.0]) + 2
    values = reference_drivers.proactive_safety(gaps, np.full(5, 20.0), np.full(5, 10.0))
    np.testing.assert_allclose(values, [0, 1, 0.5, 0, 1], atol=1e-12)


def test_critical_safety_by_hand():
    def at(gap, speed, leader, accel=0.0):
        return float(
            reference_drivers.critical_safety(
                np.array([gap]), np.array([speed]), np.array([leader]), np.array([accel])
            )[0]
        )

    assert at(7.5 + 100 / 8, 20, 10) == pytest.approx(0.0)
    assert at(7.5 + 100 / 12, 20, 10) == pytest.approx(1.0)
    assert at(7.5 + 100 * 5 / 48, 20, 10) == pytest.approx(0.5)
    # braking with 4 during the reaction: 7 m/s are left after 6.375 m; harder braking counts as 4
    assert at(6.375 + 49 / 8, 20, 10, -4.0) == pytest.approx(0.0)
    assert at(6.375 + 49 / 12, 20, 10, -6.0) == pytest.approx(1.0)
    assert at(1.0, 10, 12) == 0.0
    # slower than the leader before the reaction time is over: 2 m/s are lost on half a metre
    assert at(0.49, 12, 10, -4.0) == 1.0
    assert at(0.51, 12, 10, -4.0) == 0.0


def test_rss_distances_by_hand():
    def safe(speed, leader):
        return float(reference_drivers.safe_distance(np.array([speed]), np.array([leader]))[0])

    own = 20 * 0.75 + 0.5 * 3 * 0.75**2 + 22.25**2 / 12
    assert safe(20.0, 20.0) == pytest.approx(own - 400 / 14)
    assert safe(20.0, -20.0) == pytest.approx(2 * own)
    assert safe(5.0, 30.0) == 0.0
    # steady beside each other: both may gain 0.75 m/s in 0.75 s and lose it at 1 m/s2
    beside = reference_drivers.lateral_distance(np.array([0.0, 1.0, -5.0]))
    each = 0.5 * 0.75**2 + 0.75**2 / 2
    towards = 0.75 + 0.5 * 0.75**2 + 1.75**2 / 2
    np.testing.assert_allclose(beside, [0.3 + 2 * each, 0.3 + each + towards, 0.3])
