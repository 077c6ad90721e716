"""Hand-overs begin where the vehicle is: what becomes of an opponent whose plan is over."""

import numpy as np
import pytest
import shapely

from deepmf_sumo.attacks import trajectory
from deepmf_sumo.judge import metrics
from deepmf_sumo.judge.metrics import collision, driving
from deepmf_sumo.planners import constant_velocity, replay
from deepmf_sumo.scene import Driver
from deepmf_sumo.sumo.simulation import simulate
from deepmf_sumo.sumo.simulation.contacts import ContactFinder
from deepmf_sumo.sumo.simulation.frame import Frame, Pose
from deepmf_sumo.sumo.simulation.ownership import continues
from deepmf_sumo.sumo.simulation.way_on import WayOn

from tests.support.simulated_worlds import (
    LANE_M,
    NOW,
    case_of,
    crossing_road,
    scene_of,
    straight_motion,
    straight_road,
)

TIME = np.arange(1, 46) / 10


def run(case, poses, backend=None, planner=None):
    policy = trajectory.TrajectoryPolicy(
        trajectory.Settings(agent="b", poses=np.array(poses).tolist())
    )
    planner = planner or replay.build(replay.Settings())
    return simulate(case, planner, policy, rng=np.random.default_rng(0), backend=backend)


def changes_lane():
    """(45, 3): from the left lane to the right one within 2.5 s, at 10 m/s; then straight on."""
    share = np.clip(TIME / 2.5, 0, 1)
    y = LANE_M - LANE_M * (10 * share**3 - 15 * share**4 + 6 * share**5)
    return np.column_stack([20 + 10 * TIME, y, np.arctan2(np.gradient(y, 0.1), 10.0)])


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """The AV comes up fast on the left lane, where the log has b for the whole time."""
    motions = {
        "av": straight_motion(0.0, LANE_M, 0.0, 14.0),
        "b": straight_motion(20.0, LANE_M, 0.0, 10.0),
    }
    return case_of(scene_of(straight_road(), motions), tmp_path_factory.mktemp("beside"))


@pytest.mark.parametrize("backend", [None, "libsumo"])
def test_an_opponent_that_the_log_has_elsewhere_stops_in_its_lane(beside, backend):
    """The AV passes it: in the log it would be where the AV is then."""
    rollout = run(beside, changes_lane(), backend)
    row, after = rollout.tracks.row("b"), NOW + len(TIME)
    x, y = rollout.tracks.position_m[row].T
    assert rollout.contacts == ()
    assert np.abs(y[after:]).max() < 0.1
    speed = rollout.tracks.speed_mps[row, after:]
    braked = np.maximum(10.0 - 3.0 * 0.1 * np.arange(len(speed)), 0.0)
    assert speed == pytest.approx(braked, abs=1e-6)
    # by hand: the mean speed of each step
    assert np.diff(x[after:]) == pytest.approx((speed[1:] + speed[:-1]) / 20, abs=1e-3)
    assert (rollout.driver[row, after:] == Driver.POLICY).all()
    (told,) = [event for event in rollout.events if event.kind == "plan_ended"]
    assert (told.step, told.detail) == (after + 1, "the log has it elsewhere: it comes to a stop")


def test_no_collision_is_made_by_the_end_of_a_plan(beside):
    keeps = constant_velocity.build(constant_velocity.Settings())
    rollout = run(beside, changes_lane(), planner=keeps)
    episode = metrics.Episode(rollout=rollout, case=beside)
    assert collision.collision.compute(episode) == 0
    assert driving.feasible.compute(episode) == 1
    boxes = [box_of(rollout, agent, step) for agent in ("av", "b") for step in (56, 57)]
    assert boxes[0].disjoint(boxes[2])
    assert boxes[1].disjoint(boxes[3])


