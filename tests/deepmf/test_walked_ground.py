"""Candidates of people end where nobody can walk: before a wall, and where the verge is over."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from deepmf_sumo.deepmf import off_lane_paths
from deepmf_sumo.deepmf.candidates import References
from deepmf_sumo.deepmf.opponent import reach_scores
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.scene import Polygon, RoadMap
from deepmf_sumo.scene.road_users import ROAD_USERS

from tests.deepmf.test_off_lane_paths import ahead
from tests.deepmf.test_people_rules import own_of
from tests.support.people_views import people_policy, people_view
from tests.support.predictor_doubles import STEPS, straight_road

UP = np.pi / 2
LIMITS = ROAD_USERS["pedestrian"].motion.planned


def house(low, high):
    ring = shapely.get_coordinates(shapely.box(*low, *high))[:-1]
    return Polygon(id="house", kind="building", points_m=ring, z_m=np.zeros(4))


def street(**more) -> RoadMap:
    """One lane along y = 0, 3.5 m wide, with a verge of 2 m."""
    return replace(straight_road(lanes=1), footways=(), **more)


def situation_at(road_map, *person):
    view = people_view({"av": ("vehicle", 0, 0, 0, 10.0), "p": person}, road=road_map)
    return Situation.of(view, "p", LIMITS, unattacked=ahead())


def to_the(direction_rad, speed, start):
    """(1, 80, 2) straight on."""
    course = np.array([np.cos(direction_rad), np.sin(direction_rad)])
    return np.array(start) + speed * STEPS[None, :, None] * course


def staying(situation, way):
    references = References.of("mode", way, LIMITS.rows(len(way)))
    return off_lane_paths.staying_on_ground(situation, references).position_m


def test_a_reference_stops_where_the_verge_ends():
    """It crosses from y = -3 on; the verge ends at 1.75 m + 2 m."""
    situation = situation_at(street(), "pedestrian", 40, -3, UP, 1.4)
    (way,) = staying(situation, to_the(UP, 1.4, (40, -3)))
    assert 3.2 < way[-1, 1] < 3.75
    assert np.diff(way[:, 1]).min() >= 0.0
    change = np.diff(np.concatenate([[1.4], np.diff(way[:, 1]) / 0.1])) / 0.1
    assert change.min() > -LIMITS.brake - 0.01
    np.testing.assert_allclose(way[:30], to_the(UP, 1.4, (40, -3))[0, :30])


def test_references_on_the_ground_stay_as_they_are():
    situation = situation_at(street(), "pedestrian", 40, -3, 0.0, 1.4)
    along = to_the(0.0, 1.4, (40, -3))
    assert staying(situation, along) is not None
    np.testing.assert_array_equal(staying(situation, along), along)


def test_a_wall_ends_the_way_along_the_verge():
    wall = house((45, -9), (60, -1.75))
    situation = situation_at(street(buildings=(wall,)), "pedestrian", 40, -3, 0.0, 1.4)
    (way,) = staying(situation, to_the(0.0, 1.4, (40, -3)))
    assert 44.0 < way[-1, 0] < 44.75


def test_who_was_put_elsewhere_comes_to_the_road_but_through_no_house():
    wall = house((39, -12), (41, -8))
    situation = situation_at(street(buildings=(wall,)), "pedestrian", 40, -20, UP, 1.4)
    ways = np.concatenate([to_the(UP, 3.2, (40, -20)), to_the(UP, 3.2, (43, -20))])
    off = off_lane_paths.off_ground(situation, ways)
    assert off.any(axis=1).tolist() == [True, True]
    first = off.argmax(axis=1)
    assert ways[0, first[0], 1] == pytest.approx(-12.25, abs=0.35)  # the wall
    assert ways[1, first[1], 1] == pytest.approx(3.75, abs=0.35)  # the verge on the other side


@pytest.mark.parametrize("kind", ["pedestrian", "cyclist"])
def test_no_plan_leads_off_the_ground(kind):
    """All candidates, by shapely."""
    wall = house((30, -9), (60, -2.5))
    ground = shapely.box(-110, -3.75, 310, 3.75).difference(shapely.box(30, -9, 60, -2.5))
    for x, heading, speed in ((29.0, 0.0, 1.4), (45.0, UP, 0.0), (65.0, np.pi, 3.0)):
        y = -2.1 if x == 45.0 else -3.0
        view = people_view(
            {"av": ("vehicle", 0, 0, 0, 10.0), "p": (kind, x, y, heading, speed)},
            road=street(buildings=(wall,)),
        )
        policy = people_policy(attackers="people")
        policy.reset(view, np.random.default_rng(0))
        plan = policy.plan(view)["p"]
        futures = plan.reason.candidates.futures.position_m
        inside = shapely.contains_xy(ground.buffer(0.05), *np.moveaxis(futures, -1, 0))
        assert inside.all()
        assert len(futures) > 5


def test_candidates_that_leave_the_ground_are_none():
    situation = situation_at(street(), "pedestrian", 40, -3, UP, 1.4)
    along, over, far = (
        to_the(course, speed, (40, -3))[0] for course, speed in ((0.0, 1.4), (UP, 1.0), (UP, 2.0))
    )
    own = off_lane_paths.on_ground(situation, own_of(over, along, far))
    np.testing.assert_array_equal(own.forecast.futures.position_m, along[None])
    assert own.forecast.probability.tolist() == [1.0]
    last = off_lane_paths.on_ground(situation, own_of(far, over))  # none stays: who leaves it last
    np.testing.assert_array_equal(last.forecast.futures.position_m, over[None])


def test_who_is_drawn_inside_a_house_does_not_attack():
    """A map may draw a house over a sidewalk; a river under a bridge hides nobody."""
    people = {
        "av": ("vehicle", 0, 0, 0, 10.0),
        "outside": ("pedestrian", 28, -3, UP, 1.4),
        "inside": ("pedestrian", 40, -3, UP, 1.4),
    }
    walls, river = house((35, -9), (60, -2.5)), house((-50, -9), (90, 9))
    for road_map, ids in (
        (street(), ("outside", "inside")),
        (street(buildings=(walls,), water=(river,)), ("outside",)),
    ):
        assert reach_scores(people_view(people, road=road_map), ahead()).ids == ids
