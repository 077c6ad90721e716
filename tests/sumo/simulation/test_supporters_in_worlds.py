"""Road users that support an attack: who drives them, whose contact is what, and both worlds."""

import numpy as np
import pytest

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.planners import replay
from deepmf_sumo.results import artifacts, tracks
from deepmf_sumo.scene import HISTORY_STEPS, Driver, Plan, Turn, TurnRules, View
from deepmf_sumo.scene.policy import planned
from deepmf_sumo.sumo.simulation import simulate
from deepmf_sumo.sumo.simulation.attack_schedule import AttackSchedule
from deepmf_sumo.sumo.simulation.contacts import ContactFinder
from deepmf_sumo.sumo.simulation.frame import Frame, Pose

from tests.support.owners import Owner
from tests.support.predictor_doubles import straight_road, straight_tracks
from tests.support.rollout_doubles import contact_of, rollout_of, straight
from tests.support.simulated_worlds import (
    LANE_M,
    case_of,
    scene_of,
    straight_motion,
)
from tests.support.simulated_worlds import straight_road as simulated_road

NOW = HISTORY_STEPS - 1
AROUND = {"av": (0, 0, 0, 10), "a": (12, 0, 0, 10), "b": (-12, 0, 0, 10), "c": (30, 9, 0, 10)}
CAR = (4.8, 2.0)


def view(agents=AROUND, step=NOW):
    return View(
        step=step, dt_s=0.1, av_id="av", history=straight_tracks(agents), road=straight_road(),
        signals={}, steps_left=1000,
    )  # fmt: skip


def plan(agent, step=NOW, supports=None, way=None):
    way = np.full((20, 2), float(step)) if way is None else way
    return Plan(
        agent_id=agent, first_step=step + 1, position_m=way, heading_rad=np.zeros(len(way)),
        speed_mps=np.zeros(len(way)), supports=supports,
    )  # fmt: skip


class Helped:
    """``a`` attacks; ``b`` supports it from the second plan on."""

    period_steps = 10

    def reset(self, view, rng):
        return ("a",)

    def plan(self, view):
        plans = {"a": plan("a", view.step)}
        if view.step > NOW:
            plans["b"] = plan("b", view.step, supports="a")
        return plans


def frame(agents=AROUND, driver=Driver.LOG):
    poses = {
        name: (Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed), driver)
        for name, (x, y, heading, speed) in agents.items()
    }
    return Frame.of_poses(poses), np.tile(CAR, (len(agents), 1))


def go_on(schedule, step, hits=()):
    if schedule.due(step):
        schedule.replan(view(step=step))
    poses = schedule.advance(step + 1)
    schedule.after_step(step + 1, *frame(), hits)
    return {agent: pose and pose.x_m for agent, pose in poses.items()}


def test_a_supporter_joins_with_its_first_plan_and_is_no_attacker():
    schedule = AttackSchedule(Helped(), view(), np.random.default_rng(0), None, Owner())
    assert go_on(schedule, NOW) == {"a": NOW}
    for step in range(NOW + 1, NOW + 11):
        poses = go_on(schedule, step)
    assert poses == {"a": NOW + 10, "b": NOW + 10}
    assert (schedule.attackers, schedule.supporters) == (("a",), ("b",))
    schedule.finish(NOW + 11, "time")
    assert schedule.of_episode == ("a",)


def test_a_supporter_is_handed_back_when_the_attack_is_over():
    rules = TurnRules(longest_s=5.0, again_after_s=0.0)
    schedule = AttackSchedule(Helped(), view(), np.random.default_rng(0), rules, Owner())
    for step in range(NOW, NOW + 12):
        go_on(schedule, step)
    assert schedule.supporters == ("b",)
    go_on(schedule, NOW + 12, hits=["a"])
    assert (schedule.attackers, schedule.supporters) == ((), ())
    assert schedule.leaving
    assert [turn.opponent_id for turn in schedule.closed] == ["a"]
    assert schedule.advance(NOW + 14).keys() == {"a", "b"}  # on their way to their next owner


def test_a_turn_has_the_supporters_of_its_attacker_alone():
    paths = {name: straight(x, y, v) for name, (x, y, _, v) in AROUND.items()}
    plans = [plan("a"), plan("b", supports="a"), plan("c", supports="other")]
    met = [contact_of("supporter_other", step=20, first=one, second="x") for one in ("b", "c")]
    whole = rollout_of(paths, met, opponent_id="a", plans=plans)
    turn = Turn(opponent_id="a", first_step=NOW, last_step=40, ended="time", gap_m=1.0)
    part = whole.of_turn(turn)
    assert part.supporters == whole.supporters == ("b",)
    assert part.roles == {"av": "av", "a": "opponent", "b": "supporter"}
    assert [one.first_id for one in part.contacts] == ["b"]


