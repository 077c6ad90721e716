"""A supporter on three lanes; all motions are written down, so that the choice is known by hand."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import box

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import support
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.settings import LIMITS
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Forecast, Futures, Lane, Plan, RoadMap

from tests.support.predictor_doubles import Doubles, view_of

LANE_M = 3.5
LENGTH_M, WIDTH_M = 4.8, 2.0
STEPS = np.arange(1, FUTURE_STEPS + 1) * DT_S
AV_MPS = 12.0
LEADER_M, BRAKES_MPS2 = 30.0, 3.0


def road():
    x = np.linspace(-200.0, 400.0, 121)
    lanes = {
        name: Lane(
            id=name, kind="street", centre_m=np.stack([x, np.full_like(x, y)], -1),
            z_m=np.zeros_like(x), width_m=LANE_M,
        )
        for name, y in (("right", -LANE_M), ("middle", 0.0), ("left", LANE_M))
    }  # fmt: skip
    return RoadMap(lanes=lanes)


def along(x, y, speed, accel=0.0, until_s=99.0):
    """(F, 2) straight on in a lane; it accelerates for ``until_s``."""
    faster = np.minimum(STEPS, until_s)
    moved = speed * STEPS + accel * faster**2 / 2 + accel * faster * (STEPS - faster)
    return np.stack([x + moved, np.full(FUTURE_STEPS, y)], -1)


def stopping(x, y, speed, braking):
    moving = np.minimum(STEPS, speed / braking)
    moved = speed * moving - braking * moving**2 / 2
    return np.stack([x + moved, np.full(FUTURE_STEPS, y)], -1)


def futures(agent, *ways):
    position = np.stack(ways)
    return Futures(agent_id=agent, position_m=position, heading_rad=np.zeros(position.shape[:2]))


@dataclass
class Written:
    """Predicts what is written down: by agent (probability, way), likeliest first.

    Whatever is not written down keeps its velocity.
    """

    ways: dict

    def predict(self, view, agent_id):
        self.asked = agent_id
        row = view.history.row(agent_id)
        (x, y), (speed, _) = view.history.position_m[row, -1], view.history.velocity_mps[row, -1]
        self.ways.setdefault(agent_id, [(1.0, along(x, y, speed))])
        return self

    def modes(self, count):
        chance, ways = zip(*self.ways[self.asked], strict=True)
        return Forecast(futures=futures(self.asked, *ways), probability=np.array(chance))

    def log_density(self, position_m):
        return np.full(len(position_m), -1.0)


def attack(agents, side=1):
    """A leader that brakes, so that an AV which keeps its speed drives into it."""
    view = view_of({name: (x, side * y, 0.0, v) for name, (x, y, v) in agents.items()}, road=road())
    situation = Situation.of(view, "leader", LIMITS)
    way = stopping(LEADER_M, 0.0, AV_MPS, BRAKES_MPS2)
    plan = Plan(
        agent_id="leader", first_step=view.step + 1, position_m=way,
        heading_rad=np.zeros(FUTURE_STEPS), speed_mps=np.gradient(way[:, 0], DT_S),
    )  # fmt: skip
    reaction = along(0.0, 0.0, AV_MPS)
    meets = int((way[:, 0] - reaction[:, 0] < LENGTH_M).argmax())
    return support.AttackPlan(
        situation=situation,
        plan=plan,
        reaction=Forecast(futures=futures("av", reaction), probability=np.ones(1)),
        collides=np.array([True]),
        collision_step=np.array([float(meets)]),
    )


BESIDE = {
    "av": (0.0, 0.0, AV_MPS),
    "leader": (LEADER_M, 0.0, AV_MPS),
    "beside": (-16.0, LANE_M, AV_MPS),
    "away": (-60.0, -LANE_M, AV_MPS),
}
FALLS_BACK = along(-16.0, LANE_M, AV_MPS, accel=-2.0, until_s=3.0)
COMES_UP = along(-16.0, LANE_M, AV_MPS, accel=3.0, until_s=2.6)


def beside(*more, side=1):
    flip = np.array([1.0, side])
    ways = [(0.6, FALLS_BACK), (0.3, COMES_UP), *more]
    return Written({"beside": [(p, way * flip) for p, way in ways]})


def asked(agents=BESIDE, written=None, held=None, side=1):
    return support.supported(attack(agents, side), written or beside(side=side), 8, held)


def boxes_of(position_m, heading_rad, margin=0.0):
    shape = box(-LENGTH_M / 2, -WIDTH_M / 2, LENGTH_M / 2, WIDTH_M / 2).buffer(
        margin, join_style="mitre"
    )
    return [
        affinity.translate(affinity.rotate(shape, angle, use_radians=True), *at)
        for at, angle in zip(position_m, heading_rad, strict=True)
    ]


def meet(one, other):
    """Whether two rows of boxes share an area at the same time."""
    return any(a.intersection(b).area > 1e-6 for a, b in zip(one, other, strict=True))


def test_the_only_one_beside_comes_up_and_takes_the_left():
    found = asked()
    assert found.plan.agent_id == found.support.agent_id == "beside"
    assert found.plan.supports == "leader"
    np.testing.assert_allclose(found.plan.position_m[:40], COMES_UP[:40], atol=1.0)
    ways = found.support.ways
    assert ways["left"] > 0.5
    assert ways["brake"] == ways["right"] == 0.0
    assert found.support.probability == pytest.approx(0.3)
    assert found.support.note == ""


def test_the_share_of_the_left_is_that_of_boxes_drawn_by_shapely():
    """Counted anew: manoeuvres to the left that miss the leader, and those that meet the other."""
    given = attack(BESIDE)
    moment = support._Moment(given, beside(), 8)
    plan = asked().plan
    leader = boxes_of(given.plan.position_m, given.plan.heading_rad)
    other = boxes_of(plan.position_m, plan.heading_rad)
    free = gone = 0
    for start in moment._starts:
        for row in np.flatnonzero(support.WAYS["left"]):
            way = start.futures.position_m[row], start.futures.heading_rad[row]
            drawn = boxes_of(*way)
            inside = np.abs(way[0][:, 1]).max() + WIDTH_M / 2 <= 1.5 * LANE_M + 0.5
            shown = slice(start.first, start.first + len(drawn))
            missed = not meet(drawn, leader[shown])
            assert not start.open_[row] or missed
            if start.open_[row] and inside:
                free += 1
                gone += meet(drawn, other[shown])
    assert free > 20
    assert asked().support.ways["left"] == pytest.approx(gone / free, abs=0.02)


def test_the_mirrored_scene_gives_the_mirrored_choice():
    one, other = asked(), asked(side=-1)
    np.testing.assert_allclose(other.plan.position_m, one.plan.position_m * [1, -1], atol=1e-9)
    assert other.support.ways["right"] == pytest.approx(one.support.ways["left"])
    assert other.support.ways["left"] == 0.0


def test_who_is_in_the_way_anyway_is_no_support():
    written = Written({"beside": [(0.7, COMES_UP), (0.3, FALLS_BACK)]})
    found = asked(written=written)
    assert found.plan is None
    assert found.support.note == "no bystander takes a way out and touches nobody"


def test_what_is_unlikely_for_it_is_not_its_own_motion():
    rare = Written({"beside": [(0.95, FALLS_BACK), (0.05, COMES_UP)]})
    assert asked(written=rare).plan is None


def into(y, begin_s=0.5, seconds=2.5, x=-16.0):
    share = np.clip((STEPS - begin_s) / seconds, 0, 1)
    way = along(x, LANE_M, AV_MPS, accel=3.0, until_s=2.6)
    way[:, 1] += (y - LANE_M) * share**2 * (3 - 2 * share)
    return way


def test_it_touches_neither_av_nor_attacker_nor_others():
    """Three likelier motions take more of the left, each of them meets somebody."""
    agents = {**BESIDE, "slow": (20.0, LANE_M, 4.0)}
    meets_slow = along(-16.0, LANE_M, AV_MPS, accel=3.0, until_s=8.0)
    written = beside((0.3, into(1.0)), (0.3, into(0.0, begin_s=2.0)), (0.3, meets_slow))
    for scene in (BESIDE, agents):
        found = asked(scene, written)
        if found.plan is None:
            assert scene is agents  # all that come up meet the slow vehicle
            continue
        given = attack(scene)
        until = min(int(given.collision_step[0]) + 21, FUTURE_STEPS)
        mine = boxes_of(found.plan.position_m, found.plan.heading_rad, margin=0.2)
        leader = boxes_of(given.plan.position_m, given.plan.heading_rad)
        av = boxes_of(given.reaction.futures.position_m[0], np.zeros(FUTURE_STEPS))
        met = int(given.collision_step[0]) + 1
        assert not meet(mine[:until], leader[:until])
        assert not meet(mine[:met], av[:met])
        assert found.plan.position_m[:met, 1] == pytest.approx(LANE_M, abs=0.3)


def first_meeting(mine, other):
    meets = [a.intersection(b).area > 1e-6 for a, b in zip(mine, other, strict=True)]
    return meets.index(True) if True in meets else None


@pytest.mark.parametrize("what", ["av", "leader", "slow", "nobody", "beside the road"])
def test_how_long_it_stays_clear_is_what_shapely_says(what):
    """Of the AV only until that meets the attacker; of all within the margin, as it is tracked."""
    scene = {**BESIDE, "slow": (20.0, 2 * LANE_M, 12.0)}
    ways = {
        "av": into(0.0, begin_s=1.0, seconds=2.0),
        "leader": np.stack([np.minimum(-16.0 + 20.0 * STEPS, 60.0), 0.8 + 0 * STEPS], -1),
        "slow": into(LANE_M + 1.7, begin_s=0.5, seconds=2.0),
        "nobody": COMES_UP,
        "beside the road": into(LANE_M + 5.0, begin_s=0.5, seconds=2.5),
    }
    if what == "leader":
        scene["beside"] = (-16.0, 0.8, 20.0)
        scene["av"] = (0.0, -LANE_M, AV_MPS)
    given = attack(scene)
    if what == "leader":  # the AV is not in the way
        far = futures("av", along(0.0, -LANE_M, AV_MPS))
        given = replace(given, reaction=Forecast(futures=far, probability=np.ones(1)))
    moment = support._Moment(given, Written({"beside": [(1.0, ways[what])]}), 8)
    offer = moment.offer("beside", None)
    way = offer.own.forecast.futures
    end = min(int(given.collision_step[0]) + 20, FUTURE_STEPS)
    mine = boxes_of(way.position_m[0], way.heading_rad[0], margin=0.25)[:end]
    met = int(given.collision_step[0]) + 1
    others = {
        "av": boxes_of(given.reaction.futures.position_m[0], np.zeros(FUTURE_STEPS))[:met],
        "leader": boxes_of(given.plan.position_m, given.plan.heading_rad)[:end],
        "slow": boxes_of(along(20.0, 2 * LANE_M, 12.0), np.zeros(FUTURE_STEPS))[:end],
    }
    first = {name: first_meeting(mine[: len(its)], its) for name, its in others.items()}
    if what == "beside the road":
        assert offer.clear_steps[0] == 0
    elif what == "nobody":
        assert set(first.values()) == {None}
        assert offer.clear_steps[0] == FUTURE_STEPS
    else:
        assert first[what] == min(step for step in first.values() if step is not None)
        assert offer.clear_steps[0] == first[what]


def test_a_likelier_one_that_takes_less_is_worth_less():
    a_bit = along(-16.0, LANE_M, AV_MPS, accel=0.5, until_s=2.0)
    written = Written({"beside": [(0.5, FALLS_BACK), (0.26, a_bit), (0.24, COMES_UP)]})
    found = asked(written=written)
    assert found.support.probability == pytest.approx(0.24)
    np.testing.assert_allclose(found.plan.position_m[:40], COMES_UP[:40], atol=1.0)


def test_what_others_have_taken_already_counts_for_nobody():
    row = {f"wall {x}": (float(x), LANE_M, AV_MPS) for x in (-8, -2, 4, 10, 16)}
    alone, among = (
        support._Moment(attack(scene), beside(), 8).offer("beside", None).taken["left"][1]
        for scene in (BESIDE, {**BESIDE, **row})
    )
    assert alone > 0.5 > 2 * among


def test_a_slow_one_ahead_of_it_keeps_it_from_coming_up():
    assert asked({**BESIDE, "slow": (14.0, LANE_M, 2.0)}).plan is None


@pytest.mark.parametrize(("braking", "clear"), [(0.0, True), (0.4, True), (3.0, False)])
def test_it_can_stop_behind_who_brakes_now(braking, clear):
    """One 40 m ahead of it, as fast as it will be; at 3 m/s2 that stands at x = 91 m after 7 s."""
    assert COMES_UP[59, 0] > 85.0
    given = attack({**BESIDE, "slow": (24.0, LANE_M, 20.0)})
    tracks = given.situation.view.history
    row, back_s = tracks.row("slow"), DT_S * np.arange(10, -1, -1)
    velocity = tracks.velocity_mps.copy()
    velocity[row, :, 0] = 20.0 + braking * back_s
    view = replace(given.situation.view, history=replace(tracks, velocity_mps=velocity))
    given = replace(given, situation=replace(given.situation, view=view))
    offer = support._Moment(given, beside(), 8).offer("beside", None)
    assert (offer.clear_steps[1] == FUTURE_STEPS) == clear


def follows(x, keeps_s):
    """One that follows ``x`` behind the AV: it gives way, or keeps its speed and brakes late."""
    steps = round(keeps_s / DT_S)
    late = stopping(x + AV_MPS * keeps_s, 0.0, AV_MPS, 5.0)[: FUTURE_STEPS - steps]
    presses = np.concatenate([along(x, 0.0, AV_MPS)[:steps], late])
    ways = Written({"beside": [(0.6, stopping(x, 0.0, AV_MPS, 4.0)), (0.4, presses)]})
    return {**BESIDE, "beside": (x, 0.0, AV_MPS)}, ways


def test_who_would_leave_no_reference_driver_a_way_out_does_not_support(monkeypatch):
    """All reference drivers brake; one that presses from behind drives into each of them."""
    assert asked(*follows(-8.0, 3.3)).plan is None
    everybody = lambda self, situation, own: np.ones(len(own.origin), bool)  # noqa: E731
    monkeypatch.setattr(support._Moment, "_fair", everybody)
    found = asked(*follows(-8.0, 3.3))
    assert found.plan.agent_id == "beside"
    assert found.support.ways["brake"] > 0.2


def test_one_reference_driver_that_is_left_is_enough():
    """From 11 m behind it meets only the one that brakes later and harder."""
    given = attack(BESIDE)
    assert len(support._Moment(given, beside(), 8).drivers) == 2
    found = asked(*follows(-11.0, 3.0))
    assert found.plan.agent_id == "beside"
    assert found.support.ways["brake"] > 0.2


def test_nobody_supports_what_no_reference_driver_avoids(monkeypatch):
    monkeypatch.setattr(support._Moment, "drivers", np.empty((0, FUTURE_STEPS + 1)))
    found = asked()
    assert (found.plan, found.support.note) == (None, "no reference driver avoids the plan")


def test_the_same_one_goes_on_and_keeps_clear_where_it_can_take_nothing():
    first = asked().plan
    again = asked(held=first)
    assert again.plan.agent_id == "beside"
    assert again.support.ways["left"] > 0.5
    stops = stopping(-16.0, LANE_M, AV_MPS, 3.0)
    behind = Written({"beside": [(1.0, stops)]})
    stays = Plan(
        agent_id="beside", first_step=first.first_step, position_m=stops,
        heading_rad=np.zeros(FUTURE_STEPS), speed_mps=first.speed_mps, supports="leader",
    )  # fmt: skip
    calm = asked(written=behind, held=stays)
    assert calm.support.note == "it keeps clear"
    np.testing.assert_allclose(calm.plan.position_m[:30], stops[:30], atol=1.0)


def test_a_supporter_that_has_left_gets_no_plan():
    gone = Plan(
        agent_id="gone", first_step=11, position_m=COMES_UP,
        heading_rad=np.zeros(FUTURE_STEPS), speed_mps=np.zeros(FUTURE_STEPS), supports="leader",
    )  # fmt: skip
    found = asked(held=gone)
    assert (found.plan, found.support.note) == (None, "the supporter has left")


CROWD = {"av": (0, 0, 0, 10.0), "near": (-8, 3.5, 0, 12.0), "more": (-14, -3.5, 0, 12.0)}


def first_plans(**values):
    made = build(
        plugins.settings("adversaries", "deepmf", {"opponent": "near", **values}), Doubles()
    )
    view = view_of(CROWD, road=road())
    made.reset(view, np.random.default_rng(0))
    return made.plan(view)


def test_without_the_setting_nothing_is_asked_and_nothing_differs():
    plain, off, on = first_plans(), first_plans(supporting=0), first_plans(supporting=1)
    assert plain.keys() == off.keys() == {"near"}
    assert plain["near"].reason.support is None
    assert "support" not in plain["near"].reason.milliseconds
    assert on["near"].reason.support is not None
    for other in (off, on):
        np.testing.assert_array_equal(plain["near"].position_m, other["near"].position_m)
    settings = plugins.settings("adversaries", "deepmf", {"supporting": 0})
    assert "supporting" not in settings.model_dump()


def test_the_paper_form_has_no_supporters():
    with pytest.raises(Exception, match="supporting"):
        plugins.settings("adversaries", "deepmf", {"form": "paper", "supporting": 1})
