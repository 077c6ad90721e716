"""People reach where the AV will be, in time and within what they can do; without lanes."""

import numpy as np
import pytest

from deepmf_sumo.deepmf.off_lane_paths import off_lane_paths
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import track
from deepmf_sumo.scene import Forecast, Futures
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.road_users import ROAD_USERS, MotionLimits

from tests.support.people_views import people_view
from tests.support.predictor_doubles import STEPS

UP = np.pi / 2
LIMITS = {kind: ROAD_USERS[name].motion.planned for kind, name in
          [("pedestrian", "pedestrian"), ("cyclist", "bicycle")]}  # fmt: skip
AV_SIZE = np.array([4.8, 2.0])


def ahead(speed=10.0, begin=(0.0, 0.0), heading=0.0):
    """The AV straight on at a speed."""
    way = np.array([np.cos(heading), np.sin(heading)])
    position = np.array(begin) + (speed * STEPS)[:, None] * way
    futures = Futures(
        agent_id="av", position_m=position[None], heading_rad=np.full((1, 80), heading)
    )
    return Forecast(futures=futures, probability=np.ones(1))


def situation_of(person, av=None, av_row=("vehicle", 0, 0, 0, 10.0)):
    view = people_view({"av": av_row, "p": person})
    return Situation.of(view, "p", LIMITS[person[0]], unattacked=av or ahead())


def walked(situation, count=64):
    paths = off_lane_paths(situation, count)
    return paths, track(paths.position_m, situation.start, paths.limits)


def hits(situation, tracked):
    """(M) whether the box of each touches the AV's at the same time."""
    futures = situation.unattacked.futures
    touch = boxes.overlap(
        tracked.position_m, tracked.heading_rad, situation.size_m,
        futures.position_m, futures.heading_rad, AV_SIZE,
    )  # fmt: skip
    return touch.any(axis=1)


EVERYBODY = [
    ("pedestrian", 40, -4, UP, 0.0),
    ("pedestrian", 30, -4, 0, 1.4),
    ("pedestrian", 45, -6, np.pi, 1.4),
    ("pedestrian", 50, 9, -2.0, 2.5),
    ("cyclist", 15, -2.5, 0, 4.0),
    ("cyclist", 25, -8, UP, 5.0),
    ("cyclist", 40, 3, np.pi, 4.0),
    ("cyclist", 40, -5, 0.3, 0.0),
]


@pytest.mark.parametrize("person", EVERYBODY)
def test_all_of_them_meet_the_av_that_keeps_on(person):
    situation = situation_of(person)
    paths, tracked = walked(situation)
    assert len(paths.origin) > 2
    assert hits(situation, tracked).mean() > 0.97
    assert tracked.bent_m.max() < 0.35


@pytest.mark.parametrize("turn", [0.7, 3.0])
@pytest.mark.parametrize("person", EVERYBODY)
def test_a_turned_world_has_the_turned_paths(person, turn):
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.array([[cos, sin], [-sin, cos]])
    kind, x, y, heading, speed = person
    there = np.array([x, y]) @ matrix
    one, _ = walked(situation_of(person))
    twin, _ = walked(
        situation_of(
            (kind, *there, heading + turn, speed),
            ahead(heading=turn),
            ("vehicle", 0, 0, turn, 10.0),
        )
    )
    assert sorted(one.origin) == sorted(twin.origin)
    mine = {tuple(np.round(ends, 3)) for ends in one.position_m[:, -1] @ matrix}
    theirs = {tuple(np.round(ends, 3)) for ends in twin.position_m[:, -1]}
    assert len(mine & theirs) > 0.9 * len(mine)  # of equally good goals either is taken


@pytest.mark.parametrize("person", EVERYBODY)
def test_the_mirrored_world_has_the_mirrored_paths(person):
    kind, x, y, heading, speed = person
    mirror = np.array([1.0, -1.0])
    one, _ = walked(situation_of(person))
    twin, _ = walked(situation_of((kind, x, -y, -heading, speed)))
    assert sorted(one.origin) == sorted(twin.origin)
    mine = {tuple(np.round(ends, 3)) for ends in one.position_m[:, -1]}
    theirs = {tuple(np.round(ends * mirror, 3)) for ends in twin.position_m[:, -1]}
    assert len(mine & theirs) > 0.9 * len(mine)


