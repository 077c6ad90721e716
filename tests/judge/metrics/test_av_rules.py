"""Rules of the road and of comfort: worked by hand on a crossing with a light."""

import dataclasses

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics import own
from deepmf_sumo.judge.metrics.av_rules import MONITORS
from deepmf_sumo.scene import Event, Lane, Polygon, RoadMap, SignalState

from tests.support.rollout_doubles import case_of, in_traffic, rollout_of, straight

STEPS = 81
AWAY = straight(0, -500, 10)
GO, YELLOW, RED = SignalState.GO, SignalState.CAUTION, SignalState.STOP


def lane(name, points, **more):
    centre = np.array(points, float)
    return Lane(
        id=name, kind="street", centre_m=centre, z_m=np.zeros(len(centre)),
        **{"width_m": 3.5, "speed_limit_mps": 14.0, **more},
    )  # fmt: skip


def crossing_at(x):
    """A crossing of 8 m by 4 m over the AV's road."""
    corners = np.array([(x + dx, dy) for dx, dy in ((-2, -4), (2, -4), (2, 4), (-2, 4))], float)
    return Polygon(id="crossing", kind="crosswalk", points_m=corners, z_m=np.zeros(4))


ROAD = RoadMap(
    lanes={
        one.id: one
        for one in (
            lane("to", [[-300, 0], [0, 0]], next=("over",)),
            lane("over", [[0, 0], [20, 0]], previous=("to",), next=("on",), interpolating=True,
                 gives_way_to=("across",)),
            lane("on", [[20, 0], [500, 0]], previous=("over",)),
            lane("from south", [[10, -300], [10, -10]], next=("across",)),
            lane("across", [[10, -10], [10, 10]], previous=("from south",), next=("north",),
                 interpolating=True),
            lane("north", [[10, 10], [10, 300]], previous=("across",)),
        )
    },
    polygons=(crossing_at(450),),
)  # fmt: skip


def poses(x, speed):
    """From speeds (K) after now, along the x axis: (T, 3)."""
    speed = np.concatenate([np.full(11, speed[0]), speed])[:91]
    along = x + (np.cumsum(speed) - np.cumsum(speed)[10]) * 0.1
    return np.stack([along, np.zeros(91), np.zeros(91)], axis=1)


def braking(x, speed, at_s, mps2):
    seconds = np.arange(1, STEPS) * 0.1
    return poses(x, np.maximum(0.0, speed - mps2 * np.maximum(0.0, seconds - at_s)))


def measured(name, av, lights=None, road=ROAD, **others):
    case = dataclasses.replace(in_traffic(case_of()), road=road)
    rollout = rollout_of({"av": av, "b": AWAY, **others})
    if lights:
        lit = tuple({"over": one} for one in lights)
        rollout = dataclasses.replace(rollout, signals=lit + (lit[-1],) * (80 - len(lit)))
    return plugins.load("metrics", name).measure(rollout, case)


def value(*arguments, **others):
    return measured(*arguments, **others).value


def test_monitors_are_metrics_and_zero_is_good():
    assert set(MONITORS) <= set(own())
    for name in MONITORS:
        if name.startswith("av_") and not name.endswith(("_min", "_progress")):
            assert value(name, straight(-250, 0, 12), [GO]) == pytest.approx(0.0, abs=1e-6), name


def test_braking_that_a_light_asks_for():
    """Yellow 60 m ahead at 12 m/s: 3 m/s2 after a second is enough. Later more is needed."""
    front = -60 - 2.4
    soon = value("av_signal_braking", braking(front, 12, 1.0, 2.0), [GO, YELLOW])
    assert soon == pytest.approx(12**2 / (2 * 48), abs=0.1)
    late = value("av_signal_braking", braking(front, 12, 3.5, 5.0), [GO, YELLOW])
    assert late == pytest.approx(12**2 / (2 * (60 - 12 * 3.5)), abs=0.2)
    assert value("av_signal_braking", straight(front, 0, 12), [GO, YELLOW]) == 10.0


