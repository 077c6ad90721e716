"""Conflicts of plain traffic: motions whose measures are known by hand, and brute force."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from deepmf_sumo.judge.metrics.traffic_conflicts import (
    CUT_OFF,
    NOT_SHARED,
    ConflictLimits,
    RoadUserMotions,
    courses,
    find,
)
from deepmf_sumo.roadcheck.motion_survey import Survey, survey
from deepmf_sumo.scene.geometry import boxes

CAR = 4.0, 2.0
FOUR_WAY = Path(__file__).resolve().parents[3] / "sumo_nets" / "four_way" / "four_way.sumocfg"
T = np.arange(100) * 0.1


def way(x, y, heading, speed, lane=0, size=CAR, z=0.0):
    """One road user: everything at 100 steps."""
    return [np.broadcast_to(one, T.shape) for one in (x, y, heading, speed, lane, z)], size


def motions(*ways, steps=100, edges=(0, 0, 1)):
    """Of all road users, sorted as SUMO's are read."""
    columns = np.array([columns for columns, _ in ways], float)[:, :, :steps]
    x, y, heading, speed, lane, z = columns.transpose(1, 2, 0).reshape(6, -1)
    return RoadUserMotions(
        dt_s=0.1,
        size_m=np.array([size for _, size in ways]),
        step=np.repeat(np.arange(steps), len(ways)),
        body=np.tile(np.arange(len(ways)), steps),
        position_m=np.stack([x, y], axis=1),
        heading_rad=heading,
        speed_mps=speed,
        z_m=z,
        lane=lane.astype(int),
        edge_of_lane=np.array(edges),
    )


# a is on the other's way (3 m to either side of the crossing) from 1.695 to 2.295 s; b would be
# from 2.205 s on, but stops after 1 s, and comes onto it at 4.205 s: steps 22 and 43 are theirs
A = way(-19.95 + 10 * T, 0, 0, 10)
STOPS = np.where(T < 1.05, -25.05 + 10 * T, np.where(T < 2.95, -15.05, -45.05 + 10 * T))
B = way(0, STOPS, np.pi / 2, np.where((T < 1.05) | (T > 2.95), 10.0, 0.0), lane=2)


def test_two_on_foot_have_no_conflict_but_one_has_with_a_vehicle():
    both = motions(A, B)
    [one] = find(both, ConflictLimits()).conflicts
    for on_foot, kept in (([True, False], [one]), ([False, True], [one]), ([True, True], [])):
        found = find(replace(both, on_foot=np.array(on_foot)), ConflictLimits())
        assert [(each.begin, each.pet_s) for each in found.conflicts] == [
            (each.begin, each.pet_s) for each in kept
        ]
        assert found.left_out == {}


def test_a_vehicle_of_several_boxes_has_one_conflict():
    boxes = [way(0, -20 + 10 * T - 4.0 * number, np.pi / 2, 10, lane=2) for number in range(3)]
    seen = motions(A, *boxes)
    alone = find(seen, ConflictLimits()).conflicts
    assert len([one for one in alone if 0 in (one.first, one.second)]) > 1
    [one] = find(replace(seen, parts=np.array([0, 1, 1, 1])), ConflictLimits()).conflicts
    assert 0 in (one.first, one.second)
    assert one.ttc_s == min(each.ttc_s for each in alone)


@pytest.mark.parametrize("order", [(A, B), (B, A)])
def test_a_crossing_at_right_angles(order):
    [one] = find(motions(*order), ConflictLimits()).conflicts
    assert (order[one.first], order[one.second]) == (A, B)
    assert (one.begin, one.end, one.ttc_step) == (8, 10, 10)
    assert one.ttc_s == pytest.approx(2.205 - 1.0)
    assert one.pet_s == pytest.approx(2.1)
    assert (one.type, one.angle_deg) == ("crossing", pytest.approx(90))
    assert one.delta_s_mps == pytest.approx(np.sqrt(200))
    assert one.delta_v_mps == pytest.approx((np.sqrt(50), np.sqrt(50)))
    assert (one.max_s_mps, one.max_d_mps2) == (10.0, 0.0)


