"""From when on a driver can act on a person, and whether acting is enough: checked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge.avoidability.grading import judge
from deepmf_sumo.judge.avoidability.intention import shown_since
from deepmf_sumo.scene import RoadMap

from tests.judge.test_ladder import STREET
from tests.support.drawn_people import CAR, NOW, TRUCK, Drawn, episode, stands, walks
from tests.support.rollout_doubles import straight

EYE_M = CAR[0] / 2 - 0.4 * CAR[0]
KERB_M = -2.25
"""The lane's edge at -1.75 m, and half a metre beside it."""


def judged(found):
    return judge(found.rollout, found.case)


def onset(found):
    rollout = found.rollout
    contact = rollout.first("av_opponent").step
    return shown_since(rollout, found.case.road, rollout.tracks.row("b"), NOW, contact)


def test_a_walker_shows_with_the_step_into_the_road():
    """From 2.6 m beside the middle at 1.4 m/s: 0.42 m after three steps."""
    person = walks(24, -2.6, (9, 1.4))
    found = episode(straight(0, 0, 14), Drawn(person), road=STREET)
    assert person[NOW + 2, 1] < KERB_M < person[NOW + 3, 1]
    assert onset(found) == NOW + 3
    assert judged(found).onset_step >= NOW + 3


@pytest.mark.parametrize(("speed", "on_pavement"), [(1.7, False), (2.2, True)])
def test_a_runner_shows_on_the_pavement(speed, on_pavement):
    """Faster than 1.84 m/s, over 0.5 s from the start."""
    person = walks(30, -6.0, (9, speed), begin=0)
    found = episode(straight(0, 0, 14), Drawn(person), road=STREET)
    shows = person[onset(found), 1]
    assert (shows < KERB_M) == on_pavement


def test_who_stops_at_the_kerb_has_taken_it_back():
    """Runs to the kerb, stands there for a second, and steps out."""
    person = walks(40, -5.6, (1.5, 2.2), (1.0, 0.0), (9, 1.4), begin=NOW - 5)
    found = episode(straight(0, 0, 14), Drawn(person), road=STREET)
    stood = NOW - 5 + 25
    assert person[stood, 1] == pytest.approx(-2.3)
    assert onset(found) == stood + 1


def test_who_was_on_the_road_before_the_attack_is_known_from_its_start():
    found = episode(straight(0, 0, 14), Drawn(stands(60, 0)), road=STREET)
    assert onset(found) == NOW


def test_beside_all_lanes_every_place_is_road():
    found = episode(straight(0, 0, 14), Drawn(walks(40, -9, (9, 3.4))), road=RoadMap(lanes={}))
    assert onset(found) == NOW


def stopping_m(speed):
    """0.75 s, then 12.65 m/s3 up to 0.774 g, to standstill."""
    hardest = 0.774 * 9.81
    ramp_s = hardest / 12.65
    after = speed - hardest * ramp_s / 2
    ramp_m = speed * ramp_s - 12.65 * ramp_s**3 / 6
    return 0.75 * speed + ramp_m + after**2 / (2 * hardest)


@pytest.mark.parametrize("speed", [10.0, 14.0])
@pytest.mark.parametrize(("spare_m", "avoided"), [(-0.6, False), (0.6, True)])
def test_the_driver_stops_within_the_distance_of_a_hand_calculation(speed, spare_m, avoided):
    """A walker steps out at 1 m/s and stays in the lane; at the onset the gap is known."""
    gap = stopping_m(speed) + spare_m
    x = speed * 0.1 + CAR[0] / 2 + gap + 0.25
    person = walks(x, -2.3, (2.0, 1.0), (9, 0.0))
    found = episode(straight(0, 0, speed), Drawn(person), road=STREET)
    assert onset(found) == NOW + 1
    told = judged(found)
    assert told.avoided_by == {"vru": avoided}


def behind_truck(others=()):
    """A runner who crosses 0.6 m before the front of a parked truck, and meets the AV at 2.2 s."""
    x = 8 * 2.2 + CAR[0] / 2 + 0.25
    return x, walks(x, -7.7, (9, 3.0)), [Drawn(stands(x - 6.6, -4.1), "vehicle", TRUCK), *others]


