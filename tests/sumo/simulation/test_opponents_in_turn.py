"""Opponents one after another: when one is spent, who is next, what becomes of them in SUMO."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.planners import idm
from deepmf_sumo.scene import HISTORY_STEPS, Driver, Plan, TurnRules, View
from deepmf_sumo.scene.rollout import decisive
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.attack_schedule import AttackSchedule
from deepmf_sumo.sumo.simulation.frame import Frame, Pose

from tests.support import tiny_network
from tests.support.owners import Owner
from tests.support.predictor_doubles import straight_road, straight_tracks

NOW = HISTORY_STEPS - 1
RULES = TurnRules(longest_s=5.0, reach_m=40.0, harmless_s=2.0, again_after_s=20.0, clear_s=1.0)
NEAR = {"av": (0, 0, 0, 10), "a": (12, 0, 0, 10), "b": (-12, 0, 0, 10)}


def view(agents, step=NOW, steps_left=1000):
    return View(
        step=step,
        dt_s=0.1,
        av_id="av",
        history=straight_tracks(agents),
        road=straight_road(),
        signals={},
        steps_left=steps_left,
    )


def frame(agents):
    poses = {
        name: (Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed), Driver.SUMO)
        for name, (x, y, heading, speed) in agents.items()
    }
    return Frame.of_poses(poses), np.tile([4.8, 2.0], (len(agents), 1))


class FirstOfAll:
    """Attacks the first vehicle that it sees, and keeps it where it is for two seconds."""

    def __init__(self, period_steps=10, *, collides=True):
        self.period_steps = period_steps
        self.collides = collides
        self.seen = []

    def reset(self, view, rng):
        self.seen.append((view.step, view.history.ids, view.steps_left))
        others = [agent for agent in view.history.ids if agent != "av"]
        self.opponent = others[0] if others else None
        return tuple(others[:1])

    def plan(self, view):
        self.seen.append((view.step, "plan", view.steps_left))
        reason = (
            None if self.collides is None else SimpleNamespace(collides=np.array([[self.collides]]))
        )
        return {
            self.opponent: Plan(
                agent_id=self.opponent,
                first_step=view.step + 1,
                position_m=np.zeros((20, 2)),
                heading_rad=np.zeros(20),
                speed_mps=np.zeros(20),
                reason=reason,
            )
        }


def begun(policy=None, rules=RULES, agents=NEAR, steps_left=1000, taking=True):
    seen, rng = view(agents, steps_left=steps_left), np.random.default_rng(0)
    return AttackSchedule(policy or FirstOfAll(), seen, rng, rules, Owner(taking=taking))


def go_on(turns, step, agents=NEAR, hits=()):
    """One round of the loop; whether the episode is over."""
    if turns.due(step):
        turns.replan(view(agents, step, 1000 - step))
    turns.advance(step + 1)
    return turns.after_step(step + 1, *frame(agents), hits)


def test_one_opponent_is_the_whole_episode():
    policy = FirstOfAll()
    turns = begun(policy, rules=None)
    far = {**NEAR, "a": (500, 0, 0, 10)}
    assert not any(go_on(turns, step, far) for step in range(NOW, NOW + 90))
    assert (turns.attackers, turns.of_episode) == (("a",), ("a",))
    assert go_on(turns, NOW + 90, hits=["a"])
    turns.finish(NOW + 91, "contact")
    assert turns.closed == ()
    assert [seen[2] for seen in policy.seen[:2]] == [1000, 990]


def test_who_hit_is_let_go_for_a_step_and_another_one_attacks():
    policy = FirstOfAll()
    turns = begun(policy)
    assert not go_on(turns, NOW, hits=["a"])
    (turn,) = turns.closed
    assert (turn.opponent_id, turn.first_step, turn.last_step) == ("a", NOW, NOW + 1)
    assert (turn.ended, turn.gap_m) == ("contact", 0.0)
    assert (turns.attackers, turns.leaving, turns.due(NOW + 1)) == ((), True, False)
    assert turns.advance(NOW + 2) == {"a": None}  # its next owner takes it
    assert not turns.leaving
    assert turns.advance(NOW + 3) == {}
    assert [step for step in range(NOW, NOW + 12) if turns.due(step)] == [NOW + 11]
    go_on(turns, NOW + 11)
    assert turns.attackers == ("b",)
    assert policy.seen[2][1] == ("av", "b")


def test_the_spent_one_is_chosen_again_where_nobody_else_is_there():
    turns = begun(agents={"av": (0, 0, 0, 10), "a": (12, 0, 0, 10)})
    alone = {"av": (0, 0, 0, 10), "a": (12, 0, 0, 10)}
    for step in range(NOW, NOW + 12):
        go_on(turns, step, alone, hits=["a"] if step == NOW else ())
    assert turns.attackers == ("a",)


@pytest.mark.parametrize(
    ("ended", "policy", "agents", "after"),
    [
        ("out_of_reach", FirstOfAll(), {**NEAR, "a": (41, 0, 0, 10)}, 1),
        ("gone", FirstOfAll(), {"av": (0, 0, 0, 10), "b": (-12, 0, 0, 10)}, 1),
        ("harmless", FirstOfAll(collides=False), NEAR, 20),
        ("plan_ended", FirstOfAll(period_steps=None), NEAR, 21),
        ("too_long", FirstOfAll(), NEAR, 50),
        ("too_long", FirstOfAll(collides=None), NEAR, 50),
    ],
)
def test_when_an_opponent_is_spent(ended, policy, agents, after):
    turns = begun(policy)
    for step in range(NOW, NOW + after):
        assert not turns.closed
        go_on(turns, step, agents)
    (turn,) = turns.closed
    assert (turn.ended, turn.last_step) == (ended, NOW + after)
    assert turn.gap_m == pytest.approx({"out_of_reach": 36.2, "gone": np.inf}.get(ended, 7.2))


def test_the_av_is_given_time_to_be_clear_of_others_but_not_for_ever():
    touching = {**NEAR, "a": (3, 0, 0, 10)}
    turns = begun(rules=replace(RULES, clear_s=3.0))
    go_on(turns, NOW, touching, hits=["a"])
    for step in range(NOW + 1, NOW + 31):
        go_on(turns, step, touching)
        assert turns.attackers == ()
    go_on(turns, NOW + 31, touching)
    assert turns.attackers == ("b",)


def test_who_touches_the_av_is_not_chosen_for_it_cannot_hit_it_any_more():
    policy = FirstOfAll()
    assert begun(policy, agents={**NEAR, "a": (3, 0, 0, 10)}).attackers == ("b",)
    assert begun(policy, agents={"av": NEAR["av"], "a": (3, 0, 0, 10)}).attackers == ()


def test_turns_end_with_the_time_of_a_turn_and_none_begins_near_the_end():
    policy = FirstOfAll()
    turns = begun(policy)
    go_on(turns, NOW)
    assert [left for _, _, left in policy.seen] == [50, 50]
    turns.finish(NOW + 1, "time")
    assert turns.closed[0].ended == "time"
    assert begun(steps_left=29).attackers == ()


def test_nobody_to_attack_is_asked_for_again_a_second_later():
    policy = FirstOfAll()
    turns = begun(policy, agents={"av": (0, 0, 0, 10)})
    assert (turns.attackers, turns.of_episode) == ((), ())
    assert [step for step in range(NOW, NOW + 11) if turns.due(step)] == [NOW + 10]
    go_on(turns, NOW + 10)
    assert turns.attackers == ("a",)


def test_the_first_hit_is_decisive_else_the_nearest_miss():
    turns = begun()
    go_on(turns, NOW, {**NEAR, "a": (41, 0, 0, 10)})
    for step in range(NOW + 1, NOW + 65):
        go_on(turns, step)
    assert decisive(turns.closed).opponent_id == "b"
    hit = replace(turns.closed[0], ended="contact")
    assert decisive([*turns.closed, hit, replace(hit, opponent_id="c")]) is hit
    assert decisive(()) is None


MANY = "".join(
    f'<vehicle id="v{row}" depart="0" departPos="{15 + 20 * row}" departLane="{lane}"'
    ' departSpeed="8"><route edges="ab"/></vehicle>'
    for row in range(6)
    for lane in [row % 2]
)


@pytest.fixture(scope="module")
def busy(tmp_path_factory):
    """A road of two lanes: the AV on the right one, six others around it."""
    folder = tmp_path_factory.mktemp("busy")
    config = tiny_network.build(folder)
    av = '<vehicle id="av" depart="0" departPos="45" departLane="0" departSpeed="8">'
    head, _, _ = tiny_network.ROUTES.partition("<vehicle")
    text = f'{head}{MANY.replace("v1", "v9")}{av}<route edges="ab"/></vehicle></routes>'
    (folder / "tiny.rou.xml").write_text(text)
    (folder / "tiny.edg.xml").write_text(tiny_network.EDGES)
    return config


class Ram:
    """Drives the nearest vehicle through the AV, from wherever it is, within a second."""

    period_steps = 10

    def __init__(self, sideways=0.0):
        self.sideways = sideways

    def reset(self, view, rng):
        tracks = view.history
        away = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[tracks.row("av"), -1]).T)
        near = [row for row in np.argsort(away, kind="stable") if 0 < away[row] < 25]
        self.opponent = tracks.ids[near[0]] if near else None
        return (self.opponent,) if near else ()

    def plan(self, view):
        tracks = view.history
        me, av = tracks.row(self.opponent), tracks.row("av")
        ahead = tracks.velocity_mps[av, -1] * 1.0
        target = tracks.position_m[av, -1] + ahead + np.array([0.0, self.sideways])
        share = np.linspace(0.1, 1, 10)[:, None]
        here = tracks.position_m[me, -1]
        position = here + share * (target - here)
        return {
            self.opponent: Plan(
                agent_id=self.opponent,
                first_step=view.step + 1,
                position_m=position,
                heading_rad=np.zeros(10),
                speed_mps=np.full(10, np.hypot(*(target - here))),
            )
        }


def episode(config, policy, rules=RULES, start_s=3.0, steps=100):
    case = replace(network_case(config, start_s, "av", steps, seed=0), turns=rules)
    planner = idm.build(idm.Settings())
    return simulate(case, planner, policy, rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def rollout(busy):
    return episode(busy, Ram())


def test_several_opponents_hit_in_one_episode_and_all_drive_on(rollout):
    hits = [turn for turn in rollout.turns if turn.ended == "contact"]
    assert len(hits) >= 2
    assert len({turn.opponent_id for turn in hits}) >= 2
    assert rollout.ended == "time"
    assert rollout.opponent_id == hits[0].opponent_id
    assert rollout.outcome == "av_opponent"
    for turn in hits:
        row = rollout.tracks.row(turn.opponent_id)
        driven = rollout.driver[row, turn.first_step + 1 : turn.last_step + 1]
        assert (driven == Driver.POLICY).all()
        # from where it was hit it drives back to the middle of its lane, to be SUMO's again
        after = rollout.driver[row, turn.last_step + 1 :]
        assert len(after) < 60 or (after == Driver.SUMO).any()
    assert rollout.tracks.valid[:, -1].all()
    assert rollout.tracks.speed_mps[:, -1].max() > 5.0


def test_contacts_are_of_the_turn_in_which_they_happen(rollout):
    cuts = [rollout.of_turn(turn) for turn in rollout.turns]
    kinds = ("av_opponent", "opponent_other", "av_other")
    assert sum(len(cut.contacts) for cut in cuts) <= len(rollout.contacts)
    for turn, cut in zip(rollout.turns, cuts, strict=True):
        assert (cut.now, cut.opponent_id, cut.ended) == (
            turn.first_step, turn.opponent_id, turn.ended,
        )  # fmt: skip
        assert cut.tracks.steps == turn.last_step + 1
        assert len(cut.leaders) == len(cut.signals) == turn.last_step - turn.first_step
        assert {plan.agent_id for plan in cut.plans} <= {turn.opponent_id}
        assert (cut.first("av_opponent") is not None) == (turn.ended == "contact")
        assert all(contact.kind in kinds for contact in cut.contacts)
        last = rollout.tracks.position_m[rollout.tracks.row("av"), turn.last_step]
        assert cut.tracks.position_m[cut.tracks.row("av"), -1] == pytest.approx(last)


def test_equal_seeds_give_equal_turns(busy, rollout):
    again = episode(busy, Ram())
    assert again.turns == rollout.turns
    assert again.tracks.position_m.tobytes() == rollout.tracks.position_m.tobytes()


@pytest.mark.jumps("plans lead sideways")
def test_who_is_off_the_road_when_its_attack_is_over_drives_back_to_a_lane(busy):
    found = episode(busy, Ram(sideways=-9.0), replace(RULES, longest_s=3.0))
    last_y = [
        found.tracks.position_m[found.tracks.row(one.opponent_id), one.last_step, 1]
        for one in found.turns
    ]
    first = found.turns[int(np.argmin(last_y))]
    tracks, row = found.tracks, found.tracks.row(first.opponent_id)
    after = found.driver[row, first.last_step + 1 :]
    on_its_way = int(np.argmax(after == Driver.SUMO))
    assert on_its_way > 5
    assert (after[:on_its_way] == Driver.POLICY).all()
    back = first.last_step + 1 + on_its_way
    y = tracks.position_m[row, first.last_step : back + 1, 1]
    assert min(y) < -8.0
    assert -7.0 < y[-1] < 0.0
    assert np.abs(np.diff(y)).max() < 0.5
    assert {event.kind for event in found.events} <= {"handed_back", "step_length_changed"}


@pytest.mark.jumps("plans lead sideways")
def test_two_vehicles_at_once_where_one_is_still_on_its_way_back(busy):
    found = episode(busy, Ram(sideways=-9.0), replace(RULES, longest_s=3.0))
    driven = (found.driver == Driver.POLICY).sum(axis=0)
    assert driven.max() == 2


@pytest.mark.jumps("plans lead sideways")
def test_who_cannot_get_back_onto_a_lane_is_taken_out_and_it_is_said(busy, monkeypatch):
    from deepmf_sumo.sumo.simulation import attack_schedule
    from deepmf_sumo.sumo.simulation.vehicle_control import Takeover

    monkeypatch.setattr(attack_schedule, "_BACK_ON_LANE_STEPS", 5)
    monkeypatch.setattr(Takeover, "lane_cost", lambda *_: None)
    found = episode(busy, Ram(sideways=-9.0), replace(RULES, longest_s=3.0), steps=60)
    (event, *_) = [event for event in found.events if event.kind == "removed"]
    assert "where SUMO drives no vehicle" in event.detail
    assert not found.tracks.valid[found.tracks.row(event.agent_id), event.step + 1 :].any()


def test_without_a_policy_there_are_no_turns(busy):
    found = episode(busy, None, steps=20)
    assert (found.turns, found.opponent_id, found.ended) == ((), None, "time")
