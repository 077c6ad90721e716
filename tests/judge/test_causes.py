"""The smallest change that avoids a hit, on situations where arithmetic says what is enough."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge import causes
from deepmf_sumo.judge.avoidability import reference_drivers
from deepmf_sumo.judge.avoidability.encounter import encounter_of
from deepmf_sumo.judge.causes import cause_of
from deepmf_sumo.judge.hits import hit_of
from deepmf_sumo.judge.ladder import _av_error
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.scene import Lane, RoadMap, SignalState
from deepmf_sumo.scene.scene import Neighbour

from tests.support.drawn_attacks import NOW, STEPS, attack, cut_in
from tests.support.rollout_doubles import in_traffic, straight

LENGTH = 4.8
SECONDS = (np.arange(STEPS) - NOW) * 0.1


def braking(speed, deceleration, after_s, x=0.0):
    """(91, 3) at a speed, then, so many seconds after now, with a deceleration to a stop."""
    since = np.clip(SECONDS - after_s, 0, speed / deceleration)
    along = x + speed * (np.minimum(SECONDS, after_s) + since) - deceleration * since**2 / 2
    return np.stack([along, np.zeros(STEPS), np.zeros(STEPS)], -1)


def standing(gap_m):
    """So far ahead of an AV that is at 0 now; it is a danger at 3 s to the contact."""
    return straight(gap_m + LENGTH, 0, 0)


def cause(av, opponent, **more):
    return cause_of(Episode(*attack(av, opponent, **more)))


def test_braking_that_is_too_weak_is_the_cause():
    """15 m/s, 30 m to a standing car: v^2/2a needs 3.75 m/s2 (with 2 it takes 56 m)."""
    found = cause(braking(15, 2, 1.0), standing(45))
    assert found.change == "brakes harder"
    assert found.what == "to brake with 4 m/s2 instead of 2"
    assert not found.changes["reacts 0.5 s earlier"]
    assert cause(braking(15, 2, 1.5), standing(45)).what.startswith(
        "to brake with 6 m/s2"
    )  # 22.5 m: 5
    assert cause(braking(15, 2, 2.0), standing(45)).what.startswith(
        "to brake with 8 m/s2"
    )  # 15 m: 7.5


@pytest.mark.parametrize(
    ("gap_m", "change"), [(22.5, "reacts 0.5 s earlier"), (16, "reacts 1 s earlier")]
)
def test_late_braking_is_the_cause(gap_m, change):
    """With 4 m/s2 it takes 28.1 m from 15 m/s; 0.5 s are 7.5 m, and 1 s is 15 m."""
    found = cause(braking(15, 4, (60 - gap_m) / 15), standing(60))
    assert found.change == change
    assert found.what == f"to {change.replace('s', '', 1)}"
    assert found.changes["drives 20 % slower"]  # 12 m/s, from 45 m on


def test_no_reaction_sooner_than_a_drivers_is_asked_for_while_braking_harder_is_enough():
    """It brakes 28.5 m before, 1.1 s after the onset: 0.5 s earlier is sooner than 0.75 s."""
    found = cause(braking(15, 3.8, (60 - 28.5) / 15), standing(60))
    assert found.changes["reacts 0.5 s earlier"]
    assert found.what == "to brake with 6 m/s2 instead of 4"


def test_who_accelerates_again_would_have_had_to_brake_on():
    """It brakes from 15 to 9 m/s with 4 m/s2, 30 m before, and then keeps on accelerating."""
    speed = np.full(STEPS, 15.0)
    speed[30:45] = 15 - 0.4 * np.arange(1, 16)
    speed[45:] = 9 + 0.2 * np.arange(1, STEPS - 44)
    along = np.concatenate([[0.0], np.cumsum(speed[:-1]) * 0.1])
    av = np.stack([along - along[NOW], np.zeros(STEPS), np.zeros(STEPS)], -1)
    found = cause(av, standing(62))
    assert (found.change, found.what) == ("brakes on", "to go on braking")
    # what moves over only later is no reason to go on
    late = straight(62 + LENGTH, 4.0, 0)
    late[:, 1] = np.where(np.arange(STEPS) < 55, 4.0, 1.5)
    log = straight(62 + LENGTH, 5.0, 0)  # that it is elsewhere shows from the start
    assert "brakes on" not in cause(av, late, log=log).changes


def test_what_drives_beside_is_no_leader():
    """A vehicle that cuts in is not followed when the danger shows."""
    av, log = straight(0, 0, 16), straight(8.3 + LENGTH, 3.5, 8)
    assert "keeps its distance" not in cause(av, cut_in(8.3, 8), log=log).changes


def test_an_av_that_did_not_brake_would_have_had_to():
    found = cause(straight(0, 0, 15), standing(60))
    assert found.change == "reacts"
    assert "brakes harder" not in found.changes
    assert "reacts 0.5 s earlier" not in found.changes


def test_who_follows_too_close_would_have_had_to_keep_its_distance():
    """Both brake from 20 m/s, with 7 and 0.9 s later with 6: that takes 18 m + 4.8 m of gap."""
    leader, av = braking(20, 7, 0.0, x=12 + LENGTH), braking(20, 6, 0.9)
    log = straight(12 + LENGTH, 0, 20)
    found = cause(av, leader, log=log)
    assert found.change == "keeps its distance"
    assert found.what == "to keep a time gap of 2 s (it kept 0.6 s)"
    far = cause(av, leader + np.array([10.0, 0, 0]), log=log + np.array([10.0, 0, 0]))
    assert far.changes["keeps its distance"]  # 1.1 s are what drivers keep
    assert far.change == "reacts 0.5 s earlier"
    # 2.2 s later it takes 44 m + 4.8 m, more than the 40 m of 2 s
    assert not cause(braking(20, 6, 2.2), leader, log=log).changes["keeps its distance"]
    assert "keeps its distance" not in cause(braking(15, 2, 1.0), standing(45)).changes


def crossing(gives_way):
    """Roads that cross at 60 m; the opponent comes from the left, and the AV has to wait."""
    east = Lane(
        id="east", kind="street", centre_m=np.array([[-50.0, 0], [200, 0]]), z_m=np.zeros(2),
        gives_way_to=("south",) if gives_way else (),
    )  # fmt: skip
    south = Lane(
        id="south", kind="street", centre_m=np.array([[60.0, 150], [60, -150]]), z_m=np.zeros(2)
    )
    return RoadMap(lanes={"east": east, "south": south})


def test_who_moves_over_would_have_had_to_stay_in_its_lane():
    """The AV moves into the lane of a vehicle beside it, 3.5 m to the left, within 2 s."""
    av, beside = straight(0, 0, 15), straight(1.0, 3.5, 15)
    av[:, 1] = 3.5 * np.clip((SECONDS - 2.0) / 2.0, 0, 1)
    ends = {"self_start": 0, "self_end": 1, "other_start": 0, "other_end": 1}
    right, left = (
        Lane(id=name, kind="street", centre_m=np.array([[-50.0, y], [300, y]]), z_m=np.zeros(2))
        for name, y in (("right", 0.0), ("left", 3.5))
    )
    right = replace(right, left=(Neighbour(lane_id="left", **ends),))
    left = replace(left, right=(Neighbour(lane_id="right", **ends),))
    road = RoadMap(lanes={"right": right, "left": left})
    found = cause(av, beside, road=road)
    assert (found.change, found.what) == ("stays in its lane", "to stay in its lane")
    ahead = {"c": straight(5 + LENGTH, 0, 2)}  # a vehicle that it would have driven into
    assert not cause(av, beside, others=ahead, road=road).changes["stays in its lane"]


def test_who_takes_priority_would_have_had_to_wait():
    av, opponent = straight(0, 0, 12), straight(60, 50, 10, heading=-np.pi / 2)
    found = cause(av, opponent, road=crossing(gives_way=True))
    assert found.change == "waits for the gap"
    assert found.what == "to wait for the gap"
    assert "waits for the gap" not in cause(av, opponent, road=crossing(gives_way=False)).changes


def test_who_turns_across_would_have_had_to_wait_for_who_leaves_its_lane_too():
    """As the ladder says, whose error it is then."""
    av, opponent = straight(0, 0, 10), straight(60, 60, 10, heading=-np.pi / 2)
    episode = Episode(*attack(av, opponent, road=crossing(gives_way=False)))
    hit = replace(hit_of(episode), conflict="left turn across path", strayed=True, priority="")
    for turned, error, waits in (("AV", "took_priority", True), ("opponent", "", False)):
        one = replace(hit, turned=turned)
        tried = {
            found.change
            for found in causes._tried(
                episode, encounter_of(*attack(av, opponent, road=crossing(gives_way=False))), one
            )
        }
        assert (_av_error(episode, one), "waits for the gap" in tried) == (error, waits)


def test_an_av_that_waits_does_not_touch_what_passes():
    """It stops 1 m before the way of the opponent, which is 2 m wide: 60 - 1 - 2.4 - 1 m."""
    av, opponent = straight(0, 0, 12), straight(60, 50, 10, heading=-np.pi / 2)
    episode = Episode(*attack(av, opponent, road=crossing(gives_way=True)))
    encounter = encounter_of(episode.rollout, episode.case)
    tried = causes._tried(episode, encounter, causes.hit_of(episode))
    (wait,) = [one for one in tried if one.change == "waits for the gap"]
    assert wait.along_m[-1] == pytest.approx(60 - 1 - 2.4 - 1, abs=0.3)


def test_a_wait_that_needs_a_hard_stop_is_none():
    """From 12 m/s a comfortable stop takes 21 m; the AV is there when the attack begins."""
    av, opponent = straight(40, 0, 12), straight(60, 15, 10, heading=-np.pi / 2)
    found = cause(av, opponent, road=crossing(gives_way=True))
    assert "waits for the gap" not in found.changes


def test_an_av_in_the_way_of_what_it_waits_for_has_not_waited():
    """The opponent turns into the AV's lane and comes on: waiting there is of no use."""
    turn = straight(60, 50, 10, heading=-np.pi / 2)
    after = turn[:, 1] < 0
    turn[after] = np.stack(
        [60 + turn[after, 1], 0 * turn[after, 1], 0 * turn[after, 1] + np.pi], -1
    )
    found = cause(straight(0, 0, 12), turn, road=crossing(gives_way=True))
    assert not found.changes.get("waits for the gap", False)


