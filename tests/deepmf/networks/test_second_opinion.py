"""What the marginal network knows of people, added to the conditional network's goals."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.networks import decode, predict, torch_networks
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.deepmf.networks.decode import GoalSet
from deepmf_sumo.deepmf.networks.predict import Conditional, Marginal
from deepmf_sumo.scene import Futures

from tests.support.synthetic import view

SMALL = replace(LIGHT, name="small", hidden=16, vgg_widths=(4, 4, 4, 4, 4), profiles=7)


def goals(ends_m, logits):
    """Goals of one vehicle that end so far along its paths (P, R)."""
    ends_m, logits = np.array(ends_m, np.float32), np.array(logits, np.float32)
    paths, profiles = ends_m.shape
    return GoalSet(
        logits=logits[None],
        along_m=ends_m[:, :, None] * np.arange(1, 81, dtype=np.float32) / 80,
        knots=np.zeros((1, paths, profiles, 5, 2), np.float32),
        paths=np.zeros((paths, 121, 2), np.float32),
    )


@pytest.fixture(scope="module")
def nets():
    """A marginal and a conditional network with opinions."""
    made = torch_networks.random(SMALL, 0)
    for net in (made.marginal.net, made.conditional.net):
        net.score.weight.data *= 20.0
    return made.marginal.net, made.conditional.net


def shares(found):
    return np.sort(found.probability)


def test_who_agrees_adds_nothing():
    own = goals([[10.0, 30.0], [5.0, 80.0]], [[0.3, 1.0], [-2.0, 0.0]])
    assert np.abs(decode.gain(own, [own])).max() < 1e-6
    assert np.abs(decode.gain(own, [own, own])).max() < 1e-6


def test_a_goal_gains_what_others_hold_of_it_more():
    own = goals([[0.0, 500.0], [0.0, 500.0]], [[0.0, 0.0], [0.0, 0.0]])
    other = goals([[500.0, 0.0], [0.0, 500.0]], [[0.0, 2.0], [1.0, 0.0]])  # in another order
    found = decode.gain(own, [other])
    expected = np.array([[2.0, 0.0], [1.0, 0.0]])
    assert np.allclose(found - found[0, 1], expected, atol=1e-4)


def test_goals_that_end_near_by_are_much_alike():
    own = goals([[20.0, 60.0]], [[0.0, 0.0]])
    other = goals([[24.0, 100.0]], [[0.0, 0.0]])
    near, far = decode.gain(own, [other])[0]
    assert near == pytest.approx(-4.0 / 3.0, abs=0.01)
    assert far < near - 5.0


def test_a_path_that_does_not_exist_stays_out():
    own = goals([[10.0], [20.0]], [[0.0], [float("-inf")]])
    found = decode.gain(own, [own])
    assert np.isfinite(found).all()
    assert np.isneginf((own.logits + found)[0, 1])


def test_of_people_the_marginal_network_is_asked_and_of_planners_not(nets):
    alone, told = (
        Conditional(nets[1], 1.0),
        Conditional(nets[1], 1.0, marginal=Marginal([nets[0]], 1.0)),
    )
    for planner in (False, True):
        before = alone.predict(view(), "av", planner=planner).given(None, 6)[0]
        after = told.predict(view(), "av", planner=planner).given(None, 6)[0]
        assert np.allclose(shares(before), shares(after), atol=1e-6) == planner


def test_with_all_the_weight_and_nothing_given_it_is_nearer_to_the_marginal_network(nets):
    marginal, now = Marginal([nets[0]], 1.0), view()
    row = now.history.row("av")
    ahead = now.history.position_m[row, -1] + np.array([[30.0, 0.0], [60.0, 0.0], [90.0, 0.0]])
    expected = marginal.predict(now, "av").end_density(ahead, 4.0)

    def off(share):
        told = Conditional(nets[1], 1.0, marginal=marginal, share=share)
        return np.abs(told.predict(now, "av").end_density(None, ahead, 4.0) - expected).mean()

    assert off(1.0) < 0.7 * off(0.0)


def test_the_opinion_is_one_for_all_given_futures(nets):
    now = view()
    row = now.history.row("av")
    there = now.history.position_m[row, -1] + np.arange(1, 81)[:, None] * np.array([1.0, 0.0])
    given = Futures(
        agent_id="other", position_m=np.stack([there, there + 50.0]), heading_rad=np.zeros((2, 80))
    )
    told = Conditional(nets[1], 1.0, marginal=Marginal([nets[0]], 1.0))
    both = told.predict(now, "av").given(given, 6)
    second = Futures(
        agent_id="other", position_m=given.position_m[1:], heading_rad=given.heading_rad[1:]
    )
    (alone,) = told.predict(now, "av").given(second, 6)
    assert np.allclose(both[1].probability, alone.probability, atol=1e-5)


def test_features_are_made_once_where_the_marginal_network_sees_no_image(nets, monkeypatch):
    blind = torch_networks.random(replace(SMALL, raster=False), 0).marginal
    made = []
    features = predict.features
    monkeypatch.setattr(
        predict, "features", lambda *given, **more: made.append(given) or features(*given, **more)
    )
    found = Conditional(nets[1], 1.0, marginal=blind).predict(view(), "av")
    assert len(made) == 1
    alone = Conditional(nets[1], 1.0).predict(view(), "av")
    assert not np.array_equal(found.gain, alone.gain), "the marginal network did say something"
