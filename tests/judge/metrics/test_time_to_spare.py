"""What time the AV's encounters left."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics import encounters

from tests.support.rollout_doubles import case_of, rollout_of, straight

NORTH = np.pi / 2


def measured(paths, **more):
    rollout = rollout_of(paths, **more)
    return plugins.load("metrics", "time_to_spare").measure(rollout, case_of())


def changing(x, speed, begin, steps=91):
    """Eastwards beside the AV's lane, and into it from a step on, within 2 s."""
    path = straight(x, 3.5, speed)[:steps].copy()
    share = np.clip((np.arange(len(path)) - begin) / 20, 0.0, 1.0)
    path[:, 1] = 3.5 * (1 - share)
    return path


@pytest.mark.parametrize("after_s", [1.0, 2.5, -1.5])
def test_of_crossing_ways_the_time_between_leaving_and_coming(after_s):
    av, other = straight(-30, 0, 10), straight(0, -30 - 10 * after_s, 10, heading=NORTH)
    # both boxes are 4.8 by 2: one leaves 3.4 m behind the middle, the other comes 3.4 m before it
    spare = measured({"av": av, "b": other}).value
    assert spare == pytest.approx(abs(after_s) - 0.68, abs=0.11)


def test_minutes_of_two_vehicles_fit_into_memory():
    step = np.arange(2000)
    ways = []
    for x, y in ((0.0, 0.0), (-30.0, 3.5)):
        place = np.column_stack([x + step, np.full(len(step), y)])
        size, fixed = np.array([4.8, 2.0]), np.full(len(step), 10.0)
        ways.append(encounters.Trip(step, place, 0.0 * fixed, fixed, size))
    tracemalloc.start()
    try:
        assert encounters.encounter_s(*ways, 0.1) == np.inf
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_others_than_the_opponent_count_too():
    paths = {"av": straight(-30, 0, 10), "b": straight(-60, 0, 10)}
    assert "crossed or joined" in measured(paths).reason
    paths["c"] = straight(0, -50, 10, heading=NORTH)
    assert measured(paths).value == pytest.approx(2.0 - 0.68, abs=0.11)


def test_trams_count_and_bicycles_do_not():
    paths = {"av": straight(-30, 0, 10), "b": straight(-60, 0, 10)}
    paths["c"] = straight(0, -50, 10, heading=NORTH)
    rollout, metric = rollout_of(paths), plugins.load("metrics", "time_to_spare")
    for kind, counts in (("vehicle", True), ("other", True), ("cyclist", False)):
        tracks = replace(rollout.tracks, kinds=("vehicle", "vehicle", kind))
        found = metric.measure(replace(rollout, tracks=tracks), case_of())
        assert (found.value is not None) == counts


def test_following_is_no_encounter():
    assert measured({"av": straight(0, 0, 10), "b": straight(60, 0, 5)}).value is None
    # also far ahead, where neither comes to where the other was
    assert measured({"av": straight(0, 0, 12), "b": straight(138, 0, 10)}).value is None
    assert measured({"av": straight(0, 0, 30), "b": straight(230, 0, 25)}).value is None
    turn = np.arange(105) / 30  # on a circle of 30 m at 10 m/s
    bend = np.column_stack([30 * np.sin(turn), 30 * (1 - np.cos(turn)), turn])
    assert measured({"av": bend[:91], "b": bend[12:103]}).value is None


def test_a_change_of_lanes_before_the_av_is_judged_by_the_time_to_collision():
    paths = {"av": straight(0, 0, 12), "b": changing(40, 8, 20)}
    found = measured({key: path[:60] for key, path in paths.items()})
    # from where it is in the way: 4 m/s faster, 35.2 m between the boxes at the beginning
    assert found.value == pytest.approx((35.2 - 4 * 4.9) / 4, abs=0.3)
    faster = {"av": straight(0, 0, 8), "b": changing(40, 12, 20)}
    assert measured(faster).value is None


def test_who_passes_beside_the_av_does_not_join_it_however_the_av_stands():
    """A standing AV that points a little sideways, as before a turn."""
    stands = straight(0, 3.5, 0.0)
    stands[:, 2] = np.linspace(0.0, 0.2, len(stands))
    assert measured({"av": stands, "b": straight(-60, 0, 8)}).value is None


def test_contact_leaves_nothing():
    paths = {"av": straight(-30, 0, 10), "b": straight(0, -30, 10, heading=NORTH)}
    assert measured(paths).value == 0.0


def test_a_sideswipe_and_a_contact_head_on_leave_nothing_either():
    beside = straight(0, 3.5, 10)[:40]
    beside[:, 1] -= 0.06 * np.arange(40)  # until corners touch
    beside[:, 2] = -0.3
    assert measured({"av": straight(0, 0, 10)[:27], "b": beside[:27]}).value == 0.0
    head_on = straight(62, 3.0, 10, heading=np.pi)[:41]
    head_on[:, 1] = np.linspace(3.0, 1.9, 41)
    assert measured({"av": straight(0, 0, 10)[:41], "b": head_on}).value == 0.0


def test_a_ram_from_behind_in_the_lane_is_no_encounter():
    paths = {"av": straight(0, 0, 5)[:41], "b": straight(-20, 0, 10)[:41]}
    assert measured(paths).value is None


def test_nobody_attacked_is_a_reason():
    assert (
        measured({"av": straight(0, 0, 10)}, opponent_id=None).reason == "no vehicle was attacked"
    )