def box_of(rollout, agent, step):
    """The box as a polygon."""
    row = rollout.tracks.row(agent)
    length, width, _ = rollout.tracks.size_m[row]
    box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    turned = shapely.affinity.rotate(
        box, rollout.tracks.heading_rad[row, step], use_radians=True, origin=(0, 0)
    )
    return shapely.affinity.translate(turned, *rollout.tracks.position_m[row, step])


@pytest.mark.parametrize("backend", [None, "libsumo"])
def test_the_log_takes_an_opponent_that_is_where_it_has_it(beside, backend):
    poses = np.column_stack([20 + 10 * TIME, np.full(45, LANE_M), np.zeros(45)])[:20]
    rollout = run(beside, poses, backend)
    row, after = rollout.tracks.row("b"), NOW + 20
    assert (rollout.driver[row, NOW + 1 : after + 1] == Driver.POLICY).all()
    assert (rollout.driver[row, after + 1 :] == Driver.LOG).all()
    (told,) = [event for event in rollout.events if event.kind == "plan_ended"]
    assert told.detail == "it is driven on from where it is"


def test_with_sumos_traffic_it_returns_to_the_middle_of_its_lane_and_sumo_drives_on(tmp_path):
    motions = {
        "av": straight_motion(0.0, 0.0, 0.0, 8.0),
        "b": straight_motion(40.0, LANE_M, 0.0, 10.0),
    }
    case = case_of(scene_of(straight_road(), motions), tmp_path, traffic="sumo")
    poses = np.column_stack([40 + 10 * TIME[:15], LANE_M - 0.6 * TIME[:15], np.full(15, -0.06)])
    rollout = run(case, poses, "libsumo")
    row = rollout.tracks.row("b")
    back = int(np.flatnonzero(rollout.driver[row] == Driver.SUMO)[-1])
    owners = rollout.driver[row, NOW + 1 :]
    first = int(np.argmax(owners == Driver.SUMO))
    assert 15 < first < 60
    assert (owners[first:] == Driver.SUMO).all()
    y = rollout.tracks.position_m[row, NOW + 1 :, 1]
    assert np.abs(np.diff(y)).max() < 0.15
    assert rollout.tracks.position_m[row, back, 1] == pytest.approx(LANE_M, abs=0.11)
    assert {event.kind for event in rollout.events} >= {"plan_ended", "handed_back"}


STILL = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0, speed_mps=10.0)


@pytest.mark.parametrize(
    ("x", "y", "heading", "speed", "does"),
    [
        (1.0, 0.0, 0.0, 10.0, True),
        (1.2, 0.1, 0.05, 10.5, True),
        (1.4, 0.0, 0.0, 10.0, False),
        (1.0, 0.3, 0.0, 10.0, False),
        (1.0, 0.0, 0.2, 10.0, False),
        (0.9, 0.0, 0.0, 8.0, False),
        (3.2, 0.0, 0.0, 10.0, False),
    ],
)
def test_what_a_vehicle_reaches_in_a_step(x, y, heading, speed, does):
    pose = Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed)
    assert continues(STILL, pose) is does


def driven(way, steps, free=True):
    """(steps, 4) x, y, heading, speed."""
    poses = [way.next(lambda _: free) for _ in range(steps)]
    return np.array([[one.x_m, one.y_m, one.heading_rad, one.speed_mps] for one in poses])


def test_the_way_on_follows_a_bend_and_is_as_gentle_as_a_car():
    x = np.linspace(0, np.pi / 2, 40)
    road = straight_road()
    bend = np.column_stack([100 + 25 * np.sin(x), -25 + 25 * np.cos(x)])
    lanes = {"right": lane_like(road.lanes["right"], bend)}
    start = Pose(x_m=100.0, y_m=0.8, heading_rad=0.0, speed_mps=8.0)
    rows = driven(WayOn(type(road)(lanes=lanes), start, 0.0, 5.0, lambda _: 0.0), 70)
    off = shapely.LineString(bend).distance(shapely.points(rows[:, :2]))
    assert off[40:].max() < 0.15
    assert np.abs(np.diff(rows[:, 3])).max() <= 0.3 + 1e-9
    curvature = np.diff(rows[:, 2]) / 0.1 / rows[1:, 3]
    assert np.abs(curvature).max() < 0.2


