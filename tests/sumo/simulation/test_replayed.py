"""Episodes without SUMO are those with it, to the bit."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.planners import constant_velocity, replay
from deepmf_sumo.scene import Plan, RecordedCase, readers
from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.simulation import log_only, simulate

from tests.support.simulated_worlds import (
    LANE_M,
    NOW,
    STEPS,
    case_of,
    red_light,
    scene_of,
    straight_motion,
    straight_road,
)

OF_SUMO = {"aligned", "moved_onto_route", "off_network", "ghost_edge", "red_passed"}
"""Events that tell where SUMO has the AV."""


class Towards:
    """Drives an agent straight to where another is, from wherever it is now."""

    def __init__(self, agent, target, steps, period=None):
        self.agent, self.target, self.steps = agent, target, steps
        self.period_steps = period
        self.views = []

    def reset(self, view, rng):
        return (self.agent,)

    def plan(self, view):
        self.views.append(view)
        here, there = (
            view.history.position_m[view.history.row(name), -1]
            for name in (self.agent, self.target)
        )
        share = np.arange(1, self.steps + 1)[:, None] / self.steps
        way = there - here
        return {
            self.agent: Plan(
                agent_id=self.agent,
                first_step=view.step + 1,
                position_m=here + share * way,
                heading_rad=np.full(self.steps, np.arctan2(way[1], way[0])),
                speed_mps=np.full(self.steps, np.hypot(*way) / self.steps * 10),
            )
        }


class Together:
    """Drives what several policies drive."""

    def __init__(self, *policies):
        self.policies, self.period_steps = policies, policies[0].period_steps

    def reset(self, view, rng):
        return tuple(agent for one in self.policies for agent in one.reset(view, rng))

    def plan(self, view):
        return {agent: plan for one in self.policies for agent, plan in one.plan(view).items()}


def both(case, policy):
    """The episode without SUMO and with it; ``policy`` makes the policy."""
    planner = replay.build(replay.Settings())
    return [
        simulate(case, planner, policy(), rng=np.random.default_rng(0), backend=backend)
        for backend in (None, "libsumo")
    ]


def assert_same(one, other):
    for name in ("position_m", "z_m", "heading_rad", "velocity_mps", "valid", "size_m"):
        mine, theirs = getattr(one.tracks, name), getattr(other.tracks, name)
        assert mine.shape == theirs.shape, name
        assert mine.tobytes() == theirs.tobytes(), name
    assert (one.tracks.ids, one.tracks.kinds) == (other.tracks.ids, other.tracks.kinds)
    assert one.driver.tobytes() == other.driver.tobytes()
    assert repr(one.contacts) == repr(other.contacts)
    assert one.events == tuple(e for e in other.events if e.kind not in OF_SUMO)
    for name in ("now", "ended", "attackers", "turns", "signals", "leaders"):
        assert getattr(one, name) == getattr(other, name), name
    for mine, theirs in zip(one.plans, other.plans, strict=True):
        assert mine.position_m.tobytes() == theirs.position_m.tobytes()


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Gaps, latecomers, a pedestrian, an overlap at the start, one that rolls back, a light."""
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 10.0),
        "b": straight_motion(52.0, LANE_M, 0.0, 9.0),
        "late": straight_motion(80.0, LANE_M, np.pi, -5.0),
        "walker": straight_motion(75.0, 1.0, 1.2, 0.3),
        "close": straight_motion(52.5, LANE_M + 1.0, 0.0, 9.0),
        "never": straight_motion(10.0, 0.0, 0.0, 0.0),
    }
    valid = np.ones((len(motions), STEPS), bool)
    valid[1, 60:] = False
    valid[2, :30] = False
    valid[0, 40:45] = False
    valid[5] = False
    road = straight_road()
    scene = scene_of(
        road, motions, kinds={"walker": "pedestrian"}, valid=valid, signals=red_light(road, "left")
    )
    return case_of(scene, tmp_path_factory.mktemp("replayed"))


@pytest.mark.parametrize(
    "policy",
    [
        lambda: None,
        lambda: Towards("b", "av", 30),
        lambda: Towards("b", "av", 80),
        lambda: Towards("b", "walker", 10),  # the plan ends long before the episode
        lambda: Towards("b", "av", 60, period=10),
        lambda: Towards("b", "av", 7, period=20),  # goes on without a plan in between
        *(
            pytest.param(pair, marks=pytest.mark.jumps("one of them turns on the spot"))
            for pair in (
                lambda: Together(Towards("b", "av", 60, period=10), Towards("close", "av", 70)),
                lambda: Together(Towards("close", "b", 20, period=30), Towards("b", "av", 25)),
            )
        ),
        pytest.param(
            lambda: Towards("walker", "av", 20, period=3),
            marks=pytest.mark.jumps("a person runs off at 7 m/s"),
        ),
    ],
)
def test_drawn_scene(case, policy):
    assert_same(*both(case, policy))