@pytest.mark.parametrize(
    ("yellow_s", "red_s", "applies"), [(1.0, 9.0, True), (9.0, 9.0, False), (3.2, 9.0, False)]
)
def test_who_drives_on_at_yellow_would_have_had_to_stop(yellow_s, red_s, applies):
    """The stop line is 45 m ahead, the front 2.4 m; 12 m/s are 3.5 s, and a stop takes 21 m."""
    road = crossing(gives_way=False)
    lane = replace(road.lanes["east"], centre_m=np.array([[45.0, 0], [200, 0]]))
    before = replace(lane, id="before", centre_m=np.array([[-50.0, 0], [45, 0]]))
    road = RoadMap(lanes={**road.lanes, "east": lane, "before": before})
    av, opponent = straight(0, 0, 12), straight(60, 50, 10, heading=-np.pi / 2)
    rollout, case = attack(av, opponent, road=road)
    case = in_traffic(case)
    seconds = np.arange(rollout.tracks.steps - 1 - NOW) * 0.1
    states = [
        SignalState.GO if at < yellow_s else SignalState.CAUTION if at < red_s else SignalState.STOP
        for at in seconds
    ]
    rollout = replace(rollout, signals=tuple({"east": state} for state in states))
    found = cause_of(Episode(rollout, case))
    assert found.changes.get("stops at the light", False) is applies
    assert (found.what == "to stop at the light") is applies


