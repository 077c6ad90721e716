"""Where the opponent drives: off the road, against the traffic, over red."""

import dataclasses

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.scene import Lane, RoadMap, Signals, SignalState, TrafficCase
from deepmf_sumo.scene.geometry.road import against_traffic, on_road

from tests.support.rollout_doubles import case_of, rollout_of, straight

AV = straight(0, -30, 10)


def lane(name, points, **more):
    centre = np.array(points, float)
    return Lane(id=name, kind="street", centre_m=centre, z_m=np.zeros(len(centre)), **more)


def crossroads():
    """Eastwards at y = 0, westwards at y = 4, northwards at x = 50, a cycle lane at y = -5."""
    east = lane("east", [[-200, 0], [0, 0], [200, 0]], width_m=3.5)
    west = lane("west", [[200, 4], [-200, 4]], width_m=3.5)
    north = lane("north", [[50, -100], [50, 100]])
    bike = dataclasses.replace(lane("bike", [[-200, -5], [200, -5]]), kind="bike")
    short = lane("short", [[0, 20]])
    return RoadMap(lanes={one.id: one for one in (east, west, north, bike, short)})


def case_on(road, signals=None):
    case = case_of()
    scene = dataclasses.replace(case.scene, road=road, signals=signals or case.scene.signals)
    return dataclasses.replace(case, road=road, scene=scene)


def lit(state, red_until=91):
    """Lights of ``east`` (stop line at x = 30) and of a lane beside it that begins there too."""
    both = np.full((2, 91), SignalState.GO)
    both[:, :red_until] = np.array(state)[:, None]
    return Signals(
        lane_ids=("east", "unknown"),
        state=both,
        seen=np.ones((2, 91), bool),
        stop_m=np.array([[30.0, 0.0], [30.0, 0.0]]),
    )


def measured(name, path, case, kind="vehicle"):
    rollout = rollout_of({"av": AV, "b": path})
    tracks = dataclasses.replace(rollout.tracks, kinds=("vehicle", kind))
    rollout = dataclasses.replace(rollout, tracks=tracks)
    lights = tuple(case.scene.signals.at(step) for step in range(10, 90))
    shown = dataclasses.replace(rollout, signals=lights)
    return plugins.load("metrics", name).measure(shown, case).value


def test_off_the_road():
    leaving = straight(0, 0, 10)
    leaving[71:, 1] = -5.0  # onto the cycle lane, for the last 20 of 80 steps
    assert measured("offroad_share", leaving, case_on(crossroads())) == pytest.approx(0.25)
    assert measured("on_road", leaving, case_on(crossroads())) == pytest.approx(0.75)
    as_cyclist = measured("offroad_share", leaving, case_on(crossroads()), "cyclist")
    assert as_cyclist == 0.0  # people can be there
    leaving[51:71, 1] = 300.0
    assert measured("on_road", leaving, case_on(crossroads()), "pedestrian") == pytest.approx(0.75)
    assert not on_road(crossroads(), np.array([[0.0, 20.0]])).any()
    assert on_road(crossroads(), np.empty((0, 2))).shape == (0,)
    assert not on_road(RoadMap(lanes={}), np.zeros((3, 2))).any()


def test_against_the_traffic():
    points = np.array([[0, 0], [0, 0], [0, 4], [0, 2], [50, 4], [0, 20.0]])
    course = np.array([0, np.pi, 0, 0, -np.pi / 2, 0])
    # between the lanes one of them goes along; at the crossing the northern lane runs against it,
    # the western across; beside the road there is nobody to be against
    expected = [False, True, True, False, False, False]
    assert against_traffic(crossroads(), points, course).tolist() == expected


def test_share_of_driving_against_the_traffic():
    overtaking = straight(-30, 0, 5)
    overtaking[31:51, 1] = 4.2  # 20 of 80 steps, in the first of which it moves across
    assert measured("wrong_way_share", overtaking, case_on(crossroads())) == pytest.approx(19 / 80)
    standing = straight(-30, 4, 0.5)
    assert measured("wrong_way_share", standing, case_on(crossroads())) == 0.0


RED, GO = (SignalState.STOP, SignalState.ARROW_STOP), (SignalState.STOP, SignalState.GO)
CAUTION = (SignalState.CAUTION, SignalState.UNKNOWN)


@pytest.mark.parametrize(("state", "expected"), [(RED, 1.0), (CAUTION, 0.0)])
def test_over_a_red_light(state, expected):
    # the front is at 30 m after 1.76 s
    assert measured("red_light", straight(10, 0, 10), case_on(crossroads(), lit(state))) == expected


def test_a_green_lane_beside_a_red_one_is_taken_as_its_own():
    road = crossroads()
    twin = RoadMap(lanes={**road.lanes, "unknown": lane("unknown", [[30, 0], [60, 20]])})
    assert measured("red_light", straight(10, 0, 10), case_on(twin, lit(GO))) == 0.0
    assert measured("red_light", straight(10, 0, 10), case_on(twin, lit(RED))) == 1.0
    # of the two only one is a lane of the map
    assert measured("red_light", straight(10, 0, 10), case_on(road, lit(GO))) == 1.0


@pytest.mark.parametrize(
    "path",
    [
        straight(10, 0, 1.0),  # does not reach it
        straight(40, 0, 10),  # is beyond it
        straight(10, 4, 10),  # on another lane
        straight(50, 0, 10, heading=np.pi),  # the other way
        straight(30, -20, 10, heading=np.pi / 2),  # across
    ],
)
def test_not_over_the_red_line(path):
    assert measured("red_light", path, case_on(crossroads(), lit(RED))) == 0.0


def test_red_at_the_moment_of_crossing_counts():
    # the front passes in step 28, on the lights of step 27
    for red_until, expected in ((27, 0.0), (28, 1.0)):
        case = case_on(crossroads(), lit(RED, red_until))
        assert measured("red_light", straight(10, 0, 10), case) == expected


def test_lights_of_a_network_are_those_of_the_rollout(tmp_path):
    road = RoadMap(lanes={"behind": lane("behind", [[30, 0], [60, 0]], width_m=3.2)})
    case = TrafficCase(
        name="net",
        road=road,
        av_id="av",
        duration_steps=80,
        seed=0,
        config=tmp_path / "x.sumocfg",
        start_s=0.0,
        net_file=tmp_path / "x.net.xml",
    )
    driven = rollout_of({"av": AV, "b": straight(10, 0, 10)})
    metric = plugins.load("metrics", "red_light")
    assert "traffic lights" in metric.measure(driven, case).reason
    for state, expected in ((SignalState.STOP, 1.0), (SignalState.GO, 0.0)):
        shown = dataclasses.replace(driven, signals=({"behind": state},) * 80)
        assert metric.measure(shown, case).value == expected
