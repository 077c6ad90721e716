"""Several marginal networks as one: a mixture in equal parts."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.networks import decode, predict, torch_networks
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.deepmf.networks.decode import log_softmax
from deepmf_sumo.deepmf.networks.encode import features
from deepmf_sumo.deepmf.networks.predict import Marginal
from deepmf_sumo.scene.geometry.frames import pose_of

from tests.support.synthetic import view

SMALL = replace(LIGHT, name="small", hidden=16, vgg_widths=(4, 4, 4, 4, 4), profiles=7)


@pytest.fixture(scope="module")
def nets():
    """Two networks of other seeds and kernels, with opinions."""
    made = [torch_networks.random(SMALL, seed).marginal.net for seed in (0, 1)]
    for net in made:
        net.score.weight.data *= 20.0
    made[1].widths.data += 0.7
    return made


def goals_of(nets):
    arrays, _ = features(view(), "av", SMALL)
    return [net.goals_of(net.scene_of(arrays)) for net in nets]


def shares_of(goals):
    return np.exp(log_softmax(goals.logits.ravel())).reshape(goals.logits.shape)


def test_members_have_equal_mass_and_one_is_as_it_is(nets):
    members = goals_of(nets)
    assert decode.pooled(members[:1]) is members[0]
    whole = decode.pooled(members)
    paths = members[0].logits.shape[1]
    share = shares_of(whole)
    assert share[:, :paths].sum() == pytest.approx(0.5, abs=1e-5)
    assert np.allclose(share[:, paths:], shares_of(members[1]) / 2, atol=1e-6)
    assert np.array_equal(whole.ends(), np.concatenate([one.ends() for one in members], 1))


def test_modes_are_goals_of_either_member(nets):
    pose, members = pose_of(view(), "av"), goals_of(nets)
    everything = [
        decode.to_scene(pose, *decode.complete(goals, np.arange(goals.logits.size)[None]))[0][0]
        for goals in members
    ]
    modes = Marginal(nets, 1.0).predict(view(), "av").modes(16).futures.position_m
    found = [
        {k for k, one in enumerate(modes) if np.abs(own - one).max((1, 2)).min() < 1e-4}
        for own in everything
    ]
    assert found[0] | found[1] == set(range(16))
    assert found[0] - found[1]
    assert found[1] - found[0]


@pytest.mark.slow_unit
def test_densities_are_those_of_the_mixture_with_each_members_kernels(nets):
    modes = Marginal(nets, 1.0).predict(view(), "av").modes(16).futures.position_m
    both, *alone = (Marginal(each, 1.0) for each in (nets, nets[:1], nets[1:]))
    one, other = (each.predict(view(), "av").log_density(modes) for each in alone)
    expected = np.logaddexp(one, other) - np.log(2)
    assert both.predict(view(), "av").log_density(modes) == pytest.approx(expected, abs=1e-4)
    ends = modes[:, -1]
    one, other = (each.predict(view(), "av").end_density(ends, 2.0) for each in alone)
    expected = np.logaddexp(one, other) - np.log(2)
    assert both.predict(view(), "av").end_density(ends, 2.0) == pytest.approx(expected, abs=1e-4)


def test_the_temperature_is_that_of_all_goals_together(nets):
    """A member that is sure loses share where the mixture is warmed."""
    modes = Marginal(nets, 1.0).predict(view(), "av").modes(16).futures.position_m
    warm = Marginal(nets, 3.0).predict(view(), "av").log_density(modes)
    share, members = [], goals_of(nets)
    for goals in members:
        probability = shares_of(goals).astype(float) / 2
        share.append((probability ** (1 / 3.0)).sum())
    share = [float(one / sum(share)) for one in share]
    assert abs(share[0] - share[1]) > 0.01
    alone = [Marginal([net], 3.0).predict(view(), "av").log_density(modes) for net in nets]
    expected = np.logaddexp(alone[0] + np.log(share[0]), alone[1] + np.log(share[1]))
    assert warm == pytest.approx(expected, abs=1e-3)


def test_a_member_twice_is_that_member(nets):
    modes = Marginal(nets[:1], 1.4).predict(view(), "av").modes(6).futures.position_m
    once, twice = (
        Marginal(each, 1.4).predict(view(), "av").log_density(modes)
        for each in (nets[:1], nets[:1] * 2)
    )
    assert twice == pytest.approx(once, abs=1e-4)


def test_features_are_computed_once_for_all(nets, monkeypatch):
    asked = []

    def counted(seen, agent_id, preset):
        asked.append(agent_id)
        return features(seen, agent_id, preset)

    monkeypatch.setattr(predict, "features", counted)
    both = Marginal(nets, 1.0)
    prediction = both.predict(view(), "av")
    prediction.log_density(prediction.modes(6).futures.position_m)
    assert asked == ["av"]
    assert both.net is nets[0]