def test_no_light_asks_of_an_av_that_cannot_stop_any_more():
    """Yellow 25 m ahead at 12 m/s: after a second 13 m are left, 5.5 m/s2."""
    assert value("av_signal_braking", straight(-25 - 2.4, 0, 12), [GO, YELLOW]) == 0.0
    assert "lights" in measured("av_signal_braking", straight(-25, 0, 12)).reason


def test_a_light_asks_from_where_the_av_comes_into_its_lane():
    """From the lane beside, 15 m before the line at 8 m/s: it could not stop in a second."""
    av = poses(-65, np.full(80, 8.0))
    av[:, 1] = np.interp(av[:, 0], [-50, -15 - 2.4], [3.5, 0.5])
    assert value("av_signal_braking", av, [RED]) == 0.0
    far = poses(-65, np.full(80, 8.0))
    far[:, 1] = np.interp(far[:, 0], [-60, -40 - 2.4], [3.5, 0.5])
    assert value("av_signal_braking", far, [RED]) == 10.0


def test_standing_beyond_the_line():
    """It stops 3 m beyond a red light's line; not so if it could not stop when green ended."""
    way = 8 + 8**2 / (2 * 2.0)
    av = braking(-2.4 - way + 3, 8, 1.0, 2.0)
    assert value("av_beyond_stop_line", av, [RED]) == pytest.approx(3.0, abs=0.5)
    assert value("av_beyond_stop_line", av, [GO] * 30 + [RED]) == 0.0
    before = braking(-2.4 - way - 2, 8, 1.0, 2.0)
    assert value("av_beyond_stop_line", before, [RED]) == 0.0


@pytest.mark.parametrize(("lights", "run"), [([RED], 1.0), ([YELLOW], 0.0), ([GO, RED], 1.0)])
def test_a_red_run(lights, run):
    assert value("av_red_run", straight(-30, 0, 12), lights) == run


def test_right_of_way():
    """It crosses at 8 m/s; a vehicle with priority comes at 12 m/s 0.5 s too soon, or late."""
    av = straight(-12, 0, 8)
    near = straight(10, -36, 12, heading=np.pi / 2)
    assert value("av_right_of_way_taken", av, south=near) > 2.0
    assert value("av_right_of_way_taken", av, south=straight(10, -190, 12, heading=np.pi / 2)) == 0
    assert value("av_right_of_way_taken", straight(-12, 0, 0), south=near) == 0.0


def at_the_crossing(person, lights=None, speed=10, kind="pedestrian", x=100):
    """Of an AV whose front comes to a crossing of 8 m by 4 m after 4 s, with somebody there."""
    road = dataclasses.replace(ROAD, polygons=(crossing_at(x),))
    case = dataclasses.replace(in_traffic(case_of()), road=road)
    rollout = rollout_of(
        {"av": straight(x - 2 - 2.4 - 4 * speed, 0, speed), "b": AWAY, "p": person}
    )
    size_m = rollout.tracks.size_m.copy()
    size_m[2] = 0.5, 0.5, 1.75
    tracks = dataclasses.replace(rollout.tracks, kinds=("vehicle", "vehicle", kind), size_m=size_m)
    lit = () if lights is None else ({"over": lights},) * 80
    rollout = dataclasses.replace(rollout, tracks=tracks, signals=lit)
    return plugins.load("metrics", "av_crossing_taken").measure(rollout, case).value


NORTH = np.pi / 2


@pytest.mark.parametrize(
    ("y_at_4_s", "mps", "taken"),
    [
        (-2.5, 0.5, 1.0),  # 1.25 m to the corridor: 2.5 s
        (-3.4, 0.25, 0.0),  # 2.15 m: too slow to come in its way
        (2.5, 0.5, 0.0),  # has crossed
        (-1.5, 1.2, 0.0),  # came onto the crossing only 2.1 s ago
        (0.0, 0.3, 1.0),  # right in its way
    ],
)
def test_who_walks_on_a_crossing_goes_first(y_at_4_s, mps, taken):
    walks = straight(100, y_at_4_s - 4.0 * mps, mps, heading=NORTH)
    assert at_the_crossing(walks) == taken