def test_what_is_no_conflict_is_counted():
    both = motions(A, B)
    assert find(both, ConflictLimits(pet_s=2.0)) == ((), {NOT_SHARED: 1})
    assert find(motions(A, B, steps=30), ConflictLimits()) == ((), {CUT_OFF: 1})
    assert find(both, ConflictLimits(ttc_s=1.2)) == ((), {})
    assert find(motions(A, way(0, STOPS, np.pi / 2, 10, lane=2, z=6.0)), ConflictLimits()) == (
        (),
        {},
    )


def test_conflicts_from_the_right_have_a_positive_angle():
    mirrored = way(0, -STOPS, -np.pi / 2, np.where((T < 1.05) | (T > 2.95), 10.0, 0.0), lane=2)
    [left] = find(motions(A, mirrored), ConflictLimits()).conflicts
    assert left.angle_deg == pytest.approx(-90)


# 5 m/s behind 10 m/s; brakes with 5 m/s2 from 4 to 5 s, to a gap of 3.75 m, which takes 0.75 s
LATE = np.clip(T - 4, 0, 1)
FOLLOWER = way(10 * T - 2.5 * LATE**2 - 5 * np.maximum(T - 5, 0), 0, 0, 10 - 5 * LATE)
LEADER = way(33.25 + 5 * T, 0, 0, 5, size=(10.0, 2.0))


def test_following():
    [one] = find(motions(FOLLOWER, LEADER), ConflictLimits()).conflicts
    assert (one.first, one.second) == (1, 0)
    assert (one.begin, one.end, one.ttc_step) == (38, 43, 40)
    assert one.ttc_s == pytest.approx(6.25 / 5)
    assert one.pet_s == pytest.approx(0.8)
    assert one.max_d_mps2 == pytest.approx(5.0)
    assert (one.type, one.angle_deg, one.max_s_mps) == ("rear end", 0.0, 10.0)
    assert one.delta_s_mps == pytest.approx(5.0)
    # areas of 20 and 8 m2
    assert one.delta_v_mps == pytest.approx((5 * 8 / 28, 5 * 20 / 28))


def test_a_queue_that_waits_for_longer_than_the_limits():
    # the gap of 8.5 m is left at 4 s; the leader leaves at 6 s, the follower 28.5 m behind it
    stands = way(52.5 + 10 * np.maximum(T - 6, 0), 0, 0, np.where(T < 6.05, 0.0, 10.0))
    comes = np.where(T < 4.05, 10 * T, 40 + 10 * np.maximum(T - 8, 0))
    stops = way(comes, 0, 0, np.where((T < 4.05) | (T > 8.05), 10.0, 0.0))
    [one] = find(motions(stops, stands), ConflictLimits(pet_s=3.0)).conflicts
    assert (one.first, one.end, one.ttc_s) == (1, 40, pytest.approx(0.85))
    assert one.pet_s == pytest.approx(2.9)


def test_head_on():
    aside = np.where(T < 2.55, 0.0, 3.0)
    other = way(60.5 - 10 * T, aside, np.pi, 10, lane=2)
    [one] = find(motions(way(10 * T, 0, 0, 10), other), ConflictLimits()).conflicts
    # 6.5 m are left at 2.5 s, when the other one leaves the place that a comes to 0.7 s later
    assert (one.begin, one.end, one.ttc_step) == (14, 25, 25)
    assert one.ttc_s == pytest.approx(6.5 / 20)
    assert (one.first, one.second) == (1, 0)
    assert one.pet_s == pytest.approx(0.7)
    assert (one.type, abs(one.angle_deg)) == ("crossing", pytest.approx(180))
    assert one.delta_s_mps == pytest.approx(20)


