"""Which futures of an opponent break a rule of the road."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.candidates import Candidates
from deepmf_sumo.deepmf.reference_paths import own_paths
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.traffic_rules import TrafficRules, stops
from deepmf_sumo.scene import Forecast, Futures, Lane, Neighbour, RoadMap, SignalState, StopSign
from deepmf_sumo.scene.road_users import MotionLimits

from tests.support.predictor_doubles import view_of

SECONDS = np.arange(1, 81) * 0.1
LIMITS = MotionLimits(accel=3.0, brake=4.0, lateral=3.0)


def lane(name, points, **more):
    points = np.asarray(points, float)
    values = {"kind": "street", "width_m": 3.2, "speed_limit_mps": 15.0, **more}
    return Lane(id=name, centre_m=points, z_m=np.zeros(len(points)), **values)


def beside(name):
    return (Neighbour(lane_id=name, self_start=0, self_end=1, other_start=0, other_end=1),)


def crossing(**more):
    """The opponent's road runs east over x = 0, the AV's north; both have a lane in the middle."""
    lanes = [
        lane("west", [(-100, 0), (-5, 0)], next=("over",)),
        lane("over", [(-5, 0), (5, 0)], next=("east",), interpolating=True, **more),
        lane("east", [(5, 0), (100, 0)]),
        lane("south", [(0, -100), (0, -5)], next=("up",)),
        lane("up", [(0, -5), (0, 5)], next=("north",), interpolating=True),
        lane("north", [(0, 5), (0, 100)]),
    ]
    return RoadMap(lanes={one.id: one for one in lanes})


def two_lanes():
    lanes = [
        lane("right", [(-200, 0), (400, 0)], left=beside("left")),
        lane("left", [(-200, 3.2), (400, 3.2)], right=beside("right")),
    ]
    return RoadMap(lanes={one.id: one for one in lanes})


def drive(agent_id, x, y, speed, heading=0.0, across=None):
    """A future from a place, with a speed or (80) speeds, and (80) metres to the left."""
    driven = np.cumsum(np.broadcast_to(speed, 80) * 0.1)
    left = np.zeros(80) if across is None else across
    cos, sin = np.cos(heading), np.sin(heading)
    position = np.stack([x + driven * cos - left * sin, y + driven * sin + left * cos], -1)
    return Futures(
        agent_id=agent_id, position_m=position[None], heading_rad=np.full((1, 80), heading)
    )


def is_lawful(view, future, av, speed, law=None, collides=None):
    alone = Forecast(futures=av, probability=np.ones(1))
    own = Candidates(
        forecast=Forecast(futures=future, probability=np.ones(1)),
        speed_mps=np.broadcast_to(speed, (1, 80)).astype(float),
        bent_m=np.zeros(1),
        origin=("mode",),
    )
    step = np.array([[collides or 80.0, 80.0]])
    judged = (law or TrafficRules()).lawful(Situation.of(view, "b", LIMITS, alone), own, step)
    assert judged.shape == (1,)
    return bool(judged[0])


AWAY = drive("av", 0, -90, 1.0, np.pi / 2)
BRAKING = np.maximum(12.0 - 3.0 * SECONDS, 0.0)


def at_light(state, x=-40.0, speed=12.0):
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (x, 0, 0, speed)}, road=crossing())
    return replace(view, signals={"over": state})


@pytest.mark.parametrize("state", [SignalState.STOP, SignalState.CAUTION])
def test_who_can_stop_at_a_light_has_to(state):
    view = at_light(state)
    assert not is_lawful(view, drive("b", -40, 0, 12.0), AWAY, 12.0)
    assert is_lawful(view, drive("b", -40, 0, BRAKING), AWAY, BRAKING)
    assert is_lawful(at_light(SignalState.GO), drive("b", -40, 0, 12.0), AWAY, 12.0)


def test_who_cannot_stop_gently_at_yellow_may_go_on():
    near = at_light(SignalState.CAUTION, x=-25.0)
    assert is_lawful(near, drive("b", -25, 0, 12.0), AWAY, 12.0)
    # at red it takes what a firm driver needs
    assert not is_lawful(at_light(SignalState.STOP, x=-25.0), drive("b", -25, 0, 12.0), AWAY, 12.0)
    assert is_lawful(at_light(SignalState.STOP, x=-20.0), drive("b", -20, 0, 12.0), AWAY, 12.0)


def test_who_could_have_stopped_owes_it_until_the_light_lets_go():
    law = TrafficRules()
    assert not is_lawful(at_light(SignalState.CAUTION), drive("b", -40, 0, 12.0), AWAY, 12.0, law)
    late = drive("b", -20, 0, 12.0)
    assert not is_lawful(at_light(SignalState.CAUTION, -20.0), late, AWAY, 12.0, law)
    assert is_lawful(at_light(SignalState.GO, -20.0), late, AWAY, 12.0, law)
    assert is_lawful(at_light(SignalState.CAUTION, -20.0), late, AWAY, 12.0, law)


def test_who_stopped_a_little_beyond_the_line_does_not_creep_on_at_red():
    front_over = at_light(SignalState.STOP, x=-5.0 - 2.4 + 0.5, speed=0.0)
    creeps = np.minimum(0.5 * SECONDS, 1.0)
    assert not is_lawful(front_over, drive("b", -6.9, 0, creeps), AWAY, creeps)
    assert is_lawful(front_over, drive("b", -6.9, 0, 0.0), AWAY, 0.0)
    in_the_middle = at_light(SignalState.STOP, x=-3.0, speed=0.0)
    assert is_lawful(in_the_middle, drive("b", -3.0, 0, creeps), AWAY, creeps)


def test_before_a_stop_sign_one_stands():
    sign = StopSign(id="s", position_m=np.array([-5.0, 0.0]), z_m=0.0, lane_ids=("west",))
    road = replace(crossing(), stop_signs=(sign,))
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-40, 0, 0, 10.0)}, road=road)
    assert not is_lawful(view, drive("b", -40, 0, 10.0), AWAY, 10.0)
    stops_there = np.maximum(10.0 - 1.65 * SECONDS, 0.0)
    starts = np.where(SECONDS > 7.0, 2.0 * (SECONDS - 7.0), stops_there)
    assert is_lawful(view, drive("b", -40, 0, starts), AWAY, starts)
    waits = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-9, 0, 0, 0.0)}, road=road)
    assert is_lawful(waits, drive("b", -9, 0, 2.0 * SECONDS), AWAY, 2.0 * SECONDS)


@pytest.mark.parametrize("state", [SignalState.STOP, SignalState.FLASHING_STOP])
def test_the_light_of_a_turn_does_not_stop_who_goes_straight_on(state):
    road = crossing()
    turn = lane("turn", [(-5, 0), (-1, -1), (0, -5)], interpolating=True)
    west = replace(road.lanes["west"], next=("over", "turn"))
    road = RoadMap(lanes={**road.lanes, "west": west, "turn": turn})
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-40, 0, 0, 12.0)}, road=road)
    view = replace(view, signals={"turn": state})
    assert is_lawful(view, drive("b", -40, 0, 12.0), AWAY, 12.0)


def test_a_light_that_flashes_red_is_a_stop_sign():
    view = at_light(SignalState.FLASHING_STOP, speed=10.0)
    assert not is_lawful(view, drive("b", -40, 0, 10.0), AWAY, 10.0)
    stops_there = np.maximum(10.0 - 1.65 * SECONDS, 0.0)
    starts = np.where(SECONDS > 7.0, 2.0 * (SECONDS - 7.0), stops_there)
    assert is_lawful(view, drive("b", -40, 0, starts), AWAY, starts)
    other = replace(view, signals={"up": SignalState.FLASHING_STOP})
    assert is_lawful(other, drive("b", -40, 0, 10.0), AWAY, 10.0)


def test_who_stood_before_a_stop_sign_need_not_stop_again_at_the_next_plan():
    sign = StopSign(id="s", position_m=np.array([-5.0, 0.0]), z_m=0.0, lane_ids=("west",))
    road = replace(crossing(), stop_signs=(sign,))

    def drives_on(law, x, speed):
        view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (x, 0, 0, speed)}, road=road)
        faster = np.minimum(speed + 2.0 * SECONDS, 15.0)
        return is_lawful(view, drive("b", x, 0, faster), AWAY, faster, law)

    law = TrafficRules()
    assert not drives_on(law, -30.0, 5.0)
    assert drives_on(law, -12.0, 0.0)
    assert drives_on(law, -11.0, 2.0)
    assert drives_on(law, -8.0, 4.0)
    assert drives_on(law, -2.0, 6.0)  # it is over the line
    assert not drives_on(TrafficRules(), -11.0, 2.0)
    assert not drives_on(law, -30.0, 5.0)  # it comes back


def test_a_future_stays_on_the_lanes_that_lead_on_and_keeps_the_limit():
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-40, 0, 0, 12.0)}, road=crossing())
    assert is_lawful(view, drive("b", -40, 0, 12.0), AWAY, 12.0)
    assert not is_lawful(view, drive("b", -40, 0, 12.0, across=0.8 * SECONDS), AWAY, 12.0)
    assert not is_lawful(view, drive("b", -40, 0, 17.0), AWAY, 17.0)
    fast = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-40, 0, 0, 17.0)}, road=crossing())
    assert is_lawful(fast, drive("b", -40, 0, 17.0), AWAY, 17.0)


def test_beyond_the_map_the_road_goes_on_but_a_lane_that_ends_does_not():
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (60, 0, 0, 12.0)}, road=crossing())
    assert is_lawful(view, drive("b", 60, 0, 12.0), AWAY, 12.0)
    ends = [
        lane("ends", [(0, 0), (80, 0)], left=beside("goes")),
        lane("goes", [(0, 3.2), (80, 3.2)], right=beside("ends"), next=("on",)),
        lane("on", [(80, 3.2), (300, 3.2)]),
    ]
    road = RoadMap(lanes={one.id: one for one in ends})
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (40, 0, 0, 12.0)}, road=road)
    assert not is_lawful(view, drive("b", 40, 0, 12.0), AWAY, 12.0)
    over = 3.2 * np.clip(SECONDS / 2.5, 0.0, 1.0)
    assert is_lawful(view, drive("b", 40, 0, 12.0, across=over), AWAY, 12.0)


def test_who_gives_way_passes_long_before_the_av_or_after_it():
    road = crossing(gives_way_to=("up",))
    view = view_of({"av": (0, -50, np.pi / 2, 10.0), "b": (-40, 0, 0, 12.0)}, road=road)

    def passes(av_y, **changes):
        av = drive("av", 0, av_y, 10.0, np.pi / 2)
        return is_lawful(replace(view, **changes), drive("b", -40, 0, 12.0), av, 12.0)

    assert not passes(-36.0)  # at the same time
    assert not passes(-46.0)  # the AV would come 1 s later
    # the opponent's box leaves the AV's way after 3.62 s; the AV's front gets there 1.4 s later
    assert not passes(-53.6)
    assert passes(-58.0)
    assert passes(-70.0)
    assert passes(-10.0)  # it has passed
    assert passes(-36.0, signals={"up": SignalState.STOP})
    assert passes(-36.0, road=crossing())  # the map knows no right of way


def lane_change(ahead_m, over, av_speed=12.0, collides=None):
    view = view_of({"av": (0, 3.2, 0, av_speed), "b": (ahead_m, 0, 0, 12.0)}, road=two_lanes())
    av = drive("av", 0, 3.2, av_speed)
    return is_lawful(view, drive("b", ahead_m, 0, 12.0, across=over), av, 12.0, None, collides)


def test_a_change_of_lanes_leaves_the_av_room():
    over = 3.2 * np.clip(SECONDS / 2.5, 0.0, 1.0)
    assert not lane_change(10.0, over)
    assert lane_change(30.0, over)
    assert not lane_change(30.0, over, av_speed=22.0)
    assert lane_change(10.0, 0.0 * over)
    # where the AV is predicted to be met out of the lane, in whatever it does
    assert not lane_change(30.0, over, collides=30.0)
    assert lane_change(30.0, 0.0 * over, collides=30.0)


def in_lane(x, speed, collides=None, road=None, now=12.0):
    view = view_of({"av": (0, 0, 0, 12.0), "b": (x, 0, 0, now)}, road=road or two_lanes())
    return is_lawful(view, drive("b", x, 0, speed), drive("av", 0, 0, 12.0), speed, None, collides)


def test_behind_the_av_an_opponent_does_not_touch_it_nor_push():
    assert in_lane(-25.0, 12.0)
    assert not in_lane(-25.0, 12.0, collides=40.0)
    assert not in_lane(-14.0, np.minimum(12.0 + SECONDS, 13.0))


def test_before_the_av_an_opponent_brakes_for_a_cause_alone():
    assert in_lane(25.0, np.maximum(12.0 - 1.5 * SECONDS, 7.0), collides=40.0)
    assert not in_lane(25.0, np.maximum(12.0 - 4.0 * SECONDS, 7.0))
    assert not in_lane(25.0, np.maximum(12.0 - 1.5 * SECONDS, 0.0))
    light = replace(
        view_of({"av": (-60, 0, 0, 12.0), "b": (-40, 0, 0, 12.0)}, road=crossing()),
        signals={"over": SignalState.STOP},
    )
    av = drive("av", -60, 0, 12.0)
    assert is_lawful(light, drive("b", -40, 0, BRAKING), av, BRAKING, collides=40.0)


def test_who_begins_on_no_lane_may_drive_anywhere():
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-40, 30, 0, 12.0)}, road=crossing())
    assert is_lawful(view, drive("b", -40, 30, 30.0), AWAY, 30.0)


@pytest.mark.parametrize("left", [1, 2, 3])
def test_futures_are_judged_in_the_last_steps_of_a_case(left):
    road = crossing()
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-40, 0, 0, 12.0)}, road=road)
    view = replace(view, steps_left=left)
    assert is_lawful(view, drive("b", -40, 0, 12.0), AWAY, 12.0)
    assert not is_lawful(view, drive("b", -40, 0, 20.0), AWAY, 20.0)


def test_ways_to_stop_stand_in_the_end():
    modes = Forecast(futures=drive("b", 0, 0, 12.0), probability=np.ones(1))
    view = view_of({"av": (0, -90, 0, 1.0), "b": (0, 0, 0, 12.0)})
    situation = Situation.of(view, "b", LIMITS)
    found = stops(situation, own_paths(modes, situation.start))
    assert set(found.origin) == {"stop"}
    last = np.diff(found.position_m[:, -20:], axis=1)
    standing = np.abs(last).max(axis=(1, 2)) < 1e-6
    assert standing.sum() == len(standing) - 1  # all but the gentlest, which needs 12 s
    assert found.position_m[-1, -1, 0] == pytest.approx(12.0**2 / 8, abs=0.1)


def in_junction(x, speed, **more):
    """It goes before who comes from the south."""
    road = crossing(**more)
    up = replace(road.lanes["up"], gives_way_to=("over",))
    view = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (x, 0, 0, speed)}, road=road)
    return replace(view, road=RoadMap(lanes=road.lanes | {"up": up}))


def test_nobody_stops_in_the_middle_of_a_junction():
    halts = np.maximum(8.0 - 2.0 * SECONDS, 0.0)  # after 16 m
    assert not is_lawful(in_junction(-15.0, 8.0), drive("b", -15, 0, halts), AWAY, halts)
    for x in (-25.0, -1.0):  # before it, and behind it
        assert is_lawful(in_junction(x, 8.0), drive("b", x, 0, halts), AWAY, halts)
    starts = np.minimum(1.5 * SECONDS, 8.0)
    assert is_lawful(in_junction(-4.0, 0.0), drive("b", -4, 0, starts), AWAY, starts)
    unknown = view_of({"av": (0, -90, np.pi / 2, 1.0), "b": (-15, 0, 0, 8.0)}, road=crossing())
    assert is_lawful(unknown, drive("b", -15, 0, halts), AWAY, halts)


def test_nobody_halves_its_speed_in_a_junction_with_each_plan():
    law = TrafficRules()
    slower = np.maximum(8.0 - 2.0 * SECONDS, 4.5)
    assert is_lawful(in_junction(-4.9, 8.0), drive("b", -4.9, 0, slower), AWAY, slower, law)
    crawls = np.maximum(4.5 - 2.0 * SECONDS, 2.5)
    again = in_junction(-1.0, 4.5)
    assert is_lawful(again, drive("b", -1.0, 0, crawls), AWAY, crawls)
    assert not is_lawful(again, drive("b", -1.0, 0, crawls), AWAY, crawls, law)