def test_nobody_has_to_be_let_go_by_an_av_that_creeps_or_by_a_rider():
    walks = straight(100, -2.5 - 4.0 * 0.5, 0.5, heading=NORTH)
    assert at_the_crossing(walks, speed=1.0) == 0.0
    assert at_the_crossing(walks, kind="cyclist") == 0.0
    none = dataclasses.replace(ROAD, polygons=())
    assert "crossings" in measured("av_crossing_taken", straight(-250, 0, 12), road=none).reason


@pytest.mark.parametrize(("lights", "taken"), [(None, 1.0), (GO, 0.0), (RED, 1.0)])
def test_a_green_light_that_it_passes_straight_on_lets_the_av_go(lights, taken):
    walks = straight(12, -2.5 - 4.0 * 0.5, 0.5, heading=NORTH)
    assert at_the_crossing(walks, lights, x=12) == taken


@pytest.mark.parametrize("there", [False, True])
def test_what_explains_a_stop(there):
    """It stops on a free road, or behind one that stands."""
    others = {"ahead": straight(150, 0, 0)} if there else {}
    av = braking(60, 12, 2.0, 4.0)
    expected = 0.0 if there else 3.0
    assert value("av_unexplained_stop", av, **others) == pytest.approx(expected, abs=0.25)
    hard = value("av_unexplained_braking", av, **others)
    assert hard == pytest.approx(0.0 if there else 4.0, abs=0.01)


def test_a_light_explains_a_stop_and_one_that_passes_does_not():
    assert value("av_unexplained_braking", braking(-70, 12, 2.0, 4.0), [RED]) == 0.0
    oncoming = straight(200, 3.5, 12, heading=np.pi)
    assert value("av_unexplained_braking", braking(60, 12, 2.0, 4.0), oncoming=oncoming) > 3.9


@pytest.mark.parametrize(
    ("events", "stands_s", "hardest"),
    [
        ([(0, "av_stop_ahead")], 0.0, 0.0),
        ([(0, "av_stop_ahead"), (60, "av_stop_over")], 2.0, 0.0),
        ([(60, "av_stop_ahead")], 1.0, 4.0),
    ],
)
def test_a_stop_of_its_own_route_explains_that_it_stops(events, stands_s, hardest):
    """It brakes from 2 s to 5 s after now, and stands for 3 s."""
    rollout = dataclasses.replace(
        rollout_of({"av": braking(60, 12, 2.0, 4.0), "b": AWAY}),
        events=tuple(Event(step=10 + one, agent_id="av", kind=kind) for one, kind in events),
    )
    case = dataclasses.replace(in_traffic(case_of()), road=ROAD)
    found = [
        plugins.load("metrics", name).measure(rollout, case).value
        for name in ("av_unexplained_stop", "av_unexplained_braking")
    ]
    assert found == pytest.approx([stands_s, hardest], abs=0.25)


def test_following():
    """8 m behind one as fast, 12 m/s: 0.67 s. Slowing down, or 12 m behind, it is none."""
    near = {"leader": straight(60 + 4.8 + 8, 0, 12)}
    assert value("av_close_following", straight(60, 0, 12), **near) == pytest.approx(8.0)
    slowing = braking(60, 12, 0.0, 0.2)
    assert value("av_close_following", slowing, **near) <= 0.1
    far = {"leader": straight(60 + 4.8 + 12, 0, 12)}
    assert value("av_close_following", straight(60, 0, 12), **far) == 0.0


def test_out_of_its_lane():
    """2 m wide on a lane of 3.5 m: 1.5 m aside its side is 0.75 m beyond the edge."""
    assert value("av_off_lane", straight(60, 1.5, 12)) == pytest.approx(0.75)
    assert value("av_off_lane", straight(60, 0.7, 12)) == 0.0
    short = {"av": straight(60, 1.5, 12, steps=21), "b": straight(0, -500, 10, steps=21)}
    case = dataclasses.replace(in_traffic(case_of()), road=ROAD)
    found = own()["av_off_lane"].measure(rollout_of(short), case)
    assert found.value == pytest.approx(0.75), "an episode shorter than the way to a bay"


