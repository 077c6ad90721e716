"""The words for a hit: its conflict, priority, and what the AV did."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge import conflict_types, hits
from deepmf_sumo.judge.conflict_types import Meeting
from deepmf_sumo.judge.hits import hit_of
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.scene import Lane, RoadMap, SignalState

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

STEP = 50


def turning(x, y, speed, heading, turn, steps=STEP + 1, begin=20):
    """(T, 3) poses of a vehicle that begins to turn at a step, all of it within 2 s."""
    angle = heading + turn * np.clip((np.arange(steps) - begin) / 20, 0, 1)
    way = np.cumsum(0.1 * speed * np.column_stack([np.cos(angle), np.sin(angle)]), axis=0)
    return np.column_stack([way - way[0] + [x, y], angle])


def ending(path, x, y):
    """The path moved so that it ends at a place."""
    return path - [path[-1, 0] - x, path[-1, 1] - y, 0.0]


def shifting(x, y, speed, aside, steps=STEP + 1):
    """A vehicle to the east that changes its lane in the last 2 s."""
    path = straight(x, y, speed, steps=steps, now=steps - 1)
    share = np.clip((np.arange(steps) - (steps - 21)) / 20, 0, 1)
    path[:, 1] += aside * (share - 1)
    return path


EAST = straight(0, 0, 10, steps=STEP + 1, now=STEP)
MET = {
    "rear-end": (straight(4.7, 0, 5, steps=STEP + 1, now=STEP), "ahead"),
    "rear-end behind": (straight(-4.7, 0, 14, steps=STEP + 1, now=STEP), "behind"),
    "crossing": (straight(2, 2, 8, steps=STEP + 1, heading=-np.pi / 2, now=STEP), "left"),
    "crossing right": (straight(2, -2, 8, steps=STEP + 1, heading=np.pi / 2, now=STEP), "right"),
    "left turn across path": (
        ending(turning(0, 0, 8, np.pi, np.pi / 2, begin=30), 3.0, 1.5),
        "ahead",
    ),
    "right turn across path": (
        ending(turning(0, 0, 8, np.pi, -np.pi / 2, begin=30), 3.0, -1.5),
        "ahead",
    ),
    "merging": (ending(turning(0, 0, 8, np.pi / 2, -np.pi / 2, begin=29), 4.0, -1.0), "right"),
    "lane change": (shifting(4.5, 1.0, 8, -3.5), "left"),
    "head-on": (straight(4.7, 0.3, 9, steps=STEP + 1, heading=np.pi, now=STEP), "ahead"),
}


def pair_of(other, av=EAST, road=None):
    rollout = rollout_of({"av": av, "b": other})
    poses = {"pose_first": av[-1], "pose_second": other[-1]}
    rollout = replace(rollout, contacts=(replace(contact_of(step=STEP), **poses),))
    return rollout, Meeting.of(rollout.tracks, ("av", "b"), STEP, road)


@pytest.mark.parametrize(("begin", "late"), [(25, False), (35, True)])
def test_braking_is_late_a_second_after_the_onset(begin, late):
    """The other stands 4.7 m beyond where they meet; the AV sees it from step 15 on."""
    speed = np.maximum(10.0 - 0.3 * np.maximum(np.arange(STEP + 1) - begin, 0), 1.0)
    x = np.concatenate([[0.0], np.cumsum(0.05 * (speed[1:] + speed[:-1]))])
    av = np.column_stack([x - x[-1], np.zeros((STEP + 1, 2))])
    stands = straight(4.7, 0, 0, steps=STEP + 1, now=STEP)
    rollout, _ = pair_of(stands, av)
    found = hits.described(rollout, None, None, begin=15, ran_red=False)
    assert 15 <= found.onset < 20
    assert found.late == late
    assert found.braking_mps2 == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize("name", MET)
def test_the_conflict_and_where_the_opponent_came_from(name):
    other, side = MET[name]
    if name == "lane change":
        other = shifting(4.5, 1.0, 8, -2.5)
    _, pair = pair_of(other)
    assert pair.type == name.removesuffix(" behind").removesuffix(" right")
    assert pair.side(pair.first) == side


def test_a_turn_that_was_over_before_is_not_one_across_the_path():
    av = ending(turning(0, 0, 8, np.pi / 2, -np.pi / 2, begin=-5), 0.0, 0.0)
    _, pair = pair_of(MET["head-on"][0], av)
    assert pair.first == 0  # 4 s before the contact the AV was turning
    assert pair.type == "head-on"


def test_directions_are_those_of_4_s_but_the_onset_may_be_earlier():
    paths = [straight(x, 0, v, steps=81, now=80) for x, v in ((0, 10), (4.7, 5))]
    rollout = rollout_of(dict(zip(("av", "b"), paths, strict=True)))
    pair = Meeting.of(rollout.tracks, ("av", "b"), 80, None)
    assert (pair.since, pair.first) == (0, 40)


def lanes_of(**lines):
    """A map of lanes by name: points, and which lanes follow."""
    return RoadMap(
        lanes={
            name: Lane(
                id=name, kind="street", centre_m=np.array(points, float),
                z_m=np.zeros(len(points)), **more,
            )
            for name, (points, more) in lines.items()
        }
    )  # fmt: skip


def test_vehicles_of_roads_that_join_merge():
    on = ([(-10, 0), (200, 0)], {})
    ramp, onward = [(-200, 3.0), (-10, 3.0)], {"next": ("on",)}
    road = lanes_of(main=([(-200, 0), (-10, 0)], onward), ramp=(ramp, onward), on=on)
    assert conflict_types._ahead(road, "main") == {"main", "on"}
    other = shifting(4.5, 1.0, 8, -2.5)
    assert pair_of(other)[1].type == "lane change"
    _, pair = pair_of(other, road=road)
    assert (pair.type, pair.turned()) == ("merging", "opponent")


def test_a_road_that_bends_is_not_a_turn():
    """Both keep to the lanes of a road that bends by 40 degrees, until they meet head-on."""
    bend = np.radians(40)
    east = ending(turning(0, 0, 10, 0, bend), 0.0, 0.0)
    line = np.concatenate([east[:, :2], 30 * np.array([[np.cos(bend), np.sin(bend)]])])
    x, y = 4.6 * np.cos(bend), 4.6 * np.sin(bend)
    back = straight(x, y, 9, steps=STEP + 1, heading=bend - np.pi, now=STEP)
    assert pair_of(back, east)[1].type == "left turn across path"  # by directions alone
    _, pair = pair_of(back, east, lanes_of(mine=(line, {}), theirs=(line[::-1], {})))
    assert (pair.type, pair.side(pair.first)) == ("head-on", "ahead")


def test_a_begun_turn_counts_on_a_lane_that_turns():
    """The oncoming vehicle has turned by 17 degrees only, on a lane that bends by 90."""
    other = ending(turning(0, 0, 8, np.pi, np.radians(17), begin=30), 4.6, 0.6)
    turn = [(12, 1.5), (4, 1.2), (0, -3), (0, -30)]
    assert pair_of(other)[1].type == "head-on"
    inside = {"interpolating": True, "previous": ("west",)}
    road = lanes_of(west=([(90, 1.5), (12, 1.5)], {"next": ("left",)}), left=(turn, inside))
    _, pair = pair_of(other, road=road)
    assert (pair.type, pair.turned()) == ("left turn across path", "opponent")


def test_an_opponent_beside_its_lane_has_left_it():
    """It drives 1 m left of its lane, into the AV, which keeps to its own."""
    mine, theirs = [(-100, 0), (60, 0)], [(60, 2.4), (-60, 2.4)]
    road = lanes_of(mine=(mine, {}), theirs=(theirs, {}))
    assert pair_of(straight(4.7, 0.7, 9, steps=51, heading=np.pi, now=STEP), road=road)[1].strayed()
    beside = straight(4.7, 2.2, 9, steps=51, heading=np.pi, now=STEP)
    assert not pair_of(beside, road=road)[1].strayed()


def test_that_which_stands_has_not_changed_lanes():
    """The other drives past obliquely and touches the side of the standing AV."""
    av = straight(0, 0, 0, steps=STEP + 1, now=STEP)
    _, pair = pair_of(shifting(1.0, 1.7, 8, -2.0), av)
    assert (pair.type, pair.turned()) == ("lane change", "opponent")
    _, pair = pair_of(av, shifting(-1.0, 1.7, 8, -2.0))
    assert (pair.type, pair.turned()) == ("lane change", "AV")


def test_a_vehicle_that_evades_has_not_moved_over():
    """Both move to the right; the one that moves toward the other is named."""
    _, pair = pair_of(shifting(1.0, 1.7, 10, -3.0), shifting(0, 0, 10, -1.0))
    assert (pair.type, pair.turned()) == ("lane change", "opponent")


def braking():
    return straight(0, 0, 10, steps=51, accel=-4.0)


@pytest.mark.parametrize(
    ("path", "action"),
    [
        (straight(0, 0, 10, steps=51), "held speed"),
        (straight(0, 0, 10, steps=51, accel=-2.0), "braked"),
        (straight(0, 0, 10, steps=51, accel=2.0), "accelerated"),
        (straight(0, 0, 0, steps=51), "stood"),
        (braking()[np.minimum(np.arange(51), 33)], "stopped"),
        (np.where(np.arange(51)[:, None] < 45, 0, straight(0, 0, 1, steps=51, now=44)), "set off"),
        (shifting(40, 0, 10, -2.0), "steered"),
    ],
)
def test_what_the_av_did(path, action):
    line = np.array([[-50.0, 0.0], [200.0, 0.0]])
    lane = Lane(id="a", kind="street", centre_m=line, z_m=np.zeros(2))
    tracks = rollout_of({"av": path, "b": straight(20, 0, 5, steps=51)}).tracks
    assert hits._action(tracks, 0, 20, STEP, RoadMap(lanes={"a": lane})) == action


@pytest.mark.parametrize(
    ("mine", "theirs", "priority"),
    [
        (SignalState.STOP, SignalState.GO, "opponent"),
        (SignalState.GO, SignalState.STOP, "AV"),
        (SignalState.GO, SignalState.CAUTION, ""),
        (SignalState.GO, SignalState.GO, ""),
        (SignalState.STOP, None, ""),
    ],
)
def test_that_whose_light_let_it_go_has_priority(mine, theirs, priority):
    """Both pass their stop lines 10 m before they meet."""
    rollout, pair = pair_of(MET["crossing"][0])
    lanes = {
        "av": np.array([[-10.0, 0.0], [20.0, 0.0]]),
        "b": np.array([[2.0, 12.0], [2.0, -20.0]]),
    }
    road = RoadMap(
        lanes={
            name: Lane(id=name, kind="street", centre_m=line, z_m=np.zeros(2))
            for name, line in lanes.items()
        }
    )
    lights = {name: state for name, state in (("av", mine), ("b", theirs)) if state is not None}
    rollout = replace(rollout, signals=(lights,) * (STEP - rollout.now))
    assert hits._by_lights(rollout, pair, road) == priority


def test_who_drives_over_a_junction_as_no_lane_leads_came_by_its_own_road():
    """From the south over a way that belongs to those from the south-east."""

    def lane(name, *points, **named):
        line = np.array(points, float)
        return Lane(id=name, kind="street", centre_m=line, z_m=np.zeros(len(line)), **named)

    road = RoadMap(lanes={one.id: one for one in (
        lane("west", (-80, 6), (-20, 6)),
        lane("south", (0, -80), (0, -8)),
        lane("far", (60, -60), (4, -4)),
        lane("over", (4, -4), (-12, 12), interpolating=True, previous=("far",)),
    )})  # fmt: skip
    other = ending(turning(0, 0, 6, np.pi / 2, np.pi / 4, begin=30), -6, 6)
    av = np.tile([-9.5, 6.0, 0.0], (STEP + 1, 1))
    rollout = rollout_of({"av": av, "b": other}, [contact_of(step=STEP)])
    met = Meeting.of(rollout.tracks, ("av", "b"), STEP, road)
    assert {"south", "over"} <= set(met.lanes[1])
    assert met.courses[1].came_rad == pytest.approx(np.pi / 2, abs=0.01)
    assert (met.type, met.side(STEP - 20)) == ("crossing", "right")


def test_who_yields_by_the_map_has_no_priority():
    other, _ = MET["crossing right"]
    east = Lane(id="east", kind="street", centre_m=np.array([[-60.0, 0], [60, 0]]), z_m=np.zeros(2))
    north = Lane(
        id="north",
        kind="street",
        centre_m=np.array([[2.0, -60], [2, 60]]),
        z_m=np.zeros(2),
        gives_way_to=("east",),
    )
    swapped = replace(east, gives_way_to=("north",)), replace(north, gives_way_to=())
    neither = east, replace(north, gives_way_to=())
    for lanes, priority in (((east, north), "AV"), (swapped, "opponent"), (neither, "")):
        _, pair = pair_of(other, road=RoadMap(lanes={one.id: one for one in lanes}))
        assert hits._by_map(pair) == priority


def test_a_hit_is_described_without_a_result_folder():
    """The opponent ahead brakes from 12 to 0 m/s, and the AV, at 10 m/s, drives into it."""
    slows = straight(20, 0, 12, accel=-4.0)
    slows[41:, 0] = slows[40, 0]  # it stands 3 s later, 38 m ahead of where the AV was
    paths = {"av": straight(0, 0, 10), "b": slows}
    rollout = rollout_of(paths, [contact_of(step=44)])
    case = case_of({"av": straight(0, 0, 10), "b": straight(20, 0, 12)})
    hit = hit_of(Episode(rollout, case))
    assert (hit.conflict, hit.side, hit.turned, hit.priority) == (
        "rear-end", "ahead", "opponent", "opponent",
    )  # fmt: skip
    assert (hit.action, hit.strayed, hit.ran_red, hit.opponent) == (
        "held speed", False, False, "car",
    )  # fmt: skip
    assert hit.stood
    # 0.5 m less than the log after 0.5 s of braking with 4 m/s2
    assert hit.onset == pytest.approx(10 + 5, abs=1)
    assert hit_of(Episode(rollout_of(paths), case)) is None


@pytest.mark.parametrize(
    ("speeds", "action"),
    [
        ([12, 10, 8, 6], "braked"),
        ([11.3, 9, 7.8, 9, 10], "accelerated"),
        ([12, 8, 9, 9.5], "braked"),
        ([8, 8.2, 8.4], "held speed"),
        ([8, 9, 10], "accelerated"),
        ([0, 1, 3], "set off"),
    ],
)
def test_what_the_av_did_is_what_changed_most_up_to_the_hit(speeds, action):
    assert hits._by_speed(np.array(speeds, float)) == action
