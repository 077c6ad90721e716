"""What constraints mean for people: the law, the road, the side of the road."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.candidates import (
    Candidates,
    against_traffic,
    leaves_road,
    off_front,
    off_road,
)
from deepmf_sumo.deepmf.constraints import fair_candidates
from deepmf_sumo.deepmf.traffic_rules import TrafficRules
from deepmf_sumo.judge.avoidability.intention import intends_since
from deepmf_sumo.scene import Forecast, Futures, Lane, RoadMap
from deepmf_sumo.scene.geometry import boxes

from tests.deepmf.test_off_lane_paths import ahead, situation_of
from tests.support.one_attacker import plan_of
from tests.support.people_views import people_policy, people_view
from tests.support.predictor_doubles import STEPS, straight_road

UP = np.pi / 2


def own_of(*ways, heading=UP):
    """Candidates along positions (F, 2)."""
    position = np.stack(ways)
    count = len(position)
    futures = Futures(agent_id="p", position_m=position, heading_rad=np.full((count, 80), heading))
    return Candidates(
        forecast=Forecast(futures=futures, probability=np.full(count, 1 / count)),
        speed_mps=np.ones((count, 80)),
        bent_m=np.zeros(count),
        origin=("mode",) * count,
    )


def across(x, begin, speed=1.4, y=-2.0):
    """Over the road from (x, y) from a second on."""
    return np.stack([np.full(80, x), y + speed * np.maximum(STEPS - begin, 0.0)], -1)


def lawful(situation, own):
    steps = np.full((len(own.origin), 1), 80.0)
    return TrafficRules().lawful(situation, own, steps).tolist()


def test_a_pedestrian_steps_out_only_where_the_av_can_still_stop():
    """At 10 m/s it needs 10 m + 10 m: its front must be 20 m before the pedestrian's box.

    From x = 50 with half-lengths of 2.4 m and 0.3 m that holds until 2.73 s, when the box comes
    within 0.3 m of the way: 0.29 s after it has set off from 2 m beside the middle.
    """
    situation = situation_of(("pedestrian", 50, -2.0, UP, 0.0))
    begins = [0.0, 1.5, 2.2, 3.0, 4.0]
    found = lawful(situation, own_of(*(across(50.0, begin) for begin in begins)))
    assert found == [True, True, True, False, False]


def test_behind_the_av_nobody_steps_out():
    situation = situation_of(("pedestrian", 50, -2.0, UP, 0.0))
    assert lawful(situation, own_of(across(50.0, 6.5), across(50.0, 4.8))) == [True, False]


def test_who_is_on_the_way_already_has_not_stepped_out():
    situation = situation_of(("pedestrian", 12, 0.0, UP, 0.0))
    stays = np.tile([12.0, 0.0], (80, 1))
    assert lawful(situation, own_of(stays)) == [True]


def test_a_slower_av_can_stop_where_a_faster_one_cannot():
    step = own_of(across(30.0, 0.0))
    found = [
        lawful(situation_of(("pedestrian", 30, -2.0, UP, 0.0), ahead(speed)), step)[0]
        for speed in (8.0, 14.0)
    ]
    assert found == [True, False]


def test_one_unlikely_future_of_the_av_forbids_nothing():
    slow, fast = ahead(8.0), ahead(14.0)
    for chance, allowed in ((0.05, True), (0.3, False)):
        both = Forecast(
            futures=Futures(
                agent_id="av",
                position_m=np.concatenate([slow.futures.position_m, fast.futures.position_m]),
                heading_rad=np.zeros((2, 80)),
            ),
            probability=np.array([1 - chance, chance]),
        )
        situation = situation_of(("pedestrian", 30, -2.0, UP, 0.0), both)
        assert lawful(situation, own_of(across(30.0, 0.0))) == [allowed]


def test_a_cyclist_beside_the_lanes_obeys_the_same():
    """From 6 m beside the road, where no lane is."""
    situation = situation_of(("cyclist", 50, -6.0, UP, 4.0))
    found = lawful(situation, own_of(across(50.0, 0.0, 4.0, -6.0), across(50.0, 2.6, 4.0, -6.0)))
    assert found == [True, False]


def test_a_pedestrian_is_never_off_the_road_but_meets_the_av_on_it():
    situation = situation_of(("pedestrian", 50, -4.0, UP, 0.0))
    own = own_of(across(50.0, 0.0, y=-4.0))
    assert not off_road(situation, own.forecast.futures.position_m).any()
    met = [leaves_road(situation, own, np.array([float(step)]))[0] for step in (5, 40, 80)]
    assert met == [True, False, False]  # at the kerb; on the lane; not at all


def test_a_cycle_lane_is_road_to_a_cyclist_alone():
    points = np.stack([np.linspace(-100.0, 300.0, 81), np.full(81, -3.2)], -1)
    lane = Lane(id="b", kind="bike", centre_m=points, z_m=np.zeros(81), width_m=1.5)
    road = RoadMap(lanes={**straight_road().lanes, "b": lane})
    rides = np.stack([10 + 4 * STEPS, np.maximum(-1.0 - STEPS, -3.2)], -1)
    own = own_of(rides, heading=0.0)
    for kind, leaves in (("cyclist", False), ("vehicle", True)):
        view = people_view(
            {"av": ("vehicle", 0, 0, 0, 10.0), "p": (kind, 10, -1.0, 0, 4.0)}, road=road
        )
        situation = replace(situation_of(("cyclist", 10, -1.0, 0, 4.0)), view=view, kind=kind)
        assert bool(leaves_road(situation, own, np.array([80.0]))[0]) == leaves


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_only_those_with_wheels_keep_to_a_side(towards):
    """The lane runs along x: a pedestrian goes along it in neither direction, a cyclist in its."""
    along = np.stack([60.0 + towards * 1.4 * STEPS, np.zeros(80)], -1)
    heading = 0.0 if towards > 0 else np.pi
    for kind, wrong in (("pedestrian", True), ("cyclist", towards < 0)):
        situation = situation_of((kind, 60, 0.0, heading, 1.4))
        own = own_of(along, heading=heading)
        assert bool(against_traffic(situation, own, np.array([80.0]))[0]) == wrong


@pytest.mark.parametrize(
    ("turn", "speed", "until", "wrong"),
    [
        (0.0, 1.4, 80.0, True),
        (0.0, 1.4, 15.0, False),  # not for long enough
        (0.0, 0.0, 80.0, False),  # stands
        (np.radians(25), 0.3, 80.0, False),
        (np.radians(25), 1.4, 80.0, True),
        (np.radians(35), 1.4, 80.0, False),  # crosses at an angle
        (UP, 1.4, 80.0, False),
    ],
)
def test_a_pedestrian_crosses_and_does_not_walk_along_a_lane(turn, speed, until, wrong):
    situation = situation_of(("pedestrian", 60, 0.0, turn, speed))
    way = np.array([60.0, -1.0]) + speed * STEPS[:, None] * [np.cos(turn), np.sin(turn)]
    own = replace(own_of(way, heading=turn), speed_mps=np.full((1, 80), speed))
    assert bool(against_traffic(situation, own, np.array([until]))[0]) == wrong


def test_beside_the_road_a_pedestrian_walks_where_it_likes():
    way = np.stack([60.0 + 1.4 * STEPS, np.full(80, -4.0)], -1)
    situation = situation_of(("pedestrian", 60, -4.0, 0.0, 1.4))
    assert not against_traffic(situation, own_of(way, heading=0.0), np.array([80.0]))[0]


@pytest.mark.parametrize(
    "constraint", ["fair", "lawful", "on_road", "clean", "no_rear_end", "with_traffic"]
)
@pytest.mark.parametrize("person", [("pedestrian", 45, -4, UP, 1.2), ("cyclist", 25, -3, 0.0, 4.0)])
def test_every_constraint_judges_people(constraint, person):
    view = people_view({"av": ("vehicle", 0, 0, 0, 10.0), "p": person})
    made = people_policy(opponent="p", constraints=[constraint], rule="likeliest")
    made.reset(view, np.random.default_rng(0))
    reason = plan_of(made, view).reason
    assert reason.allowed[constraint].any()
    chosen = reason.chosen
    assert reason.allowed[constraint][chosen] or not reason.collides[chosen].any()


def since_of(*ways, contact=79):
    av_m = ahead(10.0).futures.position_m[0]
    steps = np.full(len(ways), contact)
    return intends_since(straight_road(), np.stack(ways), av_m, steps, 0.1).tolist()


def test_a_walker_shows_its_intention_on_the_road_and_a_runner_before():
    """The road ends 2.25 m beside the middle of its lane: 1.75 m at 1.4 m/s take 1.25 s."""
    walks = np.stack([np.full(80, 50.0), -4.0 + 1.4 * (STEPS - 0.1)], -1)
    runs = np.stack([np.full(80, 50.0), -9.0 + 2.5 * (STEPS - 0.1)], -1)
    along = np.stack([30 + 2.5 * STEPS, np.full(80, -4.0)], -1)
    assert since_of(walks, runs, along, contact=40) == [13, 1, 40]


def test_an_intention_that_is_taken_back_does_not_count():
    y = np.where(STEPS < 1, -1.0, np.where(STEPS < 4, -5.0, -1.0))
    there = np.stack([np.full(80, 50.0), y], -1)
    assert since_of(there) == [39]
    assert since_of(there, contact=8) == [0]


def test_a_step_out_is_fair_only_if_the_driver_for_people_can_still_stop():
    """At 10 m/s: 0.75 s, a ramp of 0.6 s to 7.6 m/s2, and the stop: some 17 m from the first step.

    The box that walks at 1.4 m/s is on the road 0.6 s before it is in the AV's corridor.
    """
    situation = situation_of(("pedestrian", 50, -4.0, UP, 0.0))
    ways = [across(50.0, begin, 1.4, -4.0) for begin in (0.0, 2.9, 3.4)]
    own = own_of(*ways)
    found = fair_candidates(situation, own.forecast.futures, situation.unattacked).tolist()
    assert found == [True, False, True]  # the last one comes after the AV


@pytest.mark.parametrize(
    ("x", "begin", "beside"), [(20.0, 0.9, False), (20.0, 1.35, True), (20.0, 1.5, True)]
)
def test_a_person_that_runs_into_the_side_is_told_from_one_that_the_front_hits(x, begin, beside):
    """At 10 m/s the front is at 20 m after 1.76 s, and the rear after 2.24 s.

    The body of 0.6 m touches the corridor of 2 m after 0.7 m of 2 m, the AV's side then.
    """
    situation = situation_of(("pedestrian", x, -2.0, UP, 0.0))
    own = own_of(across(x, begin, 1.4, -2.0))
    step = np.array([[float(_first_touch(situation, own))]])
    assert step[0, 0] < 80
    found = off_front(
        own.forecast.futures, [ahead(10.0)], situation.size_m, situation.av_size_m, step
    )
    assert bool(found[0, 0]) == beside


def _first_touch(situation, own):
    futures, av = own.forecast.futures, situation.unattacked.futures
    touch = boxes.overlap(
        futures.position_m[0], futures.heading_rad[0], situation.size_m,
        av.position_m[0], av.heading_rad[0], situation.av_size_m,
    )  # fmt: skip
    return touch.argmax() if touch.any() else 80


def plan_under(person, **values):
    """The first plan of a person against the AV of these tests, and its view."""
    view = people_view({"av": ("vehicle", 0, 0, 0, 10.0), "p": person})
    made = people_policy(opponent="p", rule="likeliest", **values)
    made.reset(view, np.random.default_rng(0))
    return plan_of(made, view)


def test_who_may_not_run_into_the_side_is_not_planned_to():
    """Beside the AV it can only reach the side; without the constraint it does."""
    beside = ("pedestrian", 3.0, -1.9, UP, 1.4)
    free = plan_under(beside).reason
    bound = plan_under(beside, constraints=["no_rear_end"]).reason
    assert free.collides[free.chosen].any()
    assert not bound.collides[bound.chosen].any()


@pytest.mark.parametrize(
    ("person", "accel", "fastest"),
    [(("pedestrian", 45, -6, UP, 0.0), 1.6, 3.5), (("cyclist", 60, -6, UP, 0.0), 1.2, 8.3)],
)
def test_a_plan_keeps_to_the_limits_of_its_class_and_to_the_settings(person, accel, fastest):
    for most in (accel, 0.7):
        plan = plan_under(person, accel_mps2=3.5 if most == accel else most)
        speed = np.append(person[4], plan.speed_mps)
        assert np.diff(speed).max() / 0.1 <= most + 1e-6
        assert speed.max() <= fastest
        assert np.diff(speed).max() / 0.1 > 0.4 * most  # it does set off


def test_a_pedestrian_s_modes_are_those_of_people():
    """A car cannot start at a right angle; a person's modes go to all sides."""
    reason = plan_under(("pedestrian", 45, -6, 0.0, 0.0)).reason
    modes = [row for row, origin in enumerate(reason.origin) if origin == "mode"]
    ends = reason.candidates.futures.position_m[modes, -1] - np.array([45, -6])
    assert ends[:, 1].max() > 2.0
    assert np.abs(ends[:, 0][ends[:, 1] > 2.0]).min() < 1.0


def test_a_person_that_walks_into_a_car_that_has_stopped_was_not_hit_by_it():
    """The drivers of vehicles count that as a contact, the one for people does not."""
    situation = situation_of(("pedestrian", 45, 0.0, np.pi, 1.4))
    towards = np.stack([45.0 - 1.4 * STEPS, np.zeros(80)], -1)
    own = own_of(towards, heading=np.pi)
    assert fair_candidates(situation, own.forecast.futures, situation.unattacked)[0]
