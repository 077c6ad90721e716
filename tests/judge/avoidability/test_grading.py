"""Grades and fault of drawn attacks."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge.avoidability import grading
from deepmf_sumo.judge.avoidability.encounter import encounter_of
from deepmf_sumo.judge.avoidability.grading import GRADES, evasive_manoeuvres, judge
from deepmf_sumo.judge.avoidability.manoeuvres import GRID

from tests.support.drawn_attacks import NO_ROAD, NOW, attack, cut_in
from tests.support.predictor_doubles import straight_road
from tests.support.rollout_doubles import in_traffic, straight


def graded(*motions, **options):
    return judge(*attack(*motions, **options))


def test_hit_from_behind_while_standing_is_unavoidable_and_nobodys_fault_but_the_others():
    rollout, case = attack(straight(0, 0, 0), straight(-40, 0, 12))
    found = judge(rollout, case)
    assert (found.grade, found.manoeuvres, found.avoidable) == ("no driver", 0, False)
    assert found.hit_standing
    assert grading.collision_class(rollout, rollout.contacts[0]) == "av_stopped"
    assert grading.av_at_fault(rollout, case) is False


def test_running_into_what_stands_far_ahead_is_avoided_by_all():
    rollout, case = attack(straight(0, 0, 12), straight(80, 0, 0))
    found = judge(rollout, case)
    assert found.grade == "all drivers"
    assert found.avoided_by == {"cc": True, "fsm": True, "rss": True}
    # the onset is the first step from which the gap is covered within 3 s
    gap = 80 - 4.8 - 12 * 0.1 * (found.onset_step - NOW)
    assert 36 - 1.2 <= gap <= 36 + 1e-6
    assert grading.collision_class(rollout, rollout.contacts[0]) == "other_stopped"
    assert grading.av_at_fault(rollout, case) is True


def test_a_crossing_car_that_shows_half_a_second_before_is_unavoidable():
    seconds = (np.arange(91) - NOW) * 0.1
    late = np.stack([np.full(91, 10.0), -7.0 + 14 * seconds, np.full(91, np.pi / 2)], -1)
    assert graded(straight(0, 0, 15), late).grade == "no driver"
    early = late + np.array([20.0, -20.0, 0.0])
    assert graded(straight(0, 0, 15), early).grade in {"some drivers", "all drivers"}


def test_the_nearer_a_cut_in_the_worse_the_grade():
    av, gaps = straight(0, 0, 16), [4.0, 7.0, 10.0, 14.0, 20.0]
    found = [graded(av, cut_in(gap, 8)) for gap in gaps]
    grades = [GRADES.index(one.grade) for one in found]
    assert grades == sorted(grades)
    assert found[0].grade in {"no driver", "emergency manoeuvre"}
    assert found[-1].grade == "all drivers"


def test_only_a_free_lane_to_swerve_to_saves_a_fast_car():
    """45 m at 30 m/s: too short to stop (56 m), long enough to change lanes."""
    av, wall = straight(0, 0, 30), straight(49.8, 0, 0)
    alone = graded(av, wall)
    assert alone.grade == "emergency manoeuvre"
    assert 0 < alone.manoeuvres < 20
    beside = {"c": straight(2, 3.5, 30), "d": straight(-6, 3.5, 30)}
    assert graded(av, wall, others=beside).grade == "no driver"
    assert graded(av, wall, road=straight_road(lanes=1)).grade == "no driver"
    # who drives where the map has no lanes is not told to stay on them
    assert graded(av, wall, road=NO_ROAD).manoeuvres >= 2 * alone.manoeuvres


def test_a_follower_counts_against_swerving_and_not_against_braking():
    av, leader = straight(0, 0, 15), straight(35, 0, 0)
    ways = [
        evasive_manoeuvres(encounter_of(rollout, case), rollout, case)
        for others in ({}, {"c": straight(-6, 0.3, 15)}, {"c": straight(-6, 3.5, 15)})
        for rollout, case in [attack(av, leader, others=others)]
    ]
    straight_on = GRID.lateral_mps2 == 0
    assert ways[0][straight_on].any()
    for followed in ways[1:]:
        np.testing.assert_array_equal(followed[straight_on], ways[0][straight_on])
        assert followed[~straight_on].sum() < ways[0][~straight_on].sum()


@pytest.mark.parametrize("shift", [-500.0, 500.0])
def test_who_appears_later_is_ahead_wherever_the_scene_lies(shift):
    """What tracks hold of an agent before it is there says nothing of where it is."""
    away = np.array([shift, 0.0, 0.0])
    stands = {"c": straight(54, 0, 0) + away}
    rollout, case = attack(straight(0, 0, 15) + away, straight(75, 0, 0) + away, others=stands)
    always = evasive_manoeuvres(encounter_of(rollout, case), rollout, case)
    tracks = rollout.tracks
    position, valid = tracks.position_m.copy(), tracks.valid.copy()
    position[tracks.row("c"), :30], valid[tracks.row("c"), :30] = 0.0, False
    late = replace(rollout, tracks=replace(tracks, position_m=position, valid=valid))
    encounter = encounter_of(late, case)
    assert encounter.first_step + encounter.onset < 30 < encounter.first_step + encounter.contact
    np.testing.assert_array_equal(evasive_manoeuvres(encounter, late, case), always)


def test_who_overlaps_the_av_from_the_start_does_not_stand_where_the_data_says():
    av, wall = straight(0, 0, 20), straight(60, 0, 0)
    alone = graded(av, wall)
    assert graded(av, wall, others={"c": straight(1, 1, 20)}) == alone
    assert graded(av, wall, others={"c": straight(0, 4, 20)}) != alone


def test_sumo_traffic_goes_on_at_its_velocity_after_the_end():
    av, wall = straight(0, 0, 30), straight(49.8, 0, 0)
    rollout, recorded = attack(av, wall, others={"c": straight(75, 3.5, -1)})
    case = in_traffic(recorded)
    assert judge(rollout, case) == judge(rollout, recorded)


def test_what_is_recorded_after_the_end_counts():
    """A third car that stands off the road and comes back on it only after the contact."""
    av, wall = straight(0, 0, 30), straight(49.8, 0, 0)
    beside = straight(75, 20, 0)
    beside[27:, 1] = 3.5
    rollout, case = attack(av, wall, others={"c": beside})
    assert rollout.contacts[0].step < 27
    assert judge(rollout, case).manoeuvres < graded(av, wall).manoeuvres
    assert judge(rollout, replace(case, traffic="sumo")) == graded(av, wall)


def test_no_contact_no_judgement():
    rollout, case = attack(straight(0, 0, 10), straight(50, 3.5, 10))
    assert judge(rollout, case) is None
    assert grading.av_at_fault(rollout, case) is None


@pytest.mark.parametrize(
    ("av", "other", "found", "at_fault"),
    [
        (straight(0, 0, 15), straight(20, 0, 5), "active_front", True),
        (straight(0, 0, 5), straight(-20, 0.8, 15), "active_rear", False),
        # a sideswipe by a car that comes over from the left lane
        (straight(0, 0, 10), straight(-1, 3.5, 10, heading=-0.1), "active_lateral", False),
        # the same with the AV across the line between the lanes
        (straight(0, 1.2, 10), straight(-1, 4.7, 10, heading=-0.1), "active_lateral", True),
    ],
)
def test_fault_classes(av, other, found, at_fault):
    rollout, case = attack(av, other)
    assert grading.collision_class(rollout, rollout.contacts[0]) == found
    assert grading.av_at_fault(rollout, case) is at_fault


@pytest.mark.parametrize("speed", [10, 20, 25, 30, 38])
def test_a_fast_bumper_is_through_a_crossing_car_at_the_end_of_the_step(speed):
    seconds = (np.arange(91) - NOW) * 0.1
    for ahead in np.linspace(45, 49, 9):
        meeting_s = ahead / speed
        crossing = np.stack(
            [np.full(91, ahead), 3 * (seconds - meeting_s), np.full(91, np.pi / 2)], -1
        )
        rollout, case = attack(straight(0, 0, speed), crossing)
        assert grading.collision_class(rollout, rollout.contacts[0]) == "active_front"
        assert grading.av_at_fault(rollout, case) is True


def test_grades_follow_from_who_avoids():
    base = grading.Judgement(
        avoided_by={"cc": False, "fsm": False},
        standing={"cc": True, "fsm": False},
        manoeuvres=0,
        onset_step=10,
    )
    assert (base.grade, base.hit_standing) == ("no driver", True)
    assert replace(base, manoeuvres=1).grade == "emergency manoeuvre"
    some = replace(base, avoided_by={"cc": False, "fsm": True})
    assert (some.grade, some.avoidable, some.physically, some.hit_standing) == (
        "some drivers",
        True,
        True,
        False,
    )
    assert replace(base, avoided_by={"cc": True, "fsm": True}).grade == "all drivers"