@pytest.mark.parametrize(
    ("agent", "supports"), [("b", None), ("b", "c"), ("gone", "a"), ("av", "a")]
)
def test_only_road_users_that_are_there_support_and_only_attackers(agent, supports):
    class Wrong(Helped):
        def plan(self, view):
            return {agent: plan(agent, view.step, supports=supports)}

    with pytest.raises(SimulationError, match=f"planned for '{agent}'"):
        planned(Wrong(), view(), ("a",))


def contacts(*frames):
    judge = ContactFinder("av", ("a",))
    for step, agents in enumerate(frames):
        judge.look(step, *frame(agents))
        if step == 0:
            judge.watch(("b",), step, *frame(agents))
    return [(one.kind, one.first_id, one.second_id) for one in judge.contacts], judge


def test_contacts_of_a_supporter_are_no_hits():
    apart = {"av": (0, 0, 0, 9), "a": (20, 0, 0, 9), "b": (0, 9, 0, 9), "c": (20, 9, 0, 9)}
    assert contacts(apart, {**apart, "b": (3, 1, 0, 9)})[0] == [("av_other", "av", "b")]
    assert contacts(apart, {**apart, "b": (18, 1, 0, 9)})[0] == [("opponent_other", "a", "b")]
    assert contacts(apart, {**apart, "b": (18, 8, 0, 9)})[0] == [("supporter_other", "b", "c")]


def test_what_a_supporter_overlaps_when_it_joins_is_excused():
    found, judge = contacts(*[{**AROUND, "b": (29, 8, 0, 10)}] * 3)
    assert found == []
    assert [(event.agent_id, event.kind) for event in judge.events] == [("b", "overlap_at_start")]


class Through:
    """``a`` keeps its lane as the attacker; ``b`` drives through ``c`` as its supporter."""

    def __init__(self, period=10):
        self.period_steps, self.joins = period, NOW + 10

    def reset(self, view, rng):
        return ("a",)

    def plan(self, view):
        where = dict(zip(view.history.ids, view.history.position_m[:, -1], strict=True))
        ahead = np.arange(1, 81)[:, None] * np.array([0.9, 0.0])
        plans = {"a": plan("a", view.step, way=where["a"] + ahead)}
        if view.step >= self.joins and {"b", "c"} <= where.keys():
            share = np.minimum(np.arange(1, 81) / 30, 1.0)[:, None]
            way = where["b"] + (where["c"] - where["b"]) * share + ahead
            plans["b"] = plan("b", view.step, supports="a", way=way)
        return plans


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 9.0),
        "a": straight_motion(80.0, 0.0, 0.0, 9.0),
        "b": straight_motion(52.0, LANE_M, 0.0, 9.0),
        "c": straight_motion(62.0, LANE_M, 0.0, 9.0),
        "d": straight_motion(47.0, LANE_M, 0.0, 9.7),  # in the recording it runs into b
    }
    return case_of(scene_of(simulated_road(), motions), tmp_path_factory.mktemp("supporters"))


@pytest.mark.jumps("the policy moves the supporter through another vehicle")
@pytest.mark.sumo
def test_without_sumo_a_supporter_does_to_the_bit_what_it_does_with_it(case, tmp_path):
    planner = replay.build(replay.Settings())
    one, other = (
        simulate(case, planner, Through(), rng=np.random.default_rng(0), backend=backend)
        for backend in (None, "libsumo")
    )
    assert one.tracks.position_m.tobytes() == other.tracks.position_m.tobytes()
    assert one.driver.tobytes() == other.driver.tobytes()
    assert repr(one.contacts) == repr(other.contacts)
    of_b, of_b_in_sumo = ([e for e in made.events if e.agent_id == "b"] for made in (one, other))
    assert of_b == of_b_in_sumo
    assert "overlap_at_start" in {event.kind for event in of_b}
    assert (
        (one.supporters, one.attackers) == (other.supporters, other.attackers) == (("b",), ("a",))
    )
    assert [(at.kind, at.first_id, at.second_id) for at in one.contacts] == [
        ("supporter_other", "b", "c")
    ]
    driven = one.driver[one.tracks.row("b")] == Driver.POLICY
    assert (driven[: one.now + 11].any(), driven[one.now + 11 :].all()) == (False, True)
    artifacts.write_plans(tmp_path / "plans.npz", one)
    tracks.write_tracks(tmp_path / tracks.FILE, one)
    read = artifacts.read_rollout(tmp_path, one.contacts, one.ended)
    assert read.roles == one.roles == {"av": "av", "a": "opponent", "b": "supporter"}
