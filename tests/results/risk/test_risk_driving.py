"""Where an AV was and what it did while it was attacked."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.results.risk import driving
from deepmf_sumo.results.risk import places as places_module
from deepmf_sumo.results.risk.elements import BETWEEN, Element
from deepmf_sumo.results.risk.places import Spot
from deepmf_sumo.scene import Lane, RoadMap

from tests.support.rollout_doubles import rollout_of

FOUR_WAY = Path(__file__).resolve().parents[3] / "sumo_nets" / "four_way" / "four_way.net.xml"
STEPS = 51
FLAT = RoadMap(lanes={})
IN_0, IN_1 = (Spot(lane=f"w_in_{number}", edge="w_in") for number in (0, 1))


@pytest.fixture(scope="module")
def places():
    return places_module.read(FOUR_WAY)


def path(speeds_mps, x=0.0, y=0.0, heading=0.0):
    """(T, 3) poses of a vehicle with these speeds."""
    speed = np.broadcast_to(speeds_mps, STEPS).astype(float)
    along = x + np.cumsum(0.1 * speed) - 0.1 * speed[0]
    if heading:
        along = x - (along - x)
    return np.column_stack([along, np.full(STEPS, y), np.full(STEPS, heading)])


def done(places, av, spots=None, began=0, road=FLAT, z_m=(), **others):
    tracks = rollout_of({"av": av, "b": path(0.0, 900.0), **others}).tracks
    if z_m:
        heights = np.repeat(np.array(z_m)[:, None], tracks.steps, axis=1)
        tracks = replace(tracks, z_m=heights)
    spots = spots or [IN_0] * STEPS
    return driving.driven(tracks, 0, spots[began:], began, 0.1, places, road)


RAMP = np.r_[np.zeros(11), np.linspace(0, 10, STEPS - 11)]


@pytest.mark.parametrize(
    ("speeds_mps", "found"),
    [
        (10.0, set()),
        (RAMP[::-1], {"stops"}),
        (RAMP, {"starts"}),
        (0.0, {"stands"}),
        (np.r_[RAMP[25::-1], RAMP[1:26]], {"stops", "starts"}),
        (np.linspace(0.5, 0.0, STEPS), set()),  # it crept
        (np.linspace(10.0, 0.2, STEPS), set()),  # it still rolls
    ],
)
def test_stops_and_starts(places, speeds_mps, found):
    assert done(places, path(speeds_mps)).manoeuvres == found | {"along a road"}


@pytest.mark.parametrize(
    ("gap_m", "y", "heading", "follows"),
    [
        (19.0, 0.0, 0.0, True), (21.0, 0.0, 0.0, False), (19.0, 1.7, 0.0, True),
        (19.0, 2.1, 0.0, False), (-30.0, 0.0, 0.0, False), (4.0, 0.0, 3.1, False),
        (4.0, 0.0, 0.0, True),
    ],
)  # fmt: skip
def test_it_follows_what_is_at_most_two_seconds_ahead_in_its_path(
    places, gap_m, y, heading, follows
):
    """Cars of 4.8 m by 2 m at 10 m/s; the one that faces the AV stands before it."""
    speed = 0.001 if heading else 10.0
    av = path(speed if heading else 10.0)
    found = done(places, av, b=path(speed, gap_m + 4.8, y, heading))
    assert ("follows" in found.manoeuvres) == follows


def test_one_second_behind_another_is_enough_and_less_is_not(places):
    """The other moves into the AV's path in the last steps."""
    for steps, follows in ((10, True), (9, False)):
        other = path(10.0, 15.0, 4.0)
        other[STEPS - steps :, 1] = 0.0
        assert ("follows" in done(places, path(10.0), b=other).manoeuvres) == follows


def test_a_change_of_lane_is_within_an_edge(places):
    changed = [IN_0] * 30 + [IN_1] * 21
    assert done(places, path(10.0), changed).manoeuvres == {"along a road", "lane change"}
    further = [Spot(lane="w_approach_1", edge="w_approach")] * 30 + [IN_0] * 21
    assert done(places, path(10.0), further).manoeuvres == {"along a road"}


@pytest.mark.parametrize(
    ("target", "name"), [("n_out", "left turn"), ("e_out", "straight on"), ("s_out", "right turn")]
)
def test_a_turn_is_that_of_the_movement(places, target, name):
    movement = places.movement("w_in", target)
    over = Spot(lane=movement.lanes[0], junction=movement.junction, movement=movement.id)
    found = done(places, path(10.0), [IN_0] * 30 + [over] * 21)
    assert found.manoeuvres == {name}
    assert found.rules == set(movement.rule.split(" / "))
    assert Element("junction", "traffic light") in found.elements
    assert Element("junction", BETWEEN) in found.elements


def test_a_joint_of_two_roads_is_no_junction(places):
    """There the approach goes on with one more lane."""
    movement = places.movement("w_approach", "w_in")
    over = Spot(lane=movement.lanes[0], junction=movement.junction, movement=movement.id)
    found = done(places, path(10.0), [over] * 5 + [IN_0] * 46)
    assert found.manoeuvres == {"along a road"}
    assert not found.rules
    assert {one.name for one in found.elements if one.subject == "junction"} == {BETWEEN}


def test_a_ramp_merges():
    highway = FOUR_WAY.parents[1] / "highway" / "highway.net.xml"
    places = places_module.read(highway)
    movement = next(one for one in places.movements.values() if one.origin == "on_ramp")
    over = Spot(lane=movement.lanes[0], junction=movement.junction, movement=movement.id)
    assert "merge" in done(places, path(10.0), [over] * STEPS).manoeuvres


def test_traffic_is_counted_around_the_av_at_the_start(places):
    """At 49 and 51 m, and one that comes near only later."""
    near, far = path(10.0, 49.0), path(10.0, 51.0)
    assert done(places, path(10.0), b=near, c=far, d=path(0.0, 60.0)).near == 1
    assert done(places, path(10.0), began=30, b=near, c=far, d=path(0.0, 60.0)).near == 2


@pytest.mark.parametrize(("share", "at_limit"), [(0.91, True), (0.89, False)])
def test_nine_tenths_of_the_limit(places, share, at_limit):
    limit = places.lanes["w_in_0"].speed_mps
    assert done(places, path(share * limit)).at_limit == at_limit


@pytest.mark.parametrize(("z_m", "counts"), [(0.0, True), (8.0, False)])
def test_traffic_on_a_bridge_above_is_not_around_the_av(places, z_m, counts):
    def lane(name, height):
        line = np.array([[-300.0, 0.0], [300.0, 0.0]])
        return Lane(id=name, kind="street", centre_m=line, z_m=np.full(2, height))

    road = RoadMap(lanes={"below": lane("below", 0.0), "above": lane("above", 8.0)})
    found = done(places, path(10.0), road=road, z_m=(0.0, 0.0, z_m), ahead=path(10.0, 15.0))
    assert ("follows" in found.manoeuvres) == counts
    assert found.near == int(counts)
