import numpy as np
import pytest

from deepmf_sumo.deepmf import scoring
from deepmf_sumo.deepmf.scoring import Objective, Pairs

# Two candidates: the first with three reactions of .3 that all collide (and .1 that does not), the
# second with one of .9 that does.
P = np.array([0.3, 0.25])
REACTION = np.array([[0.3, 0.3, 0.3, 0.1], [0.9, 0.05, 0.03, 0.02]])
COLLIDES = np.array([[True, True, True, False], [True, False, False, False]])
STEP = np.where(COLLIDES, 20.0, 80.0)


def choose(probability, reaction, collides, step, rule, weight=1.0, *, barred=None, rng=None):
    pairs = Pairs(
        probability=probability,
        reaction_probability=reaction,
        collides=collides,
        collision_step=step,
    )
    return scoring.choose(pairs, Objective(rule, weight, rng), barred=barred)


def test_the_published_rules_disagree_where_collision_mass_is_spread():
    expected = choose(P, REACTION, COLLIDES, STEP, "expected")
    assert expected.index == 0
    np.testing.assert_allclose(expected.value, [0.27, 0.225])
    pair = choose(P, REACTION, COLLIDES, STEP, "pair")
    assert pair.index == 1
    np.testing.assert_allclose(pair.value, [0.09, 0.225])
    assert (expected.rule, pair.rule) == ("expected", "pair")
    for choice in (expected, pair):
        np.testing.assert_allclose(choice.product, [0.27, 0.225])


def test_likeliest_among_the_candidates_with_nearly_all_collision_mass():
    probability = np.array([0.6, 0.3, 0.1])
    reaction = np.tile([0.94, 0.05, 0.01], (3, 1))
    collides = np.array([[False, True, False], [True, False, False], [True, True, False]])
    step = np.where(collides, 5.0, 80.0)
    choice = choose(probability, reaction, collides, step, "likeliest")
    # Masses .05, .94, .99: .94 is 94.9 % of .99, just too little.
    assert choice.index == 2
    reaction = np.tile([0.95, 0.04, 0.01], (3, 1))
    assert choose(probability, reaction, collides, step, "likeliest").index == 1
    assert choose(probability, reaction, collides, step, "expected").index == 1


def test_likelihood_weight_moves_the_balance_to_collision_mass():
    probability = np.array([0.9, 0.1])
    reaction = np.tile([0.2, 0.8], (2, 1))
    collides = np.array([[True, False], [True, True]])
    step = np.where(collides, 9.0, 80.0)
    plain = choose(probability, reaction, collides, step, "expected")
    assert plain.index == 0
    light = choose(probability, reaction, collides, step, "expected", 0.1)
    assert light.index == 1
    np.testing.assert_allclose(light.value, [0.9**0.1 * 0.2, 0.1**0.1 * 1.0])
    np.testing.assert_allclose(light.product, plain.product)
    assert choose(probability, reaction, collides, step, "expected", 0.0).index == 1


@pytest.mark.parametrize("rule", ["expected", "pair", "likeliest"])
def test_fallback_is_the_best_pair(rule):
    never = np.zeros_like(COLLIDES)
    choice = choose(P, REACTION, never, np.full(STEP.shape, 80.0), rule, 0.1)
    assert (choice.index, choice.rule) == (1, "fallback")  # .25 * .9 against .3 * .3
    np.testing.assert_allclose(choice.value, [0.09, 0.225])
    np.testing.assert_array_equal(choice.product, 0.0)


def test_ties_go_to_the_earlier_collision_then_the_likelier_then_the_first():
    reaction = np.ones((3, 1))
    collides = np.ones((3, 1), bool)
    even = np.full(3, 1 / 3)
    step = np.array([[30.0], [10.0], [10.0]])
    assert choose(even, reaction, collides, step, "expected").index == 1
    assert choose(even, reaction, collides, np.full((3, 1), 4.0), "expected").index == 0
    uneven = np.array([0.2, 0.3, 0.5])
    same = choose(uneven, reaction, collides, np.full((3, 1), 4.0), "expected", 0.0)
    assert same.index == 2
    earlier = choose(uneven[::-1], reaction, collides, step, "expected", 0.0)
    assert earlier.index == 1


def test_severity_is_the_mean_over_the_reactions_that_collide():
    """4 m/s in the 60 % that collide is more severe than 3 m/s in all."""
    pairs = Pairs(
        probability=np.array([0.5, 0.5]),
        reaction_probability=np.array([[1.0, 0.0], [0.6, 0.4]]),
        collides=np.array([[True, False], [True, False]]),
        collision_step=np.array([[20.0, 80.0], [20.0, 80.0]]),
        severity=np.array([[3.0, 0.0], [4.0, 0.0]]),
    )
    balance = scoring.Balance(mass_share=0.5, severity_share=1.0)
    choice = scoring.choose(pairs, Objective(balance))
    assert choice.index == 1
    np.testing.assert_allclose(choice.value, [3.0, 4.0])


def test_drawn_candidates_are_of_all_kinds_and_mostly_such_that_collide():
    probability = np.array([0.5, 0.4, 0.1])
    reaction = np.tile([0.9, 0.1], (3, 1))
    collides = np.array([[False, False], [True, False], [False, True]])
    step = np.where(collides, 5.0, 80.0)
    rng = np.random.default_rng(3)
    drawn = [
        choose(probability, reaction, collides, step, "drawn", rng=rng).index for _ in range(2000)
    ]
    share = np.bincount(drawn, minlength=3) / len(drawn)
    np.testing.assert_allclose(share, np.array([0.05, 0.95, 0.15]) / 1.15, atol=0.03)
    nothing = choose(probability, reaction, collides & False, step, "drawn", rng=rng)
    assert nothing.rule == "drawn"


def test_who_is_barred_is_not_drawn_and_the_others_keep_their_chances():
    probability = np.full(3, 1 / 3)
    reaction, collides = np.ones((3, 1)), np.ones((3, 1), bool)
    barred = np.array([False, True, False])
    rng = np.random.default_rng(3)
    drawn = [
        choose(
            probability, reaction, collides, 5.0 * collides, "drawn", barred=barred, rng=rng
        ).index
        for _ in range(1000)
    ]
    share = np.bincount(drawn, minlength=3) / len(drawn)
    np.testing.assert_allclose(share, [0.5, 0.0, 0.5], atol=0.04)