def test_who_drives_over_the_limit_would_have_had_to_keep_to_it():
    """From 45 m on with 4 m/s2, 1.5 s later: from 18 m/s it takes 67 m, from 15 m/s 50 m."""
    lane = Lane(
        id="a", kind="street", centre_m=np.array([[-50.0, 0], [200, 0]]), z_m=np.zeros(2),
        speed_limit_mps=13.0,
    )  # fmt: skip
    av, road = braking(18, 4, 1.0), RoadMap(lanes={"a": lane})
    found = cause(av, standing(54), road=road)
    assert found.change == "keeps to the limit"
    assert found.what == "to keep to the limit of 13.0 m/s (it drove at 18.0 m/s)"
    faster = RoadMap(lanes={"a": replace(lane, speed_limit_mps=17.5)})
    assert "keeps to the limit" not in cause(av, standing(54), road=faster).changes


def test_braking_for_nothing_is_the_cause_of_a_hit_from_behind():
    av, behind = braking(15, 5, 1.0), straight(-12, 0, 15)
    found = cause(av, behind)
    assert (found.change, found.what) == ("does not brake", "not to brake")
    leader = {"c": straight(28, 0, 0)}
    assert not cause(av, behind, others=leader).changes["does not brake"]  # it braked for that


def test_a_change_must_not_hit_a_third_party():
    """Stopping earlier puts the AV into the way of a vehicle that crosses there."""
    av, opponent = braking(15, 4, 2.5), standing(60)
    assert cause(av, opponent).changes["reacts 0.5 s earlier"]
    across = straight(54, 40, 10, heading=-np.pi / 2)
    found = cause(av, opponent, others={"c": across})
    assert not found.changes["reacts 0.5 s earlier"]


