"""Episodes of recordings: exact starts, exact replay, perception, determinism."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.errors import PlannerError, SimulationError
from deepmf_sumo.planners import constant_velocity, idm, replay, sumo
from deepmf_sumo.scene import Command, Driver, Plan
from deepmf_sumo.scene.car_following import TREIBER
from deepmf_sumo.sumo.simulation import log_world, simulate

from tests.support.simulated_worlds import (
    LANE_M,
    NOW,
    STEPS,
    case_of,
    crossing_road,
    red_light,
    scene_of,
    straight_motion,
    straight_road,
)

EAST, NORTH = 0.0, np.pi / 2


def run(case, planner, policy=None, **more):
    return simulate(case, planner, policy, rng=np.random.default_rng(0), **more)


def lane_idm():
    return idm.build(idm.Settings())


def corridor_idm():
    return idm.build(idm.Settings(perception="corridor"))


def speeds(rollout, agent):
    return rollout.tracks.speed_mps[rollout.tracks.row(agent), NOW:]


class Follow:
    """A policy that plans given poses once: an agent at constant velocity from a pose."""

    period_steps = None

    def __init__(self, agent, x, y, heading, speed, steps=80):
        self.agent, self.steps = agent, steps
        self.motion = straight_motion(x, y, heading, speed, steps + NOW + 1)[NOW + 1 :]
        self.views = []

    def reset(self, view, rng):
        self.views.append(view)
        return (self.agent,)

    def plan(self, view):
        self.views.append(view)
        x, y, heading, speed = self.motion.T
        return {
            self.agent: Plan(
                agent_id=self.agent,
                first_step=view.step + 1,
                position_m=np.column_stack([x, y]),
                heading_rad=heading,
                speed_mps=speed,
            )
        }


@pytest.fixture(scope="module")
def following(tmp_path_factory):
    """The AV behind a slower car, another beside it, a parked car and a pedestrian off the road."""
    motions = {
        "av": straight_motion(60.0, 0.4, EAST, 12.0),
        "lead": straight_motion(84.0, -0.2, EAST, 10.0),
        "beside": straight_motion(66.0, LANE_M, EAST, 11.0),
        "parked": straight_motion(120.0, -9.0, 0.3, 0.0),
        "walker": straight_motion(100.0, -6.0, NORTH, 0.2),
    }
    scene = scene_of(straight_road(), motions, kinds={"walker": "pedestrian"})
    return case_of(scene, tmp_path_factory.mktemp("following"))


@pytest.mark.parametrize("y", [0.0, 0.4, -0.9])
def test_av_stands_exactly_at_its_recorded_pose_and_speed(tmp_path, y):
    scene = scene_of(straight_road(), {"av": straight_motion(60.0, y, EAST, 12.0)})
    case = case_of(scene, tmp_path)
    with log_world.opened(case, TREIBER, "libsumo") as (_, world):
        pose = world.av.sumo_pose()
        assert np.hypot(pose.x_m - 60.0, pose.y_m - y) < 1e-3
        assert abs(pose.heading_rad) < 1e-6
        assert abs(pose.speed_mps - 12.0) < 0.01


@pytest.mark.parametrize(("heading", "noted"), [(0.02, False), (0.2, True)])
def test_a_start_askew_is_aligned_within_a_second_and_a_half_and_noted(tmp_path, heading, noted):
    motion = straight_motion(60.0, 0.0, EAST, 12.0)
    motion[:, 2] = heading
    scene = scene_of(straight_road(), {"av": motion})
    rollout = run(case_of(scene, tmp_path), lane_idm())
    aligned = [event.detail for event in rollout.events if event.kind == "aligned"]
    assert [detail.endswith("sideways, 11 degrees") for detail in aligned] == [True] * noted
    row = rollout.tracks.row("av")
    turned = np.diff(rollout.tracks.heading_rad[row, NOW:])
    assert abs(turned).max() < 0.03
    assert abs(rollout.tracks.heading_rad[row, NOW + 16 :]).max() < 1e-6


def test_replay_is_the_log_for_everybody(following):
    rollout = run(following, replay.build(replay.Settings()))
    log = following.scene.tracks
    assert rollout.ended == "time"
    assert rollout.tracks.ids == log.ids
    assert np.abs(rollout.tracks.position_m - log.position_m).max() < 0.01
    assert np.abs(rollout.tracks.velocity_mps - log.velocity_mps).max() < 1e-6
    assert (rollout.driver[log.row("av"), NOW + 1 :] == Driver.PLANNER).all()
    assert (rollout.driver[log.row("av"), : NOW + 1] == Driver.LOG).all()
    assert (rollout.driver[log.row("lead")] == Driver.LOG).all()


def test_sumo_has_replayed_vehicles_where_and_as_fast_as_the_log(following):
    with log_world.opened(following, TREIBER, "libsumo") as (_, world):
        for _ in range(5):
            world.step(Command(kind="sumo"), {})
        vehicle, log = world._api.vehicle, following.scene.tracks
        row = log.row("lead")
        x, y = vehicle.getPosition("lead")
        assert x == pytest.approx(log.position_m[row, NOW + 5, 0] + 2.3, abs=1e-6)
        assert y == pytest.approx(log.position_m[row, NOW + 5, 1], abs=1e-6)
        assert vehicle.getSpeed("lead") == pytest.approx(10.0, abs=1e-6)
        assert "parked" not in vehicle.getIDList()  # off the road: not SUMO's business
        assert "walker" not in vehicle.getIDList()


@pytest.mark.parametrize("planner", [lane_idm, corridor_idm])
def test_av_follows_without_contact(following, planner):
    rollout = run(following, planner())
    assert rollout.contacts == ()
    assert speeds(rollout, "av")[-1] == pytest.approx(10.0, abs=1.0)


def test_same_episode_twice_is_the_same_to_the_bit(following):
    first, second = run(following, corridor_idm()), run(following, corridor_idm())
    for name in ("position_m", "heading_rad", "velocity_mps", "valid"):
        assert getattr(first.tracks, name).tobytes() == getattr(second.tracks, name).tobytes()
    assert first.driver.tobytes() == second.driver.tobytes()


def test_traci_gives_what_libsumo_gives(following):
    one, other = run(following, corridor_idm()), run(following, corridor_idm(), backend="traci")
    assert one.tracks.ids == other.tracks.ids
    assert np.abs(one.tracks.position_m - other.tracks.position_m).max() < 1e-9


def cut_in(x):
    """A car comes over from the left lane within 3 s and brakes the AV down to 9 m/s."""
    other = straight_motion(x, LANE_M, EAST, 9.0)
    step = np.arange(STEPS)
    share = np.clip((step - NOW - 10) / 30.0, 0.0, 1.0)
    other[:, 1] = LANE_M * (1 - share)
    moving = (share > 0) & (share < 1)
    other[moving, 2] = -np.arctan2(LANE_M / 3.0, 9.0)
    return {"av": straight_motion(60.0, 0.0, EAST, 15.0), "other": other}


def first_braking(rollout):
    acceleration = np.diff(speeds(rollout, "av")) / 0.1
    return int(np.argmax(acceleration < -0.5))


def test_corridor_brakes_earlier_than_lane_and_never_harder_than_it_may(tmp_path):
    case = case_of(scene_of(straight_road(), cut_in(88.0)), tmp_path)
    lane, corridor = run(case, lane_idm()), run(case, corridor_idm())
    assert first_braking(corridor) + 2 <= first_braking(lane)
    for rollout in (lane, corridor):
        hardest = np.diff(speeds(rollout, "av")).min() / 0.1
        assert hardest >= -TREIBER.emergency_mps2 - 1e-6


def test_corridor_av_stops_for_a_pedestrian_that_sumo_does_not_know(tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, EAST, 10.0),
        "walker": straight_motion(110.0, 0.0, NORTH, 0.0),
    }
    case = case_of(scene_of(straight_road(), motions, kinds={"walker": "pedestrian"}), tmp_path)
    assert run(case, corridor_idm()).contacts == ()
    hit = run(case, lane_idm()).first("av_other")
    assert hit is not None
    assert (hit.striker_id, hit.sector) == ("av", 0)


def stopping_motion(y, speed, until_y):
    """Northwards; stands from ``until_y`` on."""
    motion = straight_motion(0.0, y, NORTH, speed)
    motion[:, 3] = np.where(motion[:, 1] < until_y, speed, 0.0)
    motion[:, 1] = np.minimum(motion[:, 1], until_y)
    return motion


@pytest.mark.parametrize("planner", [lane_idm, corridor_idm])
def test_av_stops_at_a_recorded_red_light(tmp_path, planner):
    road = crossing_road()
    motions = {
        "av": stopping_motion(-60.0, 10.0, -16.0),
        # behind the light and slow: the corridor's leader must not overrule the light
        "ahead": straight_motion(0.0, -25.0, NORTH, 6.0),
    }
    case = case_of(scene_of(road, motions, signals=red_light(road, "north_in")), tmp_path)
    rollout = run(case, planner())
    front = rollout.tracks.position_m[rollout.tracks.row("av"), -1, 1] + 2.3
    assert front < -9.0
    assert np.diff(speeds(rollout, "av")).min() / 0.1 > -8.0 - 1e-6


def test_a_red_that_the_recorded_av_passes_does_not_hold_the_av(tmp_path):
    road = crossing_road()
    motions = {"av": straight_motion(0.0, -40.0, NORTH, 8.0)}
    case = case_of(scene_of(road, motions, signals=red_light(road, "north_in")), tmp_path)
    rollout = run(case, lane_idm())
    assert rollout.tracks.position_m[0, -1, 1] > 0.0
    assert [event.kind for event in rollout.events] == ["red_passed"]


@pytest.mark.parametrize("planner", [lane_idm, corridor_idm])
@pytest.mark.parametrize(("front", "waits"), [(-1.9, False), (0.3, True)])
def test_av_waits_only_for_who_stands_in_its_way(tmp_path, planner, front, waits):
    road = replace(crossing_road(), stop_signs=())
    motions = {
        "av": straight_motion(0.0, -35.0, NORTH, 8.0),
        # inside the junction, where SUMO waits for everybody
        "waiting": straight_motion(front - 2.3, 0.0, EAST, 0.0),
    }
    rollout = run(case_of(scene_of(road, motions), tmp_path), planner())
    assert rollout.contacts == ()
    assert (rollout.tracks.position_m[0, -1, 1] < 0.0) == waits


def test_av_yields_to_a_replayed_car_with_a_route_of_its_own(tmp_path):
    motions = {
        "av": straight_motion(0.0, -50.0, NORTH, 8.0),
        # reaches the conflict when the AV would
        "major": straight_motion(-75.0, 0.0, EAST, 12.0),
    }
    case = case_of(scene_of(crossing_road(), motions), tmp_path)
    assert run(case, lane_idm()).contacts == ()
    unhindered = run(case, constant_velocity.build(constant_velocity.Settings()))
    assert unhindered.first("av_other") is not None


@pytest.mark.jumps("the plan begins turned")
def test_opponent_follows_its_plan_off_the_road_and_survives(following):
    policy = Follow("beside", 66.0, LANE_M, 0.6, 8.0)
    rollout = run(following, sumo.build(sumo.Settings()), policy)
    row = rollout.tracks.row("beside")
    assert np.abs(rollout.tracks.position_m[row, NOW + 1 :] - policy.motion[:, :2]).max() < 1e-9
    assert rollout.tracks.valid[row].all()
    assert (rollout.driver[row, NOW + 1 :] == Driver.POLICY).all()
    assert rollout.opponent_id == "beside"
    assert len(rollout.plans) == 1


@pytest.mark.jumps("the plan begins elsewhere")
def test_contact_with_the_opponent_ends_the_episode(following):
    policy = Follow("beside", 62.0, LANE_M, -0.12, 12.5)
    rollout = run(following, constant_velocity.build(constant_velocity.Settings()), policy)
    contact = rollout.first("av_opponent")
    assert (rollout.ended, rollout.outcome) == ("contact", "av_opponent")
    assert contact.step == rollout.tracks.steps - 1
    assert contact.striker_id == "beside"


def test_after_its_plan_the_opponent_goes_back_to_the_log(following):
    rollout = run(following, lane_idm(), Follow("lead", 84.0, 0.0, EAST, 10.0, steps=20))
    row = rollout.tracks.row("lead")
    assert rollout.driver[row, NOW + 20] == Driver.POLICY
    assert rollout.driver[row, NOW + 21] == Driver.LOG
    assert [event.kind for event in rollout.events] == ["plan_ended"]


def test_policy_sees_neither_the_av_path_nor_the_future(following):
    policy = Follow("lead", 84.0, 0.0, EAST, 10.0)
    run(following, lane_idm(), policy)
    for view in policy.views:
        assert view.av_path_m is None
        assert view.history.steps == NOW + 1
        assert view.step == NOW


@pytest.mark.jumps("the same plan again and again")
def test_a_view_tells_since_when_the_planner_drives(following):
    class Often(Follow):
        period_steps = 6

    policy = Often("lead", 84.0, 0.0, EAST, 10.0)
    run(following, lane_idm(), policy)
    told = {view.step: view.av_recorded_steps for view in policy.views}
    assert [told[NOW + later] for later in (0, 6, 12)] == [10, 4, 0]


def test_planner_sees_the_way_ahead_from_its_bumper(following):
    class Looking(idm.IdmPlanner):
        def act(self, view):
            row = view.history.row("av")
            front = view.history.position_m[row, -1] + [2.3, 0.0]
            assert np.hypot(*(view.av_path_m[0] - front)) < 1e-6
            assert view.av_path_m[-1, 0] - front[0] > 100.0
            return super().act(view)

    run(following, Looking(idm.Settings()))


def test_log_that_begins_and_ends_midway_is_kept(tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, EAST, 10.0),
        "guest": straight_motion(100.0, 0.0, EAST, 10.0),
    }
    valid = np.ones((2, STEPS), bool)
    valid[1, :30] = valid[1, 60:] = False
    case = case_of(scene_of(straight_road(), motions, valid=valid), tmp_path)
    rollout = run(case, lane_idm())
    assert (rollout.tracks.valid[rollout.tracks.row("guest")] == valid[1]).all()


def test_sumo_drives_the_others_where_the_case_says_so(tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, EAST, 10.0),
        # the log drives into the AV's back; SUMO does not
        "behind": straight_motion(40.0, 0.0, EAST, 14.0),
    }
    scene = scene_of(straight_road(), motions)
    keep = constant_velocity.build(constant_velocity.Settings())
    assert run(case_of(scene, tmp_path), keep).first("av_other") is not None
    rollout = run(case_of(scene, tmp_path / "sumo", traffic="sumo"), keep)
    row = rollout.tracks.row("behind")
    assert rollout.contacts == ()
    assert (rollout.driver[row, NOW + 1 :] == Driver.SUMO).all()
    first = rollout.tracks.position_m[row, NOW + 1] - rollout.tracks.position_m[row, NOW]
    assert first[0] == pytest.approx(1.4, abs=0.1)


@pytest.mark.parametrize("heading", [2.4, 1.4])
def test_who_comes_askew_to_its_lane_is_left_to_the_log(tmp_path, heading):
    """SUMO turns it onto its lane within a step: `continuity` judges the rollout."""
    long_m = 11.0
    turns = straight_motion(100.0, LANE_M, EAST, 8.0)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    turns[:30, :2] = [100.0, LANE_M + 0.5] - long_m / 2 * ahead  # its front is on the lane
    turns[:30, 2:] = heading, 0.5
    motions = {"av": straight_motion(60.0, 0.0, EAST, 10.0), "guest": turns}
    scene = scene_of(straight_road(), motions, valid=np.arange(STEPS) >= [[0], [20]])
    size_m = scene.tracks.size_m.copy()
    size_m[1, 0] = long_m
    scene = replace(scene, tracks=replace(scene.tracks, size_m=size_m))
    rollout = run(case_of(scene, tmp_path, traffic="sumo"), lane_idm())
    assert (rollout.driver[rollout.tracks.row("guest"), 20:] == Driver.LOG).all()
    assert ("off_network", "guest") in {(one.kind, one.agent_id) for one in rollout.events}


def test_overlap_at_the_start_is_an_event_and_no_contact(tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, EAST, 10.0),
        "stuck": straight_motion(62.0, 0.5, EAST, 10.0),
    }
    case = case_of(scene_of(straight_road(), motions), tmp_path, steps=5)
    rollout = run(case, replay.build(replay.Settings()))
    assert rollout.contacts == ()
    assert "overlap_at_start" in {event.kind for event in rollout.events}


def test_policy_with_an_unknown_opponent_is_refused_and_sumo_closed(following):
    with pytest.raises(SimulationError, match="nobody-there"):
        run(following, lane_idm(), Follow("nobody-there", 0.0, 0.0, EAST, 1.0))
    assert run(following, lane_idm()).ended == "time"


def test_a_bug_of_a_planner_is_laid_at_its_door_and_sumo_is_closed(following):
    class Broken(idm.IdmPlanner):
        def act(self, view):
            raise ZeroDivisionError("mine")

    with pytest.raises(PlannerError, match="ZeroDivisionError: mine"):
        run(following, Broken(idm.Settings()))
    assert run(following, lane_idm()).ended == "time"


class OffThenIdm:
    """Drives the AV off the road to the right within two seconds, and leaves it to SUMO there."""

    model = TREIBER

    def reset(self, case, rng):
        pass

    def act(self, view):
        x, y = view.history.position_m[view.history.row("av"), -1]
        if view.step >= NOW + 20:
            return Command(kind="sumo")
        turned = -0.08 * min(view.step + 1 - NOW, 11)
        x, y = x + 0.64 * np.cos(turned), y + 0.64 * np.sin(turned)
        return Command(kind="pose", x_m=x, y_m=y, heading_rad=turned, speed_mps=6.4)


@pytest.mark.parametrize("traffic", ["log", "sumo"])
def test_an_av_that_its_planner_drives_off_the_road_goes_on_from_there(tmp_path, traffic):
    """The log has it 30 m farther ahead on its lane."""
    motions = {"av": straight_motion(60.0, 0.0, EAST, 12.0)}
    scene = scene_of(straight_road(), motions)
    rollout = run(case_of(scene, tmp_path, traffic), OffThenIdm())
    assert [(event.kind, event.step) for event in rollout.events] == [("lane_lost", NOW + 21)]
    assert (rollout.driver[0, NOW + 1 :] == Driver.PLANNER).all()
    x, y = rollout.tracks.position_m[0].T
    steps = np.hypot(np.diff(x), np.diff(y))[NOW:]
    assert steps.max() < 0.1 * 8.0
    assert y[NOW + 20] < -7.0
    assert y[-1] > -3.0  # nearly back
    assert x[-1] < 110.0  # the log is at 156 m
    turned = np.diff(np.unwrap(rollout.tracks.heading_rad[0, NOW + 20 :]))
    assert np.abs(turned).max() < 0.15


def test_an_av_off_the_road_waits_for_what_is_in_its_way(tmp_path):
    motions = {"av": straight_motion(60.0, 0.0, EAST, 12.0)}
    alone = run(case_of(scene_of(straight_road(), motions), tmp_path), OffThenIdm())
    x, y = alone.tracks.position_m[0, NOW + 50]
    motions["parked"] = straight_motion(x, y, EAST, 0.0)
    case = case_of(scene_of(straight_road(), motions), tmp_path / "parked")
    rollout = run(case, OffThenIdm())
    assert rollout.contacts == ()
    assert rollout.tracks.speed_mps[0, -1] == 0.0


def test_an_av_that_rolls_back_keeps_its_velocity(tmp_path):
    back = straight_motion(60.0, 0.0, EAST, -2.0)
    case = case_of(scene_of(straight_road(), {"av": back}), tmp_path, steps=20)
    rollout = run(case, constant_velocity.build(constant_velocity.Settings()))
    assert rollout.tracks.position_m[0, NOW:, 0] == pytest.approx(60.0 - 0.2 * np.arange(21))
    assert rollout.tracks.velocity_mps[0, -1] == pytest.approx([-2.0, 0.0])