def test_who_stands_at_the_kerb_steps_out_when_it_matters():
    """4.3 m to the AV's middle at walking pace with 0.85 * 1.6 m/s2 take 3.66 s.

    1 s and 0.68 m until it walks, then 3.62 m at 1.36 m/s. The AV's middle is there at 5 s.
    """
    situation = situation_of(("pedestrian", 50, -4.3, UP, 0.0))
    paths, tracked = walked(situation)
    rows = [row for row, origin in enumerate(paths.origin) if origin == "wait"]
    begins = [0.1 * int((tracked.speed_mps[row] > 0.05).argmax()) for row in rows]
    fast = [tracked.speed_mps[row].max() for row in rows]
    walks = [at for at, speed in zip(begins, fast, strict=True) if speed < 1.5]
    assert min(abs(at - (5.0 - 3.66)) for at in walks) < 0.25
    assert max(begins) > 1.0
    assert all(np.ptp(tracked.position_m[row, :5]) < 60 for row in rows)


@pytest.mark.parametrize(("away", "reached"), [(9.0, True), (15.0, False)])
def test_who_is_too_far_away_is_not_driven_at_the_av(away, reached):
    """In 5 s a pedestrian gets 13.7 m from rest: 3.8 m to speed up in 2.19 s, then 3.5 m/s.

    With 85 % of the acceleration 13.0 m; the AV's nearer side is 1 m nearer than its middle.
    """
    av = ahead(10.0)
    futures = av.futures
    gone = Futures(  # from 5 s on it is far away
        agent_id="av",
        position_m=np.where(STEPS[:, None] <= 5.05, futures.position_m, 1e4),
        heading_rad=futures.heading_rad,
    )
    situation = situation_of(
        ("pedestrian", 50, -away, UP, 0.0), Forecast(futures=gone, probability=np.ones(1))
    )
    assert bool(len(off_lane_paths(situation, 64).origin)) == reached


def test_who_halts_is_there_before_the_av_and_stays():
    situation = situation_of(("pedestrian", 70, -3, UP, 0.0))
    paths, tracked = walked(situation)
    rows = [row for row, origin in enumerate(paths.origin) if origin == "halt"]
    assert rows
    for row in rows:
        assert tracked.speed_mps[row, -5:].max() < 0.1
        assert np.abs(tracked.position_m[row, -1, 1]) < 1.3


def test_who_turns_back_has_passed_the_av_s_way_before():
    situation = situation_of(("pedestrian", 75, -3, UP, 0.0))
    paths, tracked = walked(situation)
    rows = [row for row, origin in enumerate(paths.origin) if origin == "return"]
    assert rows
    for row in rows:
        y = tracked.position_m[row, :, 1]
        assert y[-1] < y.max() - 0.5
        assert y.max() > y[0] + 2.5
        assert hits(situation, tracked)[row]


def test_cyclists_never_turn_back_on_the_spot():
    paths, _ = walked(situation_of(("cyclist", 75, -3, UP, 3.0)))
    assert "return" not in paths.origin


def test_the_limits_given_are_obeyed():
    calm = MotionLimits(accel=0.5, brake=0.5, lateral=0.5)
    view = people_view({"av": ("vehicle", 0, 0, 0, 10.0), "p": ("pedestrian", 50, -5, UP, 1.0)})
    situation = Situation.of(view, "p", calm, unattacked=ahead())
    paths = off_lane_paths(situation, 64)
    speed = np.hypot(*np.moveaxis(np.diff(paths.position_m, axis=1), -1, 0)) / 0.1
    assert np.abs(np.diff(speed, axis=1)).max() / 0.1 < 0.55
    np.testing.assert_array_equal(paths.limits, calm.rows(len(paths.origin)))


def test_there_are_no_more_than_asked_for_and_of_each_kind_some():
    situation = situation_of(("pedestrian", 75, -3, UP, 0.0))
    few = off_lane_paths(situation, 8)
    assert len(few.origin) == 8
    assert {"goal", "wait", "halt", "return"} <= set(few.origin)


def test_without_a_prediction_of_the_av_there_are_none():
    view = people_view({"av": ("vehicle", 0, 0, 0, 10.0), "p": ("pedestrian", 50, -5, UP, 1.0)})
    assert not off_lane_paths(Situation.of(view, "p", LIMITS["pedestrian"]), 64).origin