def test_a_contact_within_4_s_afterwards_counts():
    """The AV that reacts earlier stops in the way of the opponent, which comes on slowly."""
    opponent = straight(60, 0, 6, heading=np.pi)
    found = cause(braking(15, 4, 1.0), opponent)
    assert found.changes.pop("evades")  # it swerves
    assert found.change == "evades"
    assert not any(found.changes.values())


def test_the_last_moment_is_the_last_of_all_takeovers():
    """Twin: each driver takes over at each step alone."""
    episode = Episode(*attack(straight(0, 0, 15), standing(60)))
    found, encounter = cause_of(episode), encounter_of(episode.rollout, episode.case)
    for name, model in reference_drivers.MODELS.items():
        avoids = [
            reference_drivers.outcome(
                [model], encounter.path, encounter.approach, encounter.av_along_m, start
            ).avoided[0, 0]
            for start in range(encounter.contact)
        ]
        last = max(np.flatnonzero(avoids), default=None)
        expected = None if last is None else round((encounter.contact - last) * 0.1, 3)
        assert found.last_moment_s[name] == expected
    # 15 m/s with 8 m/s2: 14.1 m are 0.94 s; beside 2 s with 3.5 m and 6 m/s2 across: less
    assert 0.5 < found.last_moment_s["search"] <= 1.1


def test_a_miss_has_no_cause():
    assert cause(straight(0, 0, 10), straight(100, 0, 20)) is None


def test_the_order_is_that_of_the_strength():
    """Rules of the road before reactions, milder braking before harder, a slower AV last."""
    episode = Episode(*attack(braking(15, 2, 1.5), standing(45)))
    hit = causes.hit_of(episode)
    tried = causes._tried(episode, encounter_of(episode.rollout, episode.case), hit)
    assert [one.place for one in tried] == sorted(one.place for one in tried)
    assert tried[-1].change == "drives 20 % slower"