def test_in_a_gap_the_av_drives_on_evenly_and_at_the_end_it_stops(case):
    longer = replace(case, duration_steps=130)
    planner = replay.build(replay.Settings())
    rollout = simulate(longer, planner, None, rng=np.random.default_rng(0))
    row = rollout.tracks.row("av")
    x, speed = rollout.tracks.position_m[row, :, 0], rollout.tracks.speed_mps[row]
    assert np.diff(x[NOW:STEPS]) == pytest.approx(1.0)  # 10 m/s, also from 40 to 44
    assert speed[NOW:STEPS] == pytest.approx(10.0)
    assert speed[STEPS:] == pytest.approx(np.maximum(10.0 - 0.3 * np.arange(1, 51), 0.0))
    assert x[-1] - x[STEPS - 1] == pytest.approx(10.0**2 / (2 * 3.0), abs=0.1)


@pytest.mark.parametrize("policy", [lambda: None, lambda: Towards("b", "av", 80)])
def test_an_agent_that_appears_between_two_plans_and_is_hit(policy, tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 10.0),
        "b": straight_motion(40.0, LANE_M, 0.0, 9.0),
        "late": straight_motion(90.0, 0.5, 0.0, 0.0),
    }
    valid = np.ones((len(motions), STEPS), bool)
    valid[2, : NOW + 5] = False
    case = case_of(scene_of(straight_road(), motions, valid=valid), tmp_path)
    one, other = both(case, policy)
    assert [contact.kind for contact in one.contacts] == ["av_other"]
    assert_same(one, other)


def test_views_are_the_same(case):
    policies = []

    def policy():
        policies.append(Towards("b", "av", 60, period=10))
        return policies[-1]

    both(case, policy)
    assert len(policies[0].views) == len(policies[1].views) > 1
    for one, other in zip(policies[0].views, policies[1].views, strict=True):
        assert (one.step, one.steps_left, one.signals) == (
            other.step,
            other.steps_left,
            other.signals,
        )
        assert one.history.ids == other.history.ids
        for name in ("position_m", "velocity_mps", "heading_rad", "valid"):
            assert getattr(one.history, name).tobytes() == getattr(other.history, name).tobytes()


def test_longer_than_the_recording(case, tmp_path):
    longer = case_of(case.scene, tmp_path, steps=100)
    one, other = both(longer, lambda: Towards("b", "walker", 95))
    assert one.tracks.steps == NOW + 1 + 100
    assert_same(one, other)


@pytest.mark.jumps("the opponent turns toward the AV in a step")
def test_recorded_scenes(womd, tmp_path):
    for name in readers.ids(womd / "val", tmp_path)[3:6]:
        scene = readers.scene(womd / "val", name, tmp_path)
        case = RecordedCase(
            name=name,
            road=scene.road,
            av_id=scene.av_id,
            duration_steps=80,
            traffic="log",
            seed=0,
            scene=scene,
            net=network.cached(scene, tmp_path / "nets"),
        )
        tracks, av = scene.tracks, scene.tracks.row(scene.av_id)
        away = np.hypot(*(tracks.position_m[:, NOW] - tracks.position_m[av, NOW]).T)
        others = (tracks.valid[:, NOW]) & (np.array(tracks.kinds) == "vehicle")
        others[av] = False
        opponent = tracks.ids[int(np.where(others, away, np.inf).argmin())]
        assert_same(*both(case, lambda: None))
        for period in (None, 10):
            towards = partial(Towards, opponent, scene.av_id, 50, period)
            assert_same(*both(case, towards))


def test_planners_that_react_and_sumo_traffic_need_sumo(case, monkeypatch):
    def never(*given):
        raise AssertionError

    monkeypatch.setattr(log_only, "run", never)
    planner = constant_velocity.build(constant_velocity.Settings())
    simulate(case, planner, None, rng=np.random.default_rng(0))
    with pytest.raises(AssertionError):
        simulate(case, replay.build(replay.Settings()), None, rng=np.random.default_rng(0))


def test_an_av_off_every_lane_is_refused_as_with_sumo(tmp_path: Path):
    scene = scene_of(straight_road(), {"av": straight_motion(60.0, 90.0, 0.7, 5.0)})
    case = case_of(scene, tmp_path)
    case = replace(case, net=replace(case.net, ghost_edge=None))
    with pytest.raises(SimulationError, match="drives on no lane"):
        simulate(case, replay.build(replay.Settings()), None, rng=np.random.default_rng(0))
