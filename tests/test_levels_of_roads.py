"""Every look-up of lanes keeps to the level that a vehicle is on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.attacks._episodes import AgentMotion
from deepmf_sumo.baselines import _open_loop as open_loop
from deepmf_sumo.baselines import diffscene
from deepmf_sumo.deepmf import candidates, constraints
from deepmf_sumo.deepmf.lane_assignment import lanes_at
from deepmf_sumo.deepmf.networks.config import VECTOR
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.deepmf.networks.opponent import lane_routes, opponent_features, passes_over
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.judge.avoidability.av_path import keeps_lane, route_ahead
from deepmf_sumo.judge.avoidability.intention import intends_since
from deepmf_sumo.judge.crossings import on_crossing
from deepmf_sumo.judge.metrics.driving import lights_passed
from deepmf_sumo.scene import DT_S, Lane, Plan, Polygon, RoadMap, SignalState, View
from deepmf_sumo.scene.geometry import ground
from deepmf_sumo.scene.geometry import road as roads
from deepmf_sumo.scene.road_users import MotionLimits
from deepmf_sumo.sumo.network import build, conversion, matching
from deepmf_sumo.training.evaluation import forecasts

from tests.support.predictor_doubles import straight_tracks
from tests.support.rollout_doubles import case_of, rollout_of, straight

DECKS = {"below": 0.0, "above": 8.0}


def lane(name, start, end, z):
    points = np.linspace(start, end, 101)
    return Lane(id=name, kind="street", centre_m=points, z_m=np.full(101, float(z)), width_m=3.2)


def road_of(*lanes):
    return RoadMap(lanes={one.id: one for one in lanes})


def stacked(z=DECKS):
    """Both to the east; the upper one half a metre to the left, so that it is the nearer one."""
    return road_of(
        lane("below", (-100, 0), (100, 0), z["below"]),
        lane("above", (-100, 0.5), (100, 0.5), z["above"]),
    )


def crossing(z=DECKS):
    return road_of(
        lane("below", (-100, 0), (100, 0), z["below"]),
        lane("above", (0, -100), (0, 100), z["above"]),
    )


POSE = np.array([0.0, 0.4])


@pytest.mark.parametrize("level", DECKS)
@pytest.mark.parametrize("middle_m", [0.0, 1.2])
def test_lanes_under_a_vehicle(level, middle_m):
    """Heights are those of the road (SUMO), or of the vehicle's middle (recordings)."""
    road, z = stacked(), DECKS[level] + middle_m
    index = road_index(road)
    (foot,) = index.feet(POSE, 0.0, 5.0, 1.0, z)
    assert index.lane_ids[foot.lane] == level
    assert len(index.feet(POSE, 0.0, 5.0, 1.0)) == 2
    assert lanes_at(road, POSE, 0.0, z) == (level,)
    many = np.array([POSE]), np.zeros(1)
    routes = lane_routes(road, *many, np.ones(1), {}, np.array([z]))
    np.testing.assert_allclose(routes.node_z_m, DECKS[level])
    assert road_index(road).on_lanes(*many, 2.0, 0.5, np.array([z])).all()
    found = matching.match(road, *many, np.ones(1, bool), np.array([z]))
    assert found.lane_ids == (level,)


def test_a_map_whose_heights_count_from_elsewhere_has_its_lanes_all_the_same():
    road = stacked({"below": 100.0, "above": 108.0})
    assert len(road_index(road).feet(POSE, 0.0, 5.0, 1.0, 0.0)) == 1
    assert lanes_at(road, POSE, 0.0, 0.0) == ("below",)


def test_a_lane_of_another_level_is_no_road():
    road = crossing()
    over_the_side = np.array([[20.0, 0.0]])
    assert roads.on_road(road, over_the_side).all()
    assert roads.on_road(road, over_the_side, np.zeros(1)).all()
    assert not roads.on_road(road, over_the_side, np.array([8.8])).any()
    west = np.array([np.pi])
    under = np.array([[0.0, 0.0]])
    assert not roads.against_traffic(road, under, west).any()  # across the bridge's direction
    assert roads.against_traffic(road, under, west, np.zeros(1)).all()
    assert keeps_lane(road, under[0], 0.0, 2.0, 0.0)
    assert not keeps_lane(road, under[0], 0.0, 2.0, 8.0)