@pytest.mark.parametrize(("before", "kind"), [(1, "lane change"), (0, "rear end")])
def test_a_lane_change(before, kind):
    late = T > 4.55
    behind = way(np.where(late, 67.5 + 10 * (T - 4.5), 15 * T), 0, 0, np.where(late, 10, 15))
    changed = T > 4.45
    aside = np.where(changed, 0.0, 3.5)
    cuts_in = way(30 + 10 * T, aside, 0, 10, lane=np.where(changed, 0, before))
    [one] = find(motions(behind, cuts_in), ConflictLimits()).conflicts
    assert (one.begin, one.end) == (45, 45)
    assert one.ttc_s == pytest.approx(3.5 / 5)
    assert one.pet_s == pytest.approx(0.4)
    assert (one.first, one.type) == (1, kind)


@pytest.mark.parametrize(
    ("angle_deg", "kind"), [(29, "rear end"), (31, "lane change"), (84, "lane change")]
)
def test_the_angle_decides_where_no_lane_is_shared(angle_deg, kind):
    turned = np.radians(angle_deg)
    back = 10 * (T - 2)
    slow = way(6 * (T - 2), 0, 0, 6)
    joins = way(back * np.cos(turned), back * np.sin(turned), turned, 10, lane=2)
    assert {one.type for one in find(motions(slow, joins), ConflictLimits()).conflicts} == {kind}


def test_one_conflict_unless_more_than_the_limit_of_pet_lies_between():
    # twice near: the gap of 2 m closes at 2 m/s for a step at 1 s and at 4 s
    near = np.isin(np.arange(100), (10, 40))
    follower = way(10 * T, 0, 0, np.where(near, 12.0, 10.0))
    pair = motions(follower, way(6 + 10 * T, 0, 0, 10))
    [one] = find(pair, ConflictLimits(pet_s=5.0)).conflicts
    assert (one.begin, one.end) == (10, 40)
    assert [one.begin for one in find(pair, ConflictLimits(pet_s=2.9)).conflicts] == [10, 40]


@pytest.mark.sumo
def test_pairs_of_sumos_traffic_against_brute_force():
    """All pairs up to 100 m apart, boxes moved forward by 0.05 s at a time, as polygons."""
    seen = survey(Survey(config=FOUR_WAY, seed=42, until_s=60.0)).motions
    mine, theirs, ttc = courses(seen, ConflictLimits(ttc_s=3.0))
    found = {(int(a), int(b)): float(one) for a, b, one in zip(mine, theirs, ttc, strict=True)}
    ahead, expected, pairs = np.arange(0, 3, 0.05), {}, 0
    for step in np.unique(seen.step)[::6]:
        rows = np.flatnonzero(seen.step == step)
        a, b = np.triu_indices(len(rows), 1)
        apart = seen.position_m[rows[a]] - seen.position_m[rows[b]]
        a, b = (one[np.hypot(*apart.T) < 100] for one in (a, b))
        pairs += len(a)
        areas = _moved(seen, rows, ahead)
        meets = shapely.intersects(areas[a], areas[b])
        for i in np.flatnonzero(meets.any(axis=1)):
            expected[int(rows[a[i]]), int(rows[b[i]])] = ahead[meets[i].argmax()]
    assert pairs > 5_000
    assert len(expected) > 20
    for pair, one in expected.items():
        assert found[pair] == pytest.approx(one, abs=0.0501)
    # all touch when they should; what cuts a corner in less than 0.05 s is not among the expected
    first, second = (
        _moved(seen, rows, ttc[:, None] + np.array([-0.01, 1e-6])) for rows in (mine, theirs)
    )
    touching = shapely.intersects(first, second)
    assert touching[:, 1].all()
    assert not touching[ttc > 0.01, 0].any()


def _moved(seen, rows, ahead_s):
    """Polygons (K, F) of the boxes of sightings after some seconds (F) or (K, F)."""
    ahead_s = np.atleast_2d(ahead_s)[..., None]
    centre = seen.position_m[rows, None] + seen.velocity_mps[rows, None] * ahead_s
    sizes = seen.size_m[seen.body[rows], None]
    return shapely.polygons(boxes.corners(centre, seen.heading_rad[rows, None], sizes))
