"""SUMO's own pose is shown; a lane change that SUMO makes in one step is spread over 3 s."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sumo

from deepmf_sumo.scene import Command
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.shown_motion import ShownMotion

from tests.support.shown_motion import AT_ONCE, compare

ROOT = Path(__file__).parents[3]
NETWORKS = ROOT.parent / "shared" / "networks"
OURS = ["arterial", "four_way", "highway", "roundabout", "rural"]
GAMES = ["A10KW", "corridor", "cross", "fkk_in", "grid6"]
REAL = ["cologne1/cologne1", "lucas4x4/4x4", "wildau/flow1_Spaet"]
LANES_M = {"ab_0": 0.0, "ab_1": 3.2, "cd_1": 3.2}


class Road:
    """Stands for SUMO: straight lanes of 300 m along x, and one vehicle."""

    def __init__(self):
        self.lane_id, self.along = "ab_0", 0.0
        self.TraCIException = RuntimeError
        self.vehicle = SimpleNamespace(
            getLaneID=lambda _: self.lane_id, getLanePosition=lambda _: self.along
        )
        self.lane = SimpleNamespace(
            getShape=lambda lane: ((0.0, LANES_M[lane]), (300.0, LANES_M[lane])),
            getLength=lambda _: 300.0,
        )

    def drive(self, motion, lane, x, left=0.0, speed=10.0, heading=0.0):
        """Sideways position of what is shown of a vehicle whose front is at ``x``."""
        self.lane_id, self.along = lane, x
        centre = np.array([x, LANES_M[lane] + left])
        centre -= 2.5 * np.array([np.cos(heading), np.sin(heading)])
        pose = Pose(x_m=centre[0], y_m=centre[1], heading_rad=heading, speed_mps=speed)
        return motion.advance(pose)


@pytest.fixture
def road():
    return Road()


@pytest.fixture
def motion(road):
    return ShownMotion(road, "av", 5.0)


@pytest.mark.parametrize("leads_on", [True, False])
def test_an_av_that_stands_does_not_change_lanes_unless_its_route_needs_it(leads_on):
    mode, speed = [1621], [5.0]
    vehicle = SimpleNamespace(
        getLaneID=lambda _: "ab_0",
        getBestLanes=lambda _: (("ab_0", 300.0, 0.0, 0, leads_on, ()), ("ab_1", 0, 0, 0, True, ())),
        getLaneChangeMode=lambda _: mode[-1],
        setLaneChangeMode=lambda _, value: mode.append(value),
        getSpeed=lambda _: speed[-1],
        getLeader=lambda *_: None,
        setSpeedMode=lambda *_: None,
        setSpeed=lambda *_: None,
    )
    pose = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0, speed_mps=5.0)
    av = SumoAv(SimpleNamespace(vehicle=vehicle), "av", 5.0, pose)
    for speed_mps in (5.0, 0.0, 0.05, 1.0, 0.0):
        speed.append(speed_mps)
        av.drive(Command(kind="sumo"))
    assert mode == ([1621, 0, 1621, 0] if leads_on else [1621])


def test_a_lane_change_takes_three_seconds_and_ends_on_the_new_lane(road, motion):
    road.drive(motion, "ab_0", 9.0)
    shown = [road.drive(motion, "ab_1", 10.0 + step) for step in range(40)]
    sideways = np.diff([0.0, *(one.y_m for one in shown)])
    assert sideways.min() >= -1e-12
    assert sideways.max() == pytest.approx(3.2 / 30)
    assert shown[28].y_m < 3.2 == pytest.approx(shown[29].y_m)
    assert {one.heading_rad for one in shown} == {0.0}


def test_it_goes_on_while_the_vehicle_stands(road, motion):
    road.drive(motion, "ab_0", 10.0, speed=0.0)
    shown = [road.drive(motion, "ab_1", 10.0, speed=0.0).y_m for _ in range(30)]
    assert shown[0] == pytest.approx(3.2 / 30)
    assert shown[-1] == pytest.approx(3.2)


@pytest.mark.parametrize("heading", [0.5, 0.7, -0.7])
def test_it_is_spread_while_the_vehicle_is_still_in_a_turn(road, motion, heading):
    road.drive(motion, "ab_0", 9.0, heading=heading)
    shown = [road.drive(motion, "ab_1", 10.0 + step, heading=heading) for step in range(30)]
    front = [one.y_m + 2.5 * np.sin(one.heading_rad) for one in shown]
    assert front[0] == pytest.approx(0.1, abs=0.15)
    assert max(np.diff(front)) < 0.25
    assert front[-1] == pytest.approx(3.2, abs=0.11)


def test_it_ends_with_the_edge(road, motion):
    road.drive(motion, "ab_0", 289.0)
    shown = [road.drive(motion, "ab_1", 290.0 + step).y_m for step in range(11)]
    assert shown[4] == pytest.approx(1.6, abs=0.2)
    assert shown[-1] == pytest.approx(3.2)
    assert road.drive(motion, "cd_1", 0.5).y_m == 3.2


def test_a_change_back_stays_between_the_lanes(road, motion):
    road.drive(motion, "ab_0", 9.0)
    shown = [road.drive(motion, "ab_1", 10.0 + step).y_m for step in range(10)]
    shown += [road.drive(motion, "ab_0", 20.0 + step).y_m for step in range(40)]
    assert max(shown) < 1.2
    assert min(shown) > -1e-9
    assert shown[-1] == pytest.approx(0.0)


def test_a_rear_that_stays_on_the_old_lane_does_not_turn_the_box(road, motion):
    """SUMO's vehicle is askew until its rear reaches the edge, and straight then."""
    askew = float(np.arcsin(3.2 / 5.0))
    road.drive(motion, "ab_0", 1.0)
    shown = [road.drive(motion, "ab_1", 2.0 + step, heading=askew) for step in range(3)]
    shown += [road.drive(motion, "ab_1", 5.0 + step) for step in range(10)]
    assert max(abs(one.heading_rad) for one in shown) < 0.1
    assert max(np.diff([0.0, *(one.y_m for one in shown)])) < 0.35


