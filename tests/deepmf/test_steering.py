"""Wanted sector, fairness and aggressiveness of DeepMF; and that without them nothing changes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import scoring
from deepmf_sumo.deepmf.candidates import NO_SECTOR, collisions, delta_v, impact_sectors
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.reference_paths import aimed_paths, own_paths
from deepmf_sumo.deepmf.scoring import Balance, Mask, Objective, Pairs
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.errors import PluginError
from deepmf_sumo.scene import Forecast, Futures
from deepmf_sumo.scene.geometry import impact
from deepmf_sumo.scene.road_users import MotionLimits

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, FanPredictor, view_of

AGENTS = {"av": (0, 0, 0, 10.0), "near": (-8, 3.5, 0, 12.0), "far": (60, -40, np.pi / 2, 9.0)}
CAR = np.array([4.8, 2.0])
LIMITS = MotionLimits(accel=3.0, brake=4.0, lateral=3.0)


def policy(**values):
    settings = plugins.settings("adversaries", "deepmf", values)
    return build(settings, Doubles())


def first_plan(view=None, **values):
    view = view or view_of(AGENTS)
    made = policy(**values)
    made.reset(view, np.random.default_rng(0))
    return plan_of(made, view)


@pytest.mark.parametrize(
    ("values", "chosen", "total", "numbers"),
    [
        ({}, 4, 64, [15.770186, 0.632863, 73.94458, -39.129543, 0.046439]),
        (
            {"rule": "likeliest"},
            5,
            64,
            [15.823728, 0.975934, 74.421053, -38.341898, 0.044312],
        ),
        (
            {"rule": "pair", "form": {"goal_candidates": 0}},
            4,
            32,
            [15.770186, 0.632863, 73.94458, -39.129543, 0.017108],
        ),
        (
            {"opponent": "far", "form": {"likelihood_weight": 0.1}},
            19,
            64,
            [56.432689, -21.45485, 3.773635, 9.613433, 0.460738],
        ),
    ],
)
def test_without_wishes_plans_are_what_they_were(values, chosen, total, numbers):
    """Decisions stored before steering was there."""
    then = {"tried_opponents": 1, "goal_candidates": 32, "shortlist": None, "reactions": 6}
    form = then | {"comfort_weight": 0} | values.get("form", {})
    limits = {"accel_mps2": 3, "brake_mps2": 4, "lateral_mps2": 3}
    plan = first_plan(**limits | values | {"form": form})
    reason = plan.reason
    assert (reason.chosen, len(reason.origin)) == (chosen, total)
    found = [*plan.position_m[19], *plan.position_m[79], reason.value.max()]
    np.testing.assert_allclose(found, numbers, atol=2e-6)
    assert (reason.sector, reason.fair, reason.wanted_sector, reason.unmet) == (
        None,
        None,
        None,
        (),
    )


@pytest.mark.parametrize(
    "values",
    [
        {"sector": 4},
        {"sector": "behind"},
        {"sector": "2"},
        {"aggressiveness": 1.1},
        {"aggressiveness": 0.5, "rule": "likeliest"},
        {"aggressiveness": 0.5, "form": {"likelihood_weight": 0.3}},
        {"fair": True},
    ],
)
def test_wrong_wishes_are_refused(values):
    with pytest.raises(PluginError):
        plugins.settings("adversaries", "deepmf", values)


def test_a_sector_has_a_number_and_a_name():
    for number, name in enumerate(impact.SECTORS):
        assert policy(sector=name)._settings.wanted_sector == number
    assert policy()._settings.wanted_sector is None


# Three candidates, two reactions each.
P = np.array([0.5, 0.3, 0.2])
REACTION = np.array([[0.6, 0.4]] * 3)
COLLIDES = np.array([[True, True], [True, False], [False, True]])
PAIRS = Pairs(
    probability=P,
    reaction_probability=REACTION,
    collides=COLLIDES,
    collision_step=np.where(COLLIDES, 10.0, 80.0),
)


def pairs(**more):
    return replace(PAIRS, **more)


def choose(rule="expected", found=PAIRS, sector=None, wanted=None, fair=None):
    """The choice, and what is unmet, with sectors of the pairs and fair candidates."""
    masks = [] if sector is None else [Mask("sector", "preferred", sector == wanted)]
    masks += [] if fair is None else [Mask("fair", "attack", fair)]
    choice = scoring.choose_allowed(found, masks, Objective(rule))
    return choice, choice.unmet


def test_only_pairs_of_the_wanted_sector_count():
    sector = np.where(COLLIDES, [[0, 4], [4, 0], [4, 6]], NO_SECTOR)
    assert choose()[0].index == 0
    rear, unmet = choose("expected", sector=sector, wanted=4)
    # The first candidate would hit the front more likely than the rear.
    np.testing.assert_allclose(rear.value, [0.0, 0.3 * 0.6, 0.0])
    np.testing.assert_allclose(rear.product, [0.5, 0.3 * 0.6, 0.2 * 0.4])
    assert (rear.index, rear.rule, unmet) == (1, "expected", ())
    first = np.where(COLLIDES, [[0, 4], [0, 0], [0, 6]], NO_SECTOR)
    assert choose(sector=first, wanted=4)[0].index == 0
    right, unmet = choose("likeliest", sector=sector, wanted=6)
    assert (right.index, right.rule, unmet) == (2, "likeliest", ())


def test_a_sector_that_nobody_reaches_is_given_up_and_named():
    sector = np.where(COLLIDES, 0, NO_SECTOR)
    choice, unmet = choose(sector=sector, wanted=2)
    assert (choice.index, choice.rule, unmet) == (0, "expected, any sector", ("sector",))
    never = pairs(collides=np.zeros_like(COLLIDES))
    choice, unmet = choose(found=never, sector=np.full((3, 2), NO_SECTOR), wanted=2)
    assert (choice.rule, unmet) == ("fallback", ("sector",))


@pytest.mark.parametrize("rule", ["expected", "pair", "likeliest", Balance.at(0), Balance.at(0.8)])
def test_unfair_candidates_are_not_driven(rule):
    fair = np.array([False, False, True])
    choice, unmet = choose(rule, pairs(severity=COLLIDES * 5.0), fair=fair)
    assert (choice.index, unmet) == (2, ())


def test_where_nothing_is_fair_nobody_is_attacked():
    never = np.zeros(3, dtype=bool)
    choice, unmet = choose(fair=never)
    # Everything collides with something: the candidate that collides least.
    assert (choice.index, choice.rule, unmet) == (2, "nothing fair", ("fair",))
    collides = np.array([[True, True], [False, False], [False, False]])
    choice, _ = choose(found=pairs(collides=collides), fair=never)
    assert choice.index == 1


def test_an_unfair_choice_is_refused_until_one_is_verified():
    every = [Mask("fair", "attack", np.ones(3, dtype=bool))]
    asked = []

    def confirmed(number, row):
        asked.append(row)
        return row == 2

    choice, found = scoring.decide(PAIRS, every, Objective(), confirmed)
    assert (asked, choice.index, choice.unmet) == ([0, 1, 2], 2, ())
    assert found[0].allowed.tolist() == [False, False, True]
    choice, _ = scoring.decide(PAIRS, every, Objective(), lambda number, row: False)
    assert (choice.rule, choice.unmet) == ("nothing fair", ("fair",))
    choice, _ = scoring.decide(PAIRS, [], Objective(), lambda number, row: False)
    assert choice.index == 0


@given(some.integers(0, 2**32 - 1))
def test_more_aggressive_is_never_likelier_nor_milder(seed):
    rng = np.random.default_rng(seed)
    probability = rng.dirichlet(np.full(12, 0.3))
    reaction = rng.dirichlet(np.ones(4), size=12)
    collides = rng.random((12, 4)) < 0.4
    collides[0, 0] = True
    severity = rng.uniform(0.5, 12, (12, 4)) * collides
    step = np.where(collides, rng.integers(0, 80, (12, 4)), 80).astype(float)
    mass = (reaction * collides).sum(1)
    expected = (reaction * severity).sum(1) / np.maximum(mass, 1e-9)
    levels = np.linspace(0, 1, 11)
    found = Pairs(
        probability=probability,
        reaction_probability=reaction,
        collides=collides,
        collision_step=step,
        severity=severity,
    )
    rows = [scoring.choose(found, Objective(Balance.at(level))).index for level in levels]
    assert probability[rows[0]] == probability.max()
    assert (np.diff(probability[rows]) <= 1e-9).all()
    assert (np.diff(mass[rows][levels <= 0.5]) >= -1e-9).all()
    assert (np.diff(expected[rows][levels >= 0.5]) >= -1e-6).all()


def test_half_aggressive_is_the_likeliest_rule():
    half, likeliest = first_plan(aggressiveness=0.5), first_plan(rule="likeliest")
    np.testing.assert_array_equal(half.position_m, likeliest.position_m)
    assert half.reason.rule == "aggressiveness"


def test_aggressiveness_bounds_what_is_driven():
    hardest = []
    for level in (0.0, 0.5, 1.0):
        plan = first_plan(aggressiveness=level, opponent="far")
        change = np.diff(plan.speed_mps) / 0.1
        limits = policy(aggressiveness=level)._settings.limits
        assert change.max() <= limits.accel + 1e-6
        assert -change.min() <= limits.brake + 1e-6
        hardest.append(limits.lateral)
    np.testing.assert_allclose(hardest, 3.5 * np.array([0.5**0.5, 1.0, 2**0.5]))


def test_sectors_of_pairs_are_those_of_the_first_overlap():
    view = view_of(AGENTS)
    own, av = (FanPredictor().predict(view, name).modes(32) for name in ("near", "av"))
    reactions = [av] * 32
    collides, step = collisions(own.futures, reactions, CAR, CAR, 80)
    found = impact_sectors(own.futures, reactions, CAR, CAR, step)
    assert ((found == NO_SECTOR) == ~collides).all()
    assert len(np.unique(found[collides])) >= 3
    change = delta_v(own.futures, reactions, CAR, CAR, step)
    assert ((change > 0) == collides).all()
    for j, k in np.argwhere(collides)[::40]:
        at = int(step[j, k])
        ours, theirs = own.futures, av.futures
        assert found[j, k] == impact.sectors(
            theirs.position_m[k, at],
            theirs.heading_rad[k, at],
            CAR,
            ours.position_m[j, at],
            ours.heading_rad[j, at],
            CAR,
        )
        moved = [one[at] - one[at - 1] for one in (theirs.position_m[k], ours.position_m[j])]
        assert change[j, k] == pytest.approx(np.hypot(*(moved[0] - moved[1])) / 0.1 / 2)


def test_a_lorry_changes_the_speed_of_a_car_more_than_a_car_does():
    """Masses count as areas: of 10 m/s a lorry of three times the area gives three quarters."""
    along = np.arange(1, 21) * 1.0
    own = Futures(
        agent_id="b",
        position_m=np.stack([along - 20, 0 * along], -1)[None],
        heading_rad=np.zeros((1, 20)),
    )
    stands = Futures(agent_id="av", position_m=np.zeros((1, 20, 2)), heading_rad=np.zeros((1, 20)))
    reactions = [Forecast(futures=stands, probability=np.ones(1))]
    car, lorry = np.array([4.0, 2.0]), np.array([10.0, 2.4])
    step = np.full((1, 1), 15.0)
    assert delta_v(own, reactions, lorry, car, step) == pytest.approx(7.5)
    assert delta_v(own, reactions, car, car, step) == pytest.approx(5.0)


# Where an opponent can come from, so that it can reach a side of an AV that drives at 10 m/s.
PLACES = {
    "front": (25, 0, 0, 10.0),
    "front_left": (2, 3.5, 0, 10.0),
    "left": (30, 40, -np.pi / 2, 10.0),
    "rear_left": (-14, 3.5, 0, 12.0),
    "rear": (-18, 0, 0, 12.0),
    "rear_right": (-14, -3.5, 0, 12.0),
    "right": (30, -40, np.pi / 2, 10.0),
    "front_right": (2, -3.5, 0, 10.0),
}


def aimed(view, sector, count, opponent="b"):
    """References to a side of the AV, and the futures of the two."""
    own, av = (FanPredictor().predict(view, name).modes(32) for name in (opponent, "av"))
    situation = Situation.of(view, opponent, LIMITS, unattacked=av)
    return aimed_paths(situation, own_paths(own, situation.start), sector, count), own, av


@pytest.mark.parametrize("name", impact.SECTORS)
def test_ways_are_made_to_every_side(name):
    view = view_of({"av": (0, 0, 0, 10.0), "b": PLACES[name]})
    sector = impact.SECTORS.index(name)
    paths, own, av = aimed(view, sector, 16)
    assert 4 <= len(paths.limits) <= 16
    tracked = track(paths.position_m, Start.of(view, "b"), paths.limits)
    futures = type(own.futures)(
        agent_id="b", position_m=tracked.position_m, heading_rad=tracked.heading_rad
    )
    reactions = [av] * len(paths.limits)
    _, step = collisions(futures, reactions, CAR, CAR, 80)
    found = impact_sectors(futures, reactions, CAR, CAR, step)
    # What was made undriven still hits there when a bicycle follows it.
    assert (found == sector).any(axis=1).mean() > 0.5


def test_nothing_is_aimed_without_time_or_reach():
    view = view_of(AGENTS)
    assert len(aimed(replace(view, steps_left=3), 0, 16, "near")[0].limits) == 0
    assert len(aimed(view, 0, 0, "near")[0].limits) == 0
    away = view_of({"av": (0, 0, 0, 10.0), "b": (600, 300, 0, 12.0)})
    none = aimed(away, 0, 16)[0]
    assert none.position_m.shape == (0, 80, 2)


@pytest.mark.parametrize("name", ["rear", "left", "front_left"])
def test_a_plan_hits_the_wanted_side(name):
    view = view_of({"av": (0, 0, 0, 10.0), "b": PLACES[name]})
    plan = first_plan(view, sector=name, rule="likeliest", form={"reactions": 6})
    reason, sector = plan.reason, impact.SECTORS.index(name)
    assert (reason.rule, reason.wanted_sector, reason.unmet) == ("likeliest", sector, ())
    assert "aim" in reason.origin
    likely = reason.reactions[reason.chosen].probability
    there = likely @ (reason.sector[reason.chosen] == sector)
    assert there > 0.1
    assert 2 * there > likely @ reason.collides[reason.chosen]


def test_a_plan_says_that_it_cannot_hit_the_wanted_side():
    view = view_of({"av": (0, 0, 0, 10.0), "b": (12, 0, 0, 2.0)})
    reason = first_plan(view, sector="rear").reason
    assert (reason.rule, reason.unmet) == ("expected, any sector", ("sector",))


def test_a_fair_plan_leaves_a_driver_time():
    view = view_of({"av": (0, 0, 0, 10.0), "b": (60, 3.5, 0, 9.0)})
    reason = first_plan(view, constraints=["fair"], opponent="b").reason
    hits = reason.collides.any(1)
    assert reason.fair[reason.chosen]
    assert (hits & reason.fair).any()
    late = view_of({"av": (0, 0, 0, 20.0), "b": (9, 0, 0, 3.0)})
    plan = first_plan(late, constraints=["fair"])
    assert not (plan.reason.collides.any(1) & plan.reason.fair).any()
    assert (plan.reason.rule, plan.reason.unmet) == ("nothing fair", ("fair",))


def test_what_was_fair_when_it_began_may_be_finished():
    made = policy(constraints=["fair"], opponent="b", rule="likeliest")
    view = view_of({"av": (0, 0, 0, 10.0), "b": (40, 3.5, 0, 9.0)})
    made.reset(view, np.random.default_rng(0))
    first = plan_of(made, view)
    assert first.reason.rule == "likeliest"
    hit = first.reason.collides[first.reason.chosen]
    step = int(first.reason.collision_step[first.reason.chosen, hit].min())
    at = step - 6
    assert at > 0
    reaction = first.reason.reactions[first.reason.chosen].futures
    av = int(np.flatnonzero(hit)[0])
    speed = np.hypot(*(reaction.position_m[av, at] - reaction.position_m[av, at - 1])) / 0.1
    agents = {
        "av": (*reaction.position_m[av, at], float(reaction.heading_rad[av, at]), float(speed)),
        "b": (*first.position_m[at], float(first.heading_rad[at]), float(first.speed_mps[at])),
    }
    second = plan_of(made, view_of(agents, step=11 + at, steps_left=70)).reason
    row = second.origin.index("tail")
    assert second.fair[row]
    assert second.collides[row].any()
    assert second.rule == "likeliest"