def test_a_repeated_command():
    """While it brakes with 2 m/s2 its speed stays the same for 0.5 s; not so after braking."""
    speed = 12 - 0.2 * np.arange(80.0)
    speed[20:] += 1.0
    speed[20:25] = speed[19]
    assert value("av_frozen", poses(60, np.maximum(speed, 0))) == pytest.approx(0.5)
    assert value("av_frozen", poses(60, 13 - np.maximum(speed, 0))) == 0.0  # it accelerates
    at_limit = np.concatenate([15 - 0.2 * np.arange(5), np.full(10, 14.0)])
    at_limit = np.concatenate([at_limit, 14 - 0.2 * np.arange(1, 66)])
    assert value("av_frozen", poses(60, at_limit)) == 0.0
    assert value("av_frozen", poses(60, at_limit - 0.1)) == pytest.approx(0.9)
    steady = np.concatenate([12 - 0.2 * np.arange(20), np.full(60, 8.0)])
    assert value("av_frozen", poses(60, steady)) == 0.0


def on_decks(name, av, av_z_m, road, others):
    """The value where others are at height 0, and a light on the lower deck is red."""
    case = dataclasses.replace(in_traffic(case_of()), road=road)
    rollout = rollout_of({"av": av, "b": AWAY, **{one: path for one, (path, _) in others.items()}})
    kinds = tuple(
        "pedestrian" if one.startswith("walks") else "vehicle" for one in rollout.tracks.ids
    )
    z_m = np.zeros(rollout.tracks.z_m.shape)
    z_m[rollout.tracks.row("av")] = av_z_m
    for one, (_, height) in others.items():
        z_m[rollout.tracks.row(one)] = height
    tracks = dataclasses.replace(rollout.tracks, kinds=kinds, z_m=z_m)
    signals = ({"over": RED},) * 80
    rollout = dataclasses.replace(rollout, tracks=tracks, signals=signals)
    found = plugins.load("metrics", name).measure(rollout, case)
    return found.value, found.reason


DECK = dataclasses.replace(lane("deck", [[-300, 0.4], [500, 0.4]]), z_m=np.full(2, 8.0))
BOTH = dataclasses.replace(ROAD, lanes={**ROAD.lanes, "deck": DECK}, polygons=(crossing_at(12),))
BELOW = {
    "stands": (straight(60, 0, 0), 0.0),
    "walks": (straight(12, -2.5 - 4.0 * 0.5, 0.5, heading=NORTH), 0.0),
}
DRIVES = {
    "on": straight(-32.4, 0, 10),
    "stops": braking(-60, 12, 2.0, 4.0),
    "follows": straight(20, 0, 10),
}


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("name", sorted(set(MONITORS) - {"av_progress"}))
def test_what_is_on_another_level_changes_nothing(name, drive):
    """On a deck above a junction whose light is red; and below a deck where others drive."""
    av = DRIVES[drive]
    alone = dataclasses.replace(BOTH, lanes={"deck": DECK})
    above = on_decks(name, av, 8.0, BOTH, BELOW)
    if above[1]:
        assert on_decks(name, av, 8.0, alone, {})[1]
    elif name in {"av_red_run", "av_late_at_signal", "av_signal_braking", "av_beyond_stop_line",
                  "av_crossing_taken", "av_right_of_way_taken"}:  # fmt: skip
        assert above[0] == 0.0
    else:
        assert above[0] == pytest.approx(on_decks(name, av, 8.0, alone, {})[0])
    flat = dataclasses.replace(ROAD, polygons=BOTH.polygons)
    over = {"over": (straight(60, 0, 0), 8.0), "walks over": (BELOW["walks"][0], 8.0)}
    assert on_decks(name, av, 0.0, BOTH, over) == on_decks(name, av, 0.0, flat, {})


def test_who_walks_on_a_deck_above_a_crossing_is_not_on_it():
    walks = {"walks over": (BELOW["walks"][0], 8.0)}
    assert on_decks("av_crossing_taken", DRIVES["on"], 8.0, BOTH, walks)[0] == 0.0


def test_without_heights_the_light_and_the_crossing_below_would_count():
    assert on_decks("av_red_run", DRIVES["on"], 0.0, BOTH, BELOW)[0] == 1.0
    assert on_decks("av_crossing_taken", DRIVES["on"], 0.0, BOTH, BELOW)[0] == 1.0
