"""Conflicts of AV and opponent: worked by hand, and against stepping."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics import conflict
from deepmf_sumo.judge.metrics.conflict import MovingBox, braking_to_stay_behind, time_to_collision
from deepmf_sumo.scene.geometry import boxes

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

SIZE = np.array([4.8, 2.0])


def measured(name, rollout):
    return plugins.load("metrics", name).measure(rollout, case_of())


def following(speed, leader_speed, gap, steps=31, **more):
    """The AV behind the opponent, ``gap`` metres at the current step."""
    paths = {"av": straight(0, 0, speed), "b": straight(gap + 4.8, 0, leader_speed, **more)}
    return rollout_of({key: path[:steps] for key, path in paths.items()})


def crossing(offset_s, speed=10.0):
    """The AV eastwards, the opponent northwards over the same place, later by ``offset_s``."""
    av, other = (
        straight(-30, 0, speed),
        straight(0, -30 - speed * offset_s, speed, heading=np.pi / 2),
    )
    return rollout_of({"av": av, "b": other})


def test_series_of_following():
    found = conflict.over_time(following(10, 6, 30))
    assert found.step.tolist() == list(range(11, 31))
    np.testing.assert_allclose(found.time_s, np.arange(1, 21) * 0.1)
    gap = 30 - 4 * found.time_s
    np.testing.assert_allclose(found.gap_m, gap)
    np.testing.assert_allclose(found.ttc_s, gap / 4)
    np.testing.assert_allclose(found.drac_mps2, 4**2 / (2 * gap))
    # behind a leader of constant speed: as DRAC
    np.testing.assert_allclose(found.braking_mps2, 4**2 / (2 * gap), rtol=0.01)


def test_no_collision_course():
    away = following(6, 10, 30)
    assert measured("drac_max", away).value == 0.0
    assert measured("required_deceleration", away).value == 0.0
    assert "course" in measured("ttc_min", away).reason


def test_a_braking_leader_asks_for_more():
    """Both at 10 m/s, the leader brakes at 4 m/s2 and stops: v^2 / 2 (gap + v_l^2 / 2 b)."""
    rollout = following(10, 10, 20, steps=18, accel=-4.0)
    found = conflict.over_time(rollout)
    speed = rollout.tracks.speed_mps[rollout.tracks.row("b")][found.step[-1]]
    expected = 10**2 / (2 * (found.gap_m[-1] + speed**2 / (2 * 4.0)))
    assert found.braking_mps2[-1] == pytest.approx(expected, rel=0.02)
    assert found.drac_mps2[-1] < found.braking_mps2[-1]


def test_a_contact_counts_up_to_a_second_before_it():
    whole = following(20, 5, 45, steps=41)  # touches after 3 s
    hit = rollout_of(
        {
            name: np.column_stack([whole.tracks.position_m[row], whole.tracks.heading_rad[row]])
            for row, name in enumerate(whole.tracks.ids)
        },
        contacts=[contact_of(step=40)],
    )
    last_gap = 45 - 15 * 2.0
    assert measured("drac_max", hit).value == pytest.approx(15**2 / (2 * last_gap))
    assert measured("min_gap", hit).value == 0.0
    assert measured("ttc_min", hit).value == 0.0
    early = rollout_of(
        {"av": straight(0, 0, 5), "b": straight(9, 0, 0)}, contacts=[contact_of(step=15)]
    )
    assert measured("required_deceleration", early).reason == conflict.TOO_SOON


def test_no_braking_helps_who_is_run_into():
    behind = rollout_of({"av": straight(0, 0, 5), "b": straight(-60, 0, 10)})
    assert "runs into the AV" in measured("required_deceleration", behind).reason
    assert measured("drac_max", behind).value > 0


@pytest.mark.parametrize("seed", range(3))
def test_required_braking_against_stepping(seed):
    """With a little more braking the AV stays clear for 8 s; with a little less it does not."""
    rng = np.random.default_rng(seed)
    count = 800
    heading = rng.uniform(-3, 3, (2, count))
    speed = rng.uniform(2, 15, (2, count))
    away = rng.uniform(8, 40, count)[:, None] * np.stack(
        [np.cos(heading[0]), np.sin(heading[0])], -1
    )
    place = np.stack([np.zeros((count, 2)), away + rng.uniform(-3, 3, (count, 2))])
    velocity = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    slowing = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0, 5, count))
    me, other = (MovingBox(place[i], heading[i], velocity[i], SIZE) for i in (0, 1))
    needed = braking_to_stay_behind(me, other, slowing, time_to_collision(me, other))
    some = np.isfinite(needed) & (needed > 0.2)
    assert some.sum() > 15

    def touches(braking):
        time = np.arange(0.1, 8.05, 0.1)
        ways = []
        for start, hard in zip(speed, (braking, slowing), strict=True):
            until = np.minimum(time, (start / np.maximum(hard, 1e-9))[:, None])
            ways.append(start[:, None] * until - hard[:, None] * until**2 / 2)
        moved = [
            place[i][:, None] + ways[i][..., None] * (velocity[i] / speed[i][:, None])[:, None]
            for i in (0, 1)
        ]
        return boxes.overlap(
            moved[0], heading[0][:, None], SIZE, moved[1], heading[1][:, None], SIZE
        ).any(1)

    assert not touches(np.where(some, needed * 1.001, 0))[some].any()
    assert touches(np.where(some, needed * 0.97, 0))[some].mean() > 0.9


@pytest.mark.parametrize("offset_s", [0.9, 1.5, 2.5])
def test_post_encroachment_time_of_a_crossing(offset_s):
    """The AV's rear leaves the common square 3.4 m after its middle, the other's front comes 3.4 m
    before: 6.8 m at 10 m/s."""
    value = measured("pet", crossing(offset_s)).value
    assert value == pytest.approx(offset_s - 0.68, abs=0.1001)


def test_post_encroachment_time_is_not_always_there():
    assert measured("pet", crossing(0.0)).value == 0.0
    beside = rollout_of({"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
    assert "common place" in measured("pet", beside).reason
    # following at 10 m/s with a gap of 10 m: the net headway
    assert measured("pet", following(10, 10, 10, steps=91)).value == pytest.approx(1.0, abs=0.1001)
