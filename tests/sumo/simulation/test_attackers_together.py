"""Several vehicles that attack together: whose contact is what, when it is over, and for whom."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene import HISTORY_STEPS, Contact, Driver, Plan, Turn, TurnRules, View
from deepmf_sumo.sumo.simulation.attack_schedule import AttackSchedule
from deepmf_sumo.sumo.simulation.contacts import ContactFinder
from deepmf_sumo.sumo.simulation.frame import Frame, Pose

from tests.support.owners import Owner
from tests.support.predictor_doubles import straight_road, straight_tracks
from tests.support.rollout_doubles import contact_of, rollout_of, straight

NOW = HISTORY_STEPS - 1
AROUND = {"av": (0, 0, 0, 10), "a": (12, 0, 0, 10), "b": (-12, 0, 0, 10), "c": (30, 9, 0, 10)}
RULES = TurnRules(longest_s=5.0, reach_m=40.0, harmless_s=9.0, again_after_s=0.0, clear_s=1.0)
CAR = (4.8, 2.0)


def view(agents, step=NOW):
    return View(
        step=step,
        dt_s=0.1,
        av_id="av",
        history=straight_tracks(agents),
        road=straight_road(),
        signals={},
        steps_left=1000,
    )


def frame(agents):
    poses = {
        name: (Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed), Driver.SUMO)
        for name, (x, y, heading, speed) in agents.items()
    }
    return Frame.of_poses(poses), np.tile(CAR, (len(agents), 1))


class Pair:
    """Attacks with the first two of ``a``, ``b`` and ``c``; only ``planned`` get plans."""

    period_steps = 10

    def __init__(self, planned=("a", "b")):
        self.planned, self.views = planned, []

    def reset(self, view, rng):
        return tuple(one for one in view.history.ids if one != "av")[:2]

    def plan(self, view):
        self.views.append((view.step, view.steps_left))
        return {
            agent: Plan(
                agent_id=agent,
                first_step=view.step + 1,
                position_m=np.full((20, 2), view.step),
                heading_rad=np.zeros(20),
                speed_mps=np.zeros(20),
            )
            for agent in self.planned
        }


def begun(policy=None, rules=None):
    rng = np.random.default_rng(0)
    return AttackSchedule(policy or Pair(), view(AROUND), rng, rules, Owner())


def go_on(schedule, step, agents=AROUND, hits=()):
    if schedule.due(step):
        schedule.replan(view(agents, step))
    poses = schedule.advance(step + 1)
    return poses, schedule.after_step(step + 1, *frame(agents), hits)


def test_both_are_put_where_their_plans_are():
    schedule = begun()
    poses, over = go_on(schedule, NOW)
    assert (schedule.attackers, over) == (("a", "b"), False)
    assert {agent: pose.x_m for agent, pose in poses.items()} == {"a": NOW, "b": NOW}
    assert [plan.agent_id for plan in schedule.plans] == ["a", "b"]


def test_who_gets_no_plan_is_driven_by_its_owner_or_keeps_its_last_plan():
    policy = Pair(planned=("b",))
    schedule = begun(policy)
    poses, _ = go_on(schedule, NOW)
    assert (poses["a"], poses["b"].x_m) == (None, NOW)
    policy.planned = ("a",)
    for step in range(NOW + 1, NOW + 11):
        poses, _ = go_on(schedule, step)
    assert (poses["a"].x_m, poses["b"].x_m) == (NOW + 10, NOW)


def test_the_policy_is_asked_until_all_have_left_and_plans_of_those_gone_are_not_kept():
    policy = Pair()
    schedule = begun(policy)
    one_left = {name: AROUND[name] for name in ("av", "b")}
    go_on(schedule, NOW, one_left)
    for step in range(NOW + 1, NOW + 11):
        go_on(schedule, step, one_left)
    assert [plan.agent_id for plan in schedule.plans] == ["b", "b"]
    for step in range(NOW + 11, NOW + 31):
        go_on(schedule, step, {"av": AROUND["av"]})
    assert [step for step, _ in policy.views] == [NOW, NOW + 10]


def test_a_hit_ends_the_episode_and_says_who_hit_and_how_near_the_other_came():
    schedule = begun()
    go_on(schedule, NOW, {**AROUND, "a": (8, 0, 0, 10)})
    _, over = go_on(schedule, NOW + 1, hits=["b"])
    assert over
    schedule.finish(NOW + 2, "contact")
    first, second = schedule.closed
    assert (first.opponent_id, first.ended, second.opponent_id, second.ended) == (
        "a", "other_hit", "b", "contact",
    )  # fmt: skip
    assert first.gap_m == pytest.approx(8 - CAR[0])
    assert second.gap_m == 0
    assert {(one.first_step, one.last_step) for one in schedule.closed} == {(NOW, NOW + 2)}
    assert schedule.of_episode == ("b", "a")


def test_without_a_hit_the_nearest_comes_first():
    schedule = begun()
    go_on(schedule, NOW, {**AROUND, "b": (-8, 0, 0, 10)})
    schedule.finish(NOW + 1, "time")
    assert [one.ended for one in schedule.closed] == ["time", "time"]
    assert schedule.of_episode == ("b", "a")


def test_in_turn_who_is_out_of_reach_is_let_go_and_the_other_attacks_on():
    policy = Pair()
    schedule = begun(policy, RULES)
    go_on(schedule, NOW, {**AROUND, "a": (41, 0, 0, 10)})
    assert [(one.opponent_id, one.ended) for one in schedule.closed] == [("a", "out_of_reach")]
    assert (schedule.attackers, schedule.leaving) == (("b",), True)
    poses, _ = go_on(schedule, NOW + 1, hits=["b"])
    assert poses["a"] is None
    policy.planned = ()
    assert schedule.closed[1].ended == "contact"
    assert schedule.attackers == ()
    for step in range(NOW + 2, NOW + 13):
        go_on(schedule, step, {name: AROUND[name] for name in ("av", "b", "c")})
    assert schedule.attackers == ("b", "c")
    schedule.finish(NOW + 13, "time")
    assert schedule.of_episode == ("b", "a")  # the first attack is decisive


def test_in_turn_a_hit_ends_the_attack_of_both():
    schedule = begun(rules=RULES)
    go_on(schedule, NOW, hits=["a"])
    assert [one.ended for one in schedule.closed] == ["contact", "other_hit"]
    assert schedule.attackers == ()


def judged(*frames, attackers):
    judge = ContactFinder("av", attackers)
    for step, agents in enumerate(frames):
        judge.look(step, *frame(agents))
    return [(one.kind, one.first_id, one.second_id) for one in judge.contacts], judge


def test_contacts_are_judged_by_role():
    apart = {"av": (0, 0, 0, 0), "a": (0, 5, 0, 0), "b": (0, -5, 0, 0), "c": (0, 10, 0, 0)}
    both = {**apart, "a": (0, 1.5, 0, 0), "b": (0, -1.5, 0, 0)}
    found, judge = judged(apart, both, attackers=("a", "b"))
    assert found == [("av_opponent", "av", "a"), ("av_opponent", "av", "b")]
    assert judge.hits(1) == ["a", "b"]
    others = {**apart, "av": (50, 0, 0, 0), "a": (0, 8.5, 0, 0), "b": (0, 7.5, 0, 0)}
    found, judge = judged(
        {**apart, "d": (0, -9, 0, 0)}, {**others, "d": (0, 6, 0, 0)}, attackers=("a", "b")
    )
    assert found == [
        ("opponent_other", "a", "b"),  # of the two among themselves once
        ("opponent_other", "a", "c"),
        ("opponent_other", "b", "d"),
    ]
    assert judge.hits(1) == []


def contacts_seen(rollout, opponent):
    cut = rollout.of_turn(next(one for one in rollout.turns if one.opponent_id == opponent))
    return [(one.kind, one.first_id, one.second_id) for one in cut.contacts]


def test_an_attacker_s_part_shows_the_episode_as_if_it_were_alone():
    def touch(kind, first, second) -> Contact:
        return contact_of(kind, first=first, second=second)

    paths = {name: straight(x, y, 10) for name, (x, y, _, _) in AROUND.items()}
    contacts = [
        touch("opponent_other", "a", "b"),
        touch("opponent_other", "b", "c"),
        touch("av_other", "av", "c"),
        touch("av_opponent", "av", "b"),
    ]
    turns = [
        Turn(opponent_id=name, first_step=10, last_step=40, ended=ended, gap_m=0.0)
        for name, ended in (("b", "contact"), ("a", "other_hit"))
    ]
    rollout = replace(
        rollout_of(paths, contacts, plans=Pair().plan(view(AROUND)).values()),
        attackers=("b", "a"),
        turns=tuple(turns),
    )
    assert rollout.roles == {"av": "av", "b": "opponent", "a": "attacker"}
    assert contacts_seen(rollout, "b") == [
        ("opponent_other", "a", "b"),
        ("opponent_other", "b", "c"),
        ("av_other", "av", "c"),
        ("av_opponent", "av", "b"),
    ]
    assert contacts_seen(rollout, "a") == [
        ("opponent_other", "a", "b"),
        ("av_other", "av", "c"),
        ("av_other", "av", "b"),
    ]
    parts = [rollout.of_turn(turn) for turn in turns]
    assert [part.attackers for part in parts] == [("b",), ("a",)]
    assert [{plan.agent_id for plan in part.plans} for part in parts] == [{"b"}, {"a"}]
