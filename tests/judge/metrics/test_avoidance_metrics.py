"""Avoidability, fault and validity as metrics of rollouts."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.scene import Driver

from tests.support.drawn_attacks import attack, cut_in
from tests.support.rollout_doubles import contact_of, straight

NAMES = [name for name in plugins.names("metrics") if name.startswith("avoid")]
OF_CONTACTS = [*NAMES, "av_at_fault"]


def measured(name, rollout, case):
    return plugins.load("metrics", name).measure(rollout, case)


def values(rollout, case):
    return {name: measured(name, rollout, case).value for name in [*OF_CONTACTS, "finding"]}


def eased(path):
    """A path (T, 3) whose sideways motion begins and ends within a second, as a car's does."""
    aside = np.convolve(np.pad(path[:, 1], 5, "edge"), np.ones(11) / 11, "valid")
    return np.stack([path[:, 0], aside, path[:, 2]], -1)


def test_running_into_a_car_that_stands_far_ahead():
    assert values(*attack(straight(0, 0, 12), straight(80, 0, 0))) == {
        "avoidable": 1.0,
        "avoidable_physically": 1.0,
        "avoidance_grade": 3.0,
        "avoidance_hit_standing": 0.0,
        "avoided_by_cc": 1.0,
        "avoided_by_fsm": 1.0,
        "avoided_by_rss": 1.0,
        "avoided_by_vru": None,
        "avoided_by_search": 1.0,
        "av_at_fault": 1.0,
        "finding": 1.0,
    }


def test_hit_from_behind_while_standing():
    assert values(*attack(straight(0, 0, 0), straight(-40, 0, 12))) == {
        "avoidable": 0.0,
        "avoidable_physically": 0.0,
        "avoidance_grade": 0.0,
        "avoidance_hit_standing": 1.0,
        "avoided_by_cc": 0.0,
        "avoided_by_fsm": 0.0,
        "avoided_by_rss": 0.0,
        "avoided_by_vru": None,
        "avoided_by_search": 0.0,
        "av_at_fault": 0.0,
        "finding": 0.0,
    }


@pytest.mark.parametrize("name", OF_CONTACTS)
def test_without_a_contact_there_is_a_reason(name):
    rollout, case = attack(straight(0, 0, 10), straight(50, 3.5, 10))
    missed = measured(name, rollout, case)
    assert (missed.value, missed.reason) == (None, "AV and opponent did not collide")
    nobody = measured(name, replace(rollout, attackers=()), case)
    assert (nobody.value, nobody.reason) == (None, "no vehicle was attacked")


def test_a_miss_is_no_finding_and_nobody_attacked_is_none():
    rollout, case = attack(straight(0, 0, 10), straight(50, 3.5, 10))
    assert measured("finding", rollout, case).value == 0.0
    assert measured("finding", replace(rollout, attackers=()), case).value is None


def test_what_makes_a_hit_no_finding():
    rollout, case = attack(straight(0, 0, 16), eased(cut_in(20.3, 8)))
    assert measured("finding", rollout, case).value == 1.0
    earlier = contact_of("opponent_other", rollout.contacts[0].step - 5, "b", "c")
    third = replace(rollout, contacts=(earlier, *rollout.contacts))
    assert measured("finding", third, case).value == 0.0
    near, near_case = attack(straight(0, 0, 16), eased(cut_in(4.3, 8)))
    assert measured("avoidable", near, near_case).value == 0.0
    assert measured("avoided_by_search", near, near_case).value == 1.0
    assert (
        measured("finding", near, near_case).value == 0.0
    )  # steering without delay alone avoids it


def test_an_opponent_beyond_the_limits_makes_no_finding():
    """It jumps into the AV's way, far ahead, as no car can."""
    jumping = straight(80, 3.5, 0)
    jumping[30:, 1] = 0.0
    rollout, case = attack(straight(0, 0, 12), jumping)
    assert measured("avoidable", rollout, case).value == 1.0
    assert measured("feasible", rollout, case).value == 0.0
    assert measured("finding", rollout, case).value == 0.0


def test_leaving_the_road_makes_no_finding_but_coming_from_a_driveway_does_not_matter():
    seconds = np.maximum(np.arange(91) - 10, 0) * 0.1
    from_driveway = straight(90, 0, 0)
    from_driveway[:, 1] = np.minimum(-8 + 2.0 * seconds, 0.0)
    rollout, case = attack(straight(0, 0, 12), from_driveway)
    assert measured("avoidable", rollout, case).value == 1.0
    feasible = replace(rollout, driver=np.full(rollout.driver.shape, Driver.LOG))
    assert measured("finding", feasible, case).value == 1.0
    detour = straight(90, 0, 0)
    detour[:, 1] = np.interp(seconds, [0, 2.5, 5.0], [0.0, -4.0, 0.0])
    rollout, case = attack(straight(0, 0, 12), eased(detour))
    assert measured("avoidable", rollout, case).value == 1.0
    assert measured("feasible", rollout, case).value == 1.0
    assert measured("finding", rollout, case).value == 0.0