@pytest.mark.parametrize("level", DECKS)
def test_the_route_ahead(level):
    elsewhere = {"av": straight(0, 50, 10), "b": straight(-8, 3.5, 12)}
    case = replace(case_of(elsewhere), road=stacked())
    rollout = rollout_of({"av": straight(0, 0.3, 10), "b": straight(-8, 3.5, 12)})
    tracks = replace(rollout.tracks, z_m=np.full(rollout.tracks.z_m.shape, DECKS[level]))
    way = route_ahead(replace(rollout, tracks=tracks), case, 10)
    assert way[0, 1] == {"below": 0.0, "above": 0.5}[level]


def view_of(road, heights):
    """The AV to the east, another to the north: both 40 m before the crossing."""
    history = straight_tracks({"av": (-40, 0, 0, 10), "b": (0, -40, np.pi / 2, 10)})
    z_m = np.repeat(np.array(heights, float)[:, None], history.steps, axis=1)
    history = replace(history, z_m=z_m)
    return View(
        step=10, dt_s=DT_S, av_id="av", history=history, road=road, signals={}, steps_left=80
    )


def test_routes_that_pass_over_each_other_do_not_meet():
    def relations(road, heights):
        view = view_of(road, heights)
        return opponent_features(view, VECTOR)[0]["pair"]

    flat = relations(crossing({"below": 0.0, "above": 0.0}), (0.0, 0.0))
    high = relations(crossing({"below": 5.0, "above": 5.0}), (5.0, 5.0))
    np.testing.assert_array_equal(flat, high)  # what trained networks read is as it was
    bridge = relations(crossing(), (0.0, 8.0))
    assert not np.array_equal(flat, bridge)


def test_who_passes_over():
    def over(road, heights):
        now = view_of(road, heights).history
        pose = now.position_m[:, -1], now.heading_rad[:, -1], now.speed_mps[:, -1]
        return passes_over(road, *pose, now.z_m[:, -1]).tolist()

    assert over(crossing(), (0.0, 8.0)) == [True]
    assert over(crossing({"below": 0.0, "above": 0.0}), (0.0, 0.0)) == [False]
    assert over(stacked(), (0.0, 8.0)) == [False]  # it drives across, off every lane


def test_gaps_of_made_attacks():
    """What CAT's, ART's and the rule's choice go by: on the bridge 5.5 m are left."""
    steps = np.arange(1, 81)[:, None] * DT_S
    under = np.array([-40.0, 0.0]) + 10 * steps * [1, 0]
    over = (np.array([0.0, -40.0]) + 10 * steps * [0, 1])[None]
    av = AgentMotion(
        position_m=under,
        heading_rad=np.zeros(80),
        speed_mps=np.full(80, 10.0),
        valid=np.ones(80, bool),
    )

    def least(road, heights):
        view = view_of(road, heights)
        scouted = SimpleNamespace(view=view, opponent_id="b")
        return open_loop.gaps(scouted, av, over, np.full((1, 80), np.pi / 2)).min()

    assert least(crossing({"below": 0.0, "above": 0.0}), (0.0, 0.0)) == 0.0
    assert least(crossing(), (0.0, 8.0)) == pytest.approx(5.5)


LIMITS = MotionLimits(accel=3.0, brake=4.0, lateral=3.0)


@pytest.mark.parametrize(("deck_m", "leaves"), [(0.0, True), (8.0, False)])
def test_off_every_road_of_its_level_a_candidate_leaves_none(deck_m, leaves):
    """A vehicle on a car-park deck above a road is off the road, now and later."""
    view = view_of(crossing(), (0.0, deck_m))
    tracks = view.history
    place = tracks.position_m.copy()
    place[1] = np.array([-60.0, 0.0]) + np.arange(tracks.steps)[:, None] * [1.0, 0.0]
    view = replace(view, history=replace(tracks, position_m=place))
    situation = Situation.of(view, "b", LIMITS)
    turns_off = place[1, -1] + np.arange(1, 81)[None, :, None] * [0.0, 0.2]
    assert candidates.off_road(situation, turns_off)[0, -1] == leaves


