"""The AV changed one thing at a time: braking distances and gaps known by hand."""

import numpy as np
import pytest

from deepmf_sumo.judge.avoidability.manoeuvres import COMFORTABLE_MPS2, Drive

DT = 0.1
STEPS = 101


def driven(speed, braking=0.0, begin=20, contact=40, onset=10):
    """At a speed, from a step on with a deceleration; the contact ends what was driven."""
    seconds = np.maximum(np.arange(STEPS) - begin, 0) * DT
    seconds = np.minimum(seconds, speed / braking if braking else np.inf)
    braked = braking * seconds**2 / 2 if braking else 0.0
    until = np.minimum(np.arange(STEPS), begin) * DT
    along = speed * (until + seconds) - braked
    step_m = along[contact] - along[contact - 1]
    along[contact:] = along[contact] + step_m * np.arange(STEPS - contact)
    return Drive(along_m=along, onset=onset, contact=contact, dt_s=DT)


def test_the_reaction_is_the_first_braking_since_the_onset():
    drive = driven(15, 4.0)
    assert drive.reaction in {20, 21}
    assert drive.braking_mps2 == pytest.approx(4.0, abs=0.01)
    assert driven(15).reaction is None
    assert driven(15).braking_mps2 == 0
    assert driven(15, 0.8).reaction is None  # a foot off the accelerator
    assert driven(15, 4.0, begin=5, onset=10).reaction == 10  # it braked before the onset


def test_after_the_contact_it_goes_on_as_at_the_contact():
    """It stops after v^2/2a, although the contact came first, or keeps its speed."""
    assert driven(10, 2.5).farther_back(0.0)[-1] == pytest.approx(20 + 100 / 5, abs=0.1)
    assert driven(10).farther_back(0.0)[-1] == pytest.approx(100)


@pytest.mark.parametrize("by_s", [0.5, 1.0])
def test_an_earlier_reaction_saves_the_way_of_that_time(by_s):
    drive = driven(10, 2.5, contact=40, onset=5)
    earlier = drive.reacting_earlier(by_s)
    assert earlier[-1] == pytest.approx(20 + 20 - 10 * by_s, abs=0.1)
    assert earlier[20 - round(by_s / DT)] == pytest.approx(drive.along_m[20 - round(by_s / DT)])
    assert (np.diff(earlier) >= 0).all()


def test_no_reaction_is_earlier_than_the_onset():
    assert driven(10, 2.5, onset=18).reacting_earlier(0.5) is None
    assert driven(10, 2.5, onset=15).reacting_earlier(0.5) is not None
    assert driven(10).reacting_earlier(0.5) is None


@pytest.mark.parametrize("hardest", [4.0, 6.0, 8.0])
def test_harder_braking_stops_after_v2_over_2a(hardest):
    harder = driven(15, 2.0).braking_harder(hardest)
    assert harder[-1] == pytest.approx(30 + 15**2 / (2 * hardest), abs=0.1)
    assert harder[20] == pytest.approx(30)
    assert driven(15, 7.0).braking_harder(6.0) is None
    assert driven(15).braking_harder(6.0) is None


def released(slowest, contact=50):
    """From 10 m/s it brakes with 2 m/s2 to a speed, then accelerates with 2 m/s2."""
    steps = round((10 - slowest) / 2 / DT)
    speed = np.concatenate(
        [np.full(10, 10.0), 10 - 0.2 * np.arange(1, steps + 1),
         slowest + 0.2 * np.arange(1, STEPS - 10 - steps)]
    )  # fmt: skip
    along = np.concatenate([[0.0], np.cumsum(speed) * DT])[:STEPS]
    along[contact:] = along[contact] + speed[contact - 1] * DT * np.arange(STEPS - contact)
    return Drive(along_m=along, onset=5, contact=contact, dt_s=DT), 10 + steps


def test_an_av_that_brakes_on_stops_from_where_it_accelerated_again():
    drive, release = released(6.0)
    assert drive.release == release - 1
    stop = drive.along_m[release] + 6**2 / (2 * 2)
    assert drive.braking_on()[-1] == pytest.approx(stop, abs=0.4)
    assert driven(10, 2.5).braking_on() is None
    assert driven(10).braking_on() is None
    assert released(0.0, 80)[0].braking_on() is None  # it had stopped, and set off


def test_an_av_that_never_braked_stops_like_the_careful_driver():
    """0.75 s at 10 m/s, a ramp of 0.6 s at 12.65 m/s3, then 7.59 m/s2."""
    ramp_m, after_mps = 10 * 0.6 - 12.65 * 0.6**3 / 6, 10 - 12.65 * 0.6**2 / 2
    stop = 10 + 7.5 + ramp_m + after_mps**2 / (2 * 7.593)
    assert driven(10).reacting()[-1] == pytest.approx(stop, abs=0.1)
    assert driven(10, 3.0).reacting() is None


def test_slower_begins_at_the_onset_and_brakes_as_it_did():
    drive = driven(10, 2.5)
    slower = drive.slower(0.8)
    assert slower[:11] == pytest.approx(drive.along_m[:11])
    assert slower[20] == pytest.approx(10 + 8)
    assert slower[-1] == pytest.approx(18 + 8**2 / (2 * 2.5), abs=0.1)
    assert driven(0.5).slower(0.8) is None


def test_not_braking_keeps_the_speed_of_before():
    drive = driven(10, 2.5)
    assert drive.not_braking(drive.reaction) == pytest.approx(driven(10).along_m, abs=0.1)


def test_a_planned_stop_is_comfortable_and_as_late_as_possible():
    """From 10 m/s it takes 100 / 7 = 14.3 m."""
    drive = driven(10)
    stop = drive.stopping_before(30.0)
    assert stop[-1] == pytest.approx(30)
    assert stop[15] == pytest.approx(15)  # the last step with 14.3 m left
    assert stop[16] < 16
    assert -np.diff(stop, 2).min() / DT**2 <= COMFORTABLE_MPS2 + 1e-6
    assert drive.stopping_before(14.0) is None
    assert drive.stopping_before(30.0, first=16) is None


def test_an_av_that_stands_waits_where_it_is():
    stood = Drive(along_m=np.maximum(np.arange(STEPS) - 30, 0) * 0.5, onset=10, contact=50, dt_s=DT)
    assert stood.stopping_before(0.4)[-1] == pytest.approx(0.0, abs=0.4)