@pytest.mark.parametrize(
    ("x", "left"),
    [(40.0, 0.0), (10.0, -1.55)],
    ids=["a teleport", "a crossing of the border that SUMO spreads itself"],
)
def test_all_else_is_shown_as_sumo_has_it(road, motion, x, left):
    road.drive(motion, "ab_0", 9.0, left=1.55)
    assert road.drive(motion, "ab_1", x, left=left).y_m == 3.2 + left
    assert road.drive(motion, "ab_1", x + 1, left=left).y_m == 3.2 + left


def test_a_box_that_sumo_turns_in_a_step_is_not_spread(road, motion):
    """Its bumpers move to the side, and its middle goes where it looks on average."""
    ahead, left = 2.5 * np.cos(0.7), 2.5 * np.sin(0.7)
    for x in (6.5, 7.5):
        road.drive(motion, "ab_0", x + ahead, left=left, heading=0.7)
    y = np.sin(0.35)
    shown = road.drive(motion, "ab_0", 7.5 + np.cos(0.35) + 2.5, left=y)
    assert (shown.y_m, shown.heading_rad) == pytest.approx((y, 0.0))


def test_the_rear_of_a_train_that_turns_a_little_is_not_spread(road):
    """Its locomotive turns by a degree a step: 130 m behind, the rear moves 2.3 m to the side."""
    train, front = ShownMotion(road, "av", 130.0), np.array([150.0, 0.0])
    road.lane_id, road.along = "ab_0", 150.0
    for degrees in (0, 0, 1, 2, 3, 3):
        front[0] += 3.3
        heading = np.radians(degrees)
        centre = front - 65.0 * np.array([np.cos(heading), np.sin(heading)])
        pose = Pose(x_m=centre[0], y_m=centre[1], heading_rad=heading, speed_mps=33.0)
        assert train.advance(pose) == pose


def test_a_rear_that_jumps_farther_than_the_vehicle_drives_is_spread(road, motion):
    """The front goes on, the rear comes over by 1.5 m in a step of 0.2 m."""
    for x in (9.6, 9.8):
        road.drive(motion, "ab_0", x, speed=2.0)
    heading = float(np.arcsin(1.5 / 5.0))
    shown = road.drive(motion, "ab_0", 10.0, speed=2.0, heading=heading)
    assert 0.0 < shown.heading_rad < 0.1 * heading


def test_a_lane_shorter_than_the_vehicle_says_nothing_of_its_direction(road, motion):
    road.lane.getShape = lambda lane: ((0.0, 0.0), (2.0, 2.0) if lane == "kink" else (9.0, 9.0))
    pose = Pose(x_m=0.0, y_m=0.0, heading_rad=0.1, speed_mps=10.0)
    assert motion._direction_rad("kink", pose) == 0.1
    assert motion._direction_rad("long", pose) == pytest.approx(np.pi / 4)


def test_after_a_restart_nothing_is_spread(road, motion):
    road.drive(motion, "ab_0", 9.0)
    motion.restart()
    assert road.drive(motion, "ab_1", 10.0).y_m == 3.2


def same_as_sumo(row):
    assert row.vehicles > 10
    assert row.apart_m < 1e-6
    assert row.between_m < 0.05
    assert row.back_m < 0.05
    assert row.beyond_m < 0.0501  # netconvert leaves 0.1 m between two lanes
    assert row.more_sideways_m < 0.05


@pytest.mark.parametrize("name", OURS)
def test_shown_motion_is_sumos(name):
    """Own option of each: SUMO spreads lane changes itself, so there is nothing to spread."""
    row = compare(ROOT / "sumo_nets" / name / f"{name}.sumocfg", 60.0, most=60)
    same_as_sumo(row)
    assert row.spread == 0


@pytest.mark.parametrize("name", ["arterial", "four_way", "highway"])
def test_lane_changes_at_once_are_spread(name):
    row = compare(ROOT / "sumo_nets" / name / f"{name}.sumocfg", 60.0, AT_ONCE, most=60)
    same_as_sumo(row)
    assert row.spread > 0.8 * row.changes > 5


@pytest.mark.slow
@pytest.mark.parametrize("name", GAMES)
def test_shown_motion_is_sumos_in_its_games(name):
    config = Path(sumo.SUMO_HOME) / "tools" / "game" / f"{name}.sumocfg"
    same_as_sumo(compare(config, 200.0, AT_ONCE, most=100))


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_shown_motion_is_sumos_on_real_networks(name):
    config = NETWORKS / f"{name}.sumocfg"
    if not config.is_file():
        pytest.skip("the real networks are not there")
    row = compare(config, 300.0, AT_ONCE, most=200)
    same_as_sumo(row)
    assert row.spread > 0