def test_a_plan_continues_on_the_bridge_and_down_its_ramp():
    """The opponent's plan goes on after the end of the episode, at the heights of the road."""
    line = np.array([[-100.0, 30.0], [0.0, 30.0], [40.0, 30.0], [300.0, 30.0]])
    deck = Lane(
        id="deck", kind="street", centre_m=line, z_m=np.array([8.0, 8.0, 4.0, 4.0]), width_m=3.5
    )
    road = road_of(lane("below", (0, -100), (0, 100), 0.0), deck)
    paths = {"av": straight(0, 0, 10, steps=41), "b": straight(-60, 30, 10, steps=41)}
    driven = rollout_of(paths)
    z_m = np.zeros(driven.tracks.z_m.shape)
    z_m[driven.tracks.row("b")] = 8.7  # of its middle, as in recordings
    start = driven.tracks.position_m[driven.tracks.row("b"), 10]
    ahead = start + np.arange(1, 81)[:, None] * [1.0, 0.0]
    plan = Plan(
        agent_id="b", first_step=11, position_m=ahead, heading_rad=np.zeros(80),
        speed_mps=np.full(80, 10.0),
    )  # fmt: skip
    driven = replace(driven, tracks=replace(driven.tracks, z_m=z_m), plans=(plan,))
    case = replace(case_of(), duration_steps=80, road=road)
    written = scene_of(Exportable.of(driven, case)).tracks
    row = written.row("b")
    expected = np.interp(written.position_m[row, 41:, 0], line[:, 0], deck.z_m) + 0.7
    np.testing.assert_allclose(written.z_m[row, 41:], expected, atol=0.1)


def test_a_forecast_over_the_bridge_meets_nothing_below_and_stays_on_its_road():
    ahead = np.array([0.0, -40.0]) + np.arange(1, 81)[:, None] * [0.0, 1.0]
    north = np.full((1, 80), np.pi / 2)
    crosses = np.array([-40.0, 0.0]) + np.arange(1, 81)[:, None] * [1.0, 0.0]
    motion = {"av": straight(-40, 0, 10), "b": straight(0, -40, 10, heading=np.pi / 2)}
    for heights, meets in (((0.0, 8.0), False), ((0.0, 0.0), True)):
        view = view_of(crossing({"below": 0.0, "above": heights[1]}), heights)
        tracks = rollout_of(motion).tracks
        z_m = np.repeat(np.array(heights)[:, None], tracks.steps, axis=1)
        scene = SimpleNamespace(tracks=replace(tracks, z_m=z_m))
        target = SimpleNamespace(scene=scene, view=view, agent_id="b", row=1)
        first = forecasts.first_overlap(target, ahead[None], north)
        assert (first[0] != forecasts.NEVER) == meets
    # along the road below, from the deck on: no road of its level is there
    target.view = view_of(crossing(), (0.0, 8.0))
    assert forecasts.first_off_road(target, ahead[None])[0] == forecasts.NEVER
    assert forecasts.first_off_road(target, crosses[None])[0] != forecasts.NEVER


def test_under_a_bridge_a_candidate_of_diffscene_touches_nothing():
    steps = np.arange(1, 81)[:, None]
    own = np.array([0.0, -40.0]) + steps * [0.0, 1.0]
    motion = {
        "av": straight(-300, 0, 10),
        "b": straight(0, -40, 10, heading=np.pi / 2),
        "c": straight(-40, 0, 10),
    }
    tracked = SimpleNamespace(position_m=own[None], heading_rad=np.full((1, 80), np.pi / 2))
    for deck_m, first in ((8.0, 81), (0.0, None)):
        rollout = rollout_of(motion)
        z_m = np.zeros(rollout.tracks.z_m.shape)
        z_m[rollout.tracks.row("b")] = deck_m
        rollout = replace(rollout, tracks=replace(rollout.tracks, z_m=z_m))
        view = view_of(crossing({"below": 0.0, "above": deck_m}), (0.0, deck_m))
        scouted = SimpleNamespace(view=view, rollout=rollout, opponent_id="b")
        found = diffscene._first_other(scouted, tracked)[0]
        assert found == first if first else found < 81


def test_lights_and_crossings_are_of_one_level():
    """An AV drives over a light at red and a crossing, on the deck above or on their road."""
    square = np.array([(-2.0, -4.0), (2.0, -4.0), (2.0, 4.0), (-2.0, 4.0)])
    lights = (
        lane("to", (-100, 0), (-20, 0), 0.0),
        replace(lane("below", (-20, 0), (100, 0), 0.0), previous=("to",)),
        lane("above", (-100, 0.5), (100, 0.5), 8.0),
    )
    marked = Polygon(id="x", kind="crosswalk", points_m=square, z_m=np.zeros(4))
    road = replace(road_of(*lights), polygons=(marked,))
    rollout = rollout_of({"av": straight(-60, 0, 12), "b": straight(0, 0, 0)})
    red = ({"below": SignalState.STOP},) * 80
    for height, passed in ((0.0, {SignalState.STOP}), (8.0, set())):
        tracks = replace(rollout.tracks, z_m=np.full(rollout.tracks.z_m.shape, height))
        driven = replace(rollout, tracks=tracks, signals=red)
        assert lights_passed(driven, road, 0, np.zeros(2)) == passed
        meeting = SimpleNamespace(tracks=tracks, other=1, step=40)
        assert on_crossing(driven, road, meeting) == bool(passed)