def test_who_comes_from_behind_a_truck_shows_late_and_the_same_in_the_open_does_not():
    """By hand: the line from the eye over the truck's corner meets his way near y = -2.7.

    From there the front of the AV's corridor, at -1.25 m, is 0.5 s away; the reaction takes 0.75 s.
    In the open he runs to the road from 0.4 s on: the AV has 1.8 s or 14.4 m, and needs 12.5 m.
    """
    x, person, truck = behind_truck()
    hidden = episode(straight(0, 0, 8), Drawn(person), truck, road=STREET)
    contact = hidden.rollout.first("av_opponent").step
    eye_x = EYE_M + 0.8 * (onset(hidden) - NOW)
    corner = (x - 0.6, -4.1 + TRUCK[1] / 2)
    shadow_y = corner[1] * (x - eye_x) / (corner[0] - eye_x)
    assert person[onset(hidden), 1] == pytest.approx(shadow_y, abs=0.35)
    assert 3 <= contact - onset(hidden) <= 6
    told = judged(hidden)
    assert (told.avoided_by, told.avoidable) == ({"vru": False}, False)
    seen = episode(straight(0, 0, 8), Drawn(person), road=STREET)
    assert (contact - onset(seen)) * 0.1 > 1.0
    assert judged(seen).avoided_by == {"vru": True}


def test_a_parked_car_hides_a_child_but_not_a_man():
    x = 16.0
    car = [Drawn(stands(x - 3.0, -3.6), "vehicle", (4.7, 2.0, 1.5))]
    child = Drawn(walks(x, -6.2, (9, 3.0)), "pedestrian", (0.4, 0.4, 1.1))
    man = Drawn(walks(x, -6.2, (9, 3.0)), "pedestrian", (0.4, 0.4, 1.9))
    late, early = (onset(episode(straight(0, 0, 8), one, car, road=STREET)) for one in (child, man))
    assert late > early + 3


def test_who_was_seen_with_its_intention_is_remembered():
    """In sight on the road, then behind a van that passes: the driver knows of him."""
    person = walks(60, -2.3, (2.0, 1.0), (9, 0.0))
    van = np.zeros((91, 3))
    van[:, 0] = np.interp(np.arange(91), [0, 20, 30, 90], [200, 20, 40, 160])
    passing = [Drawn(van, "vehicle", TRUCK)]
    found = episode(straight(0, 0, 8), Drawn(person), passing, road=STREET)
    assert onset(found) == NOW + 1


def test_who_never_shows_leaves_no_time():
    """He stands half in the AV's way and half a metre beside the lane, behind a truck."""
    narrow = replace(STREET.lanes["east"], width_m=0.5)
    truck = [Drawn(stands(31, -2.1), "vehicle", (12.0, 1.9, 3.3))]
    found = episode(
        straight(0, 0, 8), Drawn(stands(40, -1.2)), truck, RoadMap(lanes={"east": narrow})
    )
    contact = found.rollout.first("av_opponent").step
    told = judged(found)
    assert (told.onset_step, told.avoidable, told.manoeuvres) == (contact, False, 0)


def test_who_leaves_the_road_meets_people_there():
    """Where the AV drives beside all lanes, every place is road: from that step on."""
    av = straight(0, 0, 8)
    av[:, 1] = np.interp(np.arange(91), [20, 40], [0, -3.5])
    found = episode(av, Drawn(stands(40, -3.5)), road=STREET)
    left = int(np.flatnonzero(av[:, 1] < KERB_M)[0])
    assert onset(found) == left


def test_a_driver_who_stands_before_the_person_comes_was_able_to_avoid_it():
    """The person runs towards the AV along the lane, and into the car that has stopped."""
    person = walks(30, 0, (9, 3.0), heading=np.pi)
    found = episode(straight(0, 0, 6), Drawn(person), road=STREET)
    told = judged(found)
    assert told.standing == {"vru": True}
    assert told.avoided_by == {"vru": True}


def test_hits_by_vehicles_keep_their_drivers():
    found = episode(straight(0, 0, 14), Drawn(stands(60, 0), "vehicle", CAR), road=STREET)
    assert judged(found).avoided_by == {"cc": True, "fsm": True, "rss": True}
    person = replace(found.rollout.tracks, kinds=("vehicle", "cyclist"))
    found = replace(found.rollout, tracks=person), found.case
    assert judge(*found).avoided_by == {"vru": True}