def lane_like(lane, line):
    return type(lane)(id=lane.id, kind="street", centre_m=line, z_m=np.zeros(len(line)))


def test_the_way_on_waits_where_it_is_not_clear_and_stops_straight_on_without_a_lane():
    road, off = straight_road(), Pose(x_m=50.0, y_m=-8.0, heading_rad=0.0, speed_mps=0.0)
    rows = driven(WayOn(road, off, 0.0, 5.0, lambda _: 0.0), 30, free=False)
    assert np.ptp(rows, axis=0).max() == 0.0
    far = Pose(x_m=50.0, y_m=-80.0, heading_rad=0.3, speed_mps=-2.0)
    rows = driven(WayOn(road, far, 0.0, 5.0, lambda _: 0.0), 30)
    assert rows[-1, 3] == 0.0
    assert np.ptp(rows[:, 2]) == 0.0
    assert rows[-1, 0] < 50.0  # it rolled back


def test_the_way_on_keeps_to_its_lanes_at_a_junction():
    road = crossing_road()
    start = Pose(x_m=1.0, y_m=-40.0, heading_rad=np.pi / 2, speed_mps=5.0)
    rows = driven(WayOn(road, start, 0.0, 5.0, lambda _: 0.0), 140)
    assert rows[-1, 1] > 20.0
    assert np.abs(rows[60:, 0]).max() < 0.1


def judged(*frames):
    judge = ContactFinder("av", ("ov",))
    for step, (gap, driver) in enumerate(frames):
        poses = {
            "av": (Pose(x_m=0.0, y_m=0.0, heading_rad=0.0, speed_mps=0.0), Driver.PLANNER),
            "ov": (Pose(x_m=4.0 + gap, y_m=0.0, heading_rad=0.0, speed_mps=-3.0), driver),
        }
        judge.look(step, Frame.of_poses(poses), np.tile([4.0, 2.0], (2, 1)))
    return [one.step for one in judge.contacts], [one.kind for one in judge.events]


def test_no_contact_counts_in_the_step_of_a_hand_over():
    policy, log = Driver.POLICY, Driver.LOG
    assert judged((1.0, policy), (-0.5, policy)) == ([1], [])
    for before, after in ((policy, log), (log, policy), (policy, Driver.SUMO)):
        assert judged((1.0, before), (-0.5, after), (-1.0, after)) == ([], ["overlap_at_hand_over"])


def test_a_pair_that_overlaps_at_the_first_frame_collides_once_it_has_been_apart():
    one = Driver.SUMO
    assert judged((-1.0, one), (15.0, one), (-0.5, one)) == ([2], ["overlap_at_start"])
    trembles = (-0.1, one), (0.1, one), (-0.1, one)
    assert judged(*trembles) == ([], ["overlap_at_start"])


@pytest.mark.parametrize("backend", [None, "libsumo"])
def test_so_it_is_in_an_episode_with_and_without_sumo(tmp_path, backend):
    x = np.concatenate([np.full(30, 4.0), np.linspace(4.0, 12.0, 20), np.linspace(12.0, 2.0, 41)])
    b = np.column_stack([60 + x, np.zeros((91, 3))])
    b[1:, 3] = np.diff(b[:, 0]) * 10
    motions = {"av": straight_motion(60.0, 0.0, 0.0, 0.0), "b": b}
    case = case_of(scene_of(straight_road(), motions), tmp_path)
    policy = None
    rollout = simulate(
        case,
        replay.build(replay.Settings()),
        policy,
        rng=np.random.default_rng(0),
        backend=backend,
    )
    assert [event.kind for event in rollout.events if "overlap" in event.kind] == [
        "overlap_at_start"
    ]
    (contact,) = rollout.contacts
    assert x[contact.step] < 4.6 <= x[contact.step - 1]
