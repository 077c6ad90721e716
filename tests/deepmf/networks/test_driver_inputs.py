"""Who drives, since when, and how a follower would: inputs that reach the conditional network."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import torch_networks
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.deepmf.networks.encode import features
from deepmf_sumo.scene import Futures

from tests.support.synthetic import view

SMALL = replace(LIGHT, name="small", hidden=16, raster=False, profiles=7)
MODES = 16


def conditional(reactive):
    """A network with opinions, that is told of following or not."""
    made = torch_networks.random(replace(SMALL, reactive=reactive), 0).conditional
    for layer in (made.net.score, made.net.motion):
        for value in layer.parameters():
            value.data *= 20.0
    return made


def crossing_partner():
    """The partner's future: it stops in the AV's way."""
    along = np.minimum(np.arange(1, 81) * 0.9, 45.0)
    return Futures(
        agent_id="south",
        position_m=np.stack([np.zeros(80), along - 45.0], -1)[None],
        heading_rad=np.full((1, 80), np.pi / 2),
    )


def answer(net, recorded, *, planner=True):
    seen = replace(view(), av_recorded_steps=recorded)
    return net.predict(seen, "av", planner=planner).given(crossing_partner(), MODES)[0]


@pytest.mark.parametrize(
    ("planner", "recorded", "expected"),
    [(False, 4, 0.0), (True, 0, 1.0), (True, 4, 1.4), (True, 10, 2.0)],
)
def test_who_drives_and_since_when(planner, recorded, expected):
    seen = replace(view(), av_recorded_steps=recorded)
    motion = features(seen, "av", SMALL, planner=planner)[0]["motion"]
    assert motion[6] == pytest.approx(expected)


def test_a_network_that_is_not_told_takes_no_notice_of_when_a_planner_took_over():
    net = conditional(reactive=False)
    late, early = answer(net, 10), answer(net, 0)
    assert np.array_equal(late.probability, early.probability)
    person = answer(net, 0, planner=False)
    assert not np.array_equal(person.probability, early.probability)


def test_a_network_that_is_told_does():
    net = conditional(reactive=True)
    assert not np.array_equal(answer(net, 10).probability, answer(net, 0).probability)


def test_where_a_follower_would_be_reaches_the_goals():
    net = conditional(reactive=True)
    before = answer(net, 0)
    with torch.no_grad():
        net.net.goal_follow.weight.zero_()
    assert not np.array_equal(answer(net, 0).probability, before.probability)
