"""The loop of an episode over a world without SUMO, and frames that are put together."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.scene import HISTORY_STEPS, Command, Driver, Event, Plan
from deepmf_sumo.sumo.simulation import episode
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose

from tests.support.owners import Owner
from tests.support.predictor_doubles import straight_road

NOW = HISTORY_STEPS - 1
CAR = Body(kind="vehicle", size_m=(4.8, 2.0, 1.5))


def pose(x_m, y_m=0.0, speed_mps=10.0):
    return Pose(x_m=x_m, y_m=y_m, heading_rad=0.0, speed_mps=speed_mps)


class Road:
    """A world in which the AV drives 1 m a step, and another vehicle beside it as it is told."""

    def __init__(self, gone_after=1000):
        self.events = [Event(step=NOW + 2, agent_id="av", kind="lane_lost")]
        self.av = SimpleNamespace(present=True, leaders=("other",), path=lambda: None)
        self.next_owner = Owner()
        self.steps = 0
        self.gone_after = gone_after

    def frame(self, at, other=None):
        placed = other or pose(float(at), 4.0)
        driver = Driver.SUMO if other is None else Driver.POLICY
        return Frame.of_poses({"av": (pose(float(at)), Driver.PLANNER), "other": (placed, driver)})

    def history(self):
        return [self.frame(at) for at in range(-NOW, 1)]

    def body(self, agent):
        return CAR

    def signals(self):
        return {}

    def step(self, command, poses):
        assert command.kind == "sumo"
        self.steps += 1
        self.av.present = self.steps < self.gone_after
        return self.frame(self.steps, poses.get("other"))


class Planner:
    model = None

    def act(self, view):
        assert view.history.ids == ("av", "other")
        return Command(kind="sumo")


class Aside:
    """Moves the other vehicle onto the AV within ten steps."""

    period_steps = None

    def reset(self, view, rng):
        return ("other",)

    def plan(self, view):
        steps = np.arange(1.0, 11.0)
        return {
            "other": Plan(
                agent_id="other",
                first_step=view.step + 1,
                position_m=np.stack([steps, 4.0 - 0.4 * steps], axis=1),
                heading_rad=np.zeros(10),
                speed_mps=np.full(10, 10.0),
            )
        }


class Watch:
    def __init__(self):
        self.seen, self.over = [], False

    def on_step(self, frame, attackers):
        self.seen.append((frame.ids, attackers))

    def on_end(self):
        self.over = True


def run(world, policy=None, observers=(), steps=20):
    case = SimpleNamespace(
        av_id="av", road=straight_road(), duration_steps=steps, turns=None, in_sight=False
    )
    rng = np.random.default_rng(0)
    return episode.run(case, world, Planner(), policy, rng, observers)


def test_time_ends_an_episode_without_a_contact():
    world = Road()
    rollout = run(world)
    assert (rollout.ended, world.steps, rollout.now) == ("time", 20, NOW)
    assert rollout.tracks.steps == HISTORY_STEPS + 20
    assert rollout.leaders == (("other",),) * 20
    assert [event.kind for event in rollout.events] == ["lane_lost"]
    assert set(rollout.seconds) == {"policy", "planner", "simulation"}


def test_contact_ends_it_and_observers_see_every_step():
    world, watch = Road(), Watch()
    rollout = run(world, Aside(), [watch])
    contact = rollout.first("av_opponent")
    assert rollout.ended == "contact"
    assert contact.step == NOW + world.steps == rollout.tracks.steps - 1
    assert watch.seen == [(["av", "other"], ("other",))] * world.steps
    assert watch.over
    row = rollout.tracks.row("other")
    assert (rollout.driver[row, NOW + 1 :] == Driver.POLICY).all()


def test_an_av_that_has_gone_ends_it():
    rollout = run(Road(gone_after=5))
    assert (rollout.ended, len(rollout.signals)) == ("av_gone", 5)


def test_poses_replace_those_of_a_frame_in_their_rows():
    frame = Road().frame(0)
    put = frame.with_poses(
        {"new": (pose(9.0), Driver.LOG), "av": (pose(5.0, speed_mps=-2.0), Driver.POLICY)}
    )
    assert put.ids == ["av", "other", "new"]
    assert put.position_m[:, 0].tolist() == [5.0, 0.0, 9.0]
    assert put.velocity_mps[0] == pytest.approx([-2.0, 0.0])
    assert put.driver.tolist() == [Driver.POLICY, Driver.SUMO, Driver.LOG]
    assert frame.with_poses({}) is frame
    assert put.without("other").ids == ["av", "new"]
    assert put.without("other").position_m[:, 0].tolist() == [5.0, 9.0]


def test_sumos_states_become_centres():
    frame = Frame.of_sumo(["a"], [(10.0, 5.0, 90.0, 3.0, 1.5)], np.array([4.0]))
    assert frame.position_m[0] == pytest.approx([8.0, 5.0])
    assert frame.heading_rad[0] == pytest.approx(0.0)
    assert frame.velocity_mps[0] == pytest.approx([3.0, 0.0])
    assert (frame.z_m[0], frame.driver[0]) == (1.5, Driver.SUMO)
    assert Frame.of_sumo([], [], np.zeros(0)).ids == []