def test_a_person_below_a_bridge_is_not_on_its_road():
    """A plan knows the heights as the judgement does; the AV comes on the bridge."""
    bridge = road_of(lane("above", (-100, 0), (100, 0), 8.0), lane("far", (0, 40), (10, 40), 0.0))
    crossed = road_of(*bridge.lanes.values(), lane("under", (60, -50), (60, 50), 0.0))
    stands, av = np.zeros((1, 20, 2)), straight(-30, 0, 10)[:20, :2]
    since = [
        intends_since(crossed, stands, av, np.array([15]), DT_S, heights)[0]
        for heights in (None, (np.zeros((1, 20)), np.full(20, 8.0)))
    ]
    assert since == [0, 15]


def test_a_person_who_runs_below_a_bridge_does_not_run_towards_its_road():
    bridge = road_of(lane("above", (-100, 0), (100, 0), 8.0), lane("far", (0, 90), (10, 90), 0.0))
    crossed = road_of(*bridge.lanes.values(), lane("under", (60, -50), (60, 50), 0.0))
    runs = np.array([0.0, -9.0]) + np.arange(20)[:, None] * [0.0, 0.3]
    av = straight(-30, 0, 10)[:20, :2]
    flat, level = (
        intends_since(crossed, runs[None], av, np.array([15]), DT_S, heights)[0]
        for heights in (None, (np.zeros((1, 20)), np.full(20, 8.0)))
    )
    assert flat < 10
    assert level == 15


def test_a_plan_of_a_person_below_a_bridge_knows_the_heights_of_both():
    """A driver on the deck has no sign of danger before the contact, with level roads it has."""
    since = []
    for deck_m in (8.0, 0.0):
        view = view_of(crossing({"below": deck_m, "above": 0.0}), (deck_m, 0.0))
        history = view.history
        place, kinds = history.position_m.copy(), ("vehicle", "pedestrian")
        place[1] = [-10.0, 0.0]
        history = replace(history, position_m=place, kinds=kinds)
        situation = Situation.of(replace(view, history=history), "b", LIMITS)
        stands = SimpleNamespace(
            position_m=np.tile(place[1, -1], (1, 80, 1)), heading_rad=np.zeros((1, 80))
        )
        drives = np.array([-40.0, 0.0]) + np.arange(1, 81)[:, None] * [1.0, 0.0]
        since += constraints._understood(situation, stands, np.zeros(80), drives, None).tolist()
    assert since[1] == 0 < since[0]


def test_a_recorded_av_on_a_bridge_stays_on_its_lanes():
    """The lane below is nearer in the plane, and joins no lane of the bridge."""
    road = road_of(
        lane("below", (-100, 0), (100, 0), 0.0),
        replace(lane("up", (-200, 1), (-100, 1), 8.0), next=("deck",)),
        replace(lane("deck", (-100, 1), (100, 1), 8.0), next=("down",)),
        lane("down", (100, 1), (200, 1), 8.0),
    )
    tracks = rollout_of({"av": straight(-160, 0, 40, steps=80)}, opponent_id=None).tracks
    leaves, prints = [], []
    for height in (8.0, 0.0):
        z_m = np.full(tracks.z_m.shape, height)
        scene = replace(case_of().scene, road=road, tracks=replace(tracks, z_m=z_m))
        leaves.append(build.leaves_lanes(scene))
        prints.append(conversion.key(scene))
    assert leaves == [False, True]
    assert prints[0] != prints[1]  # what is kept of one is not taken for the other


def test_where_a_road_has_one_level_heights_are_not_compared():
    """Heights of recordings may count from elsewhere than those of their maps."""
    flat, here, there = road_of(lane("a", (-100, 0), (100, 0), 3.0)), np.zeros((1, 2)), POSE[None]
    assert ground.on_level(flat, 0.0, 100.0)
    assert not ground.ground_of(flat).apart(here, np.zeros(1), there, np.array([100.0])).any()
    two = crossing()
    assert not ground.on_level(two, 0.0, 8.0)
    assert ground.ground_of(two).apart(here, np.zeros(1), there, np.array([8.0])).all()
