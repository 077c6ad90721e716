"""The constraint `telling`: no touches, and no hits of an AV that stands."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import Forecast, Futures
from deepmf_sumo.deepmf.candidates import Candidates, av_moves, pairs
from deepmf_sumo.deepmf.constraints import Telling
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Limits

from tests.support.predictor_doubles import Doubles, view_of


def reason_of(av_mps, opponent_mps=12.0):
    agents = {"av": (0, 0, 0, av_mps), "b": (-8, 3.5, 0, opponent_mps)}
    settings = plugins.settings("policies", "deepmf", {"opponent": "b", "constraints": ["telling"]})
    policy, view = build(settings, Doubles()), view_of(agents)
    policy.reset(view, np.random.default_rng(0))
    return policy.plan(view).reason


@pytest.mark.parametrize(("av_mps", "allowed"), [(0.0, False), (1.3, False), (1.5, True)])
def test_an_av_that_stands_or_creeps_is_not_attacked(av_mps, allowed):
    """The candidate crosses its way at 10 m/s; the AV is predicted to keep its speed."""
    view = view_of({"av": (0, 0, 0, av_mps), "b": (2, -20, np.pi / 2, 10.0)})
    situation = Situation.of(view, "b", Limits(accel=3.5, brake=5.0, lateral=3.5))
    after = 0.1 * np.arange(1, 81)
    own = np.stack([np.full(80, 2.0), -20 + 10.0 * after], -1)
    av = Futures(
        agent_id="av",
        position_m=np.stack([av_mps * after, np.zeros(80)], -1)[None],
        heading_rad=np.zeros((1, 80)),
    )
    candidates = Candidates(
        forecast=Forecast(
            futures=Futures(agent_id="b", position_m=own[None], heading_rad=np.full((1, 80), 1.57)),
            probability=np.ones(1),
        ),
        origin=("mode",),
        speed_mps=np.full((1, 80), 10.0),
        bent_m=np.zeros(1),
    )
    reactions = [Forecast(futures=av, probability=np.ones(1))]
    found = pairs(situation, candidates, reactions)
    assert found.collides.all()
    made = Telling(plugins.settings("policies", "deepmf", {}))
    assert made.allowed(situation, candidates, reactions, found).tolist() == [[allowed]]


def test_a_touch_does_not_count():
    """Both boxes are equal, so the AV gets half of the difference of the velocities."""
    reason = reason_of(10.0, 10.0)
    futures = reason.candidates.futures
    for row, mode in zip(*np.nonzero(reason.collides), strict=True):
        step = max(int(reason.collision_step[row, mode]), 1)
        av = reason.reactions[row].futures.position_m[mode]
        own = futures.position_m[row]
        apart = (av[step] - own[step]) - (av[step - 1] - own[step - 1])
        assert reason.allowed["telling"][row, mode] == (np.hypot(*apart) * 10 / 2 >= 5 / 3.6)
    told = reason.allowed["telling"][reason.collides]
    assert told.any()
    assert not told.all()
    # the hit that was chosen is no touch, though others of that candidate may be
    assert reason.allowed["telling"][reason.chosen].any()


@pytest.mark.parametrize(
    ("speed", "step", "expected"),
    [(0.0, 30, 0.0), (1.0, 30, 1.0), (10.0, 30, 10.0), (10.0, 80, 0.0), (0.0, 5, 3.0)],
)
def test_how_fast_the_av_was_in_the_last_second(speed, step, expected):
    """At constant speed; soon after now its speed now, 3 m/s, counts too; no contact at step 80."""
    view = view_of({"av": (0, 0, 0, 3.0), "b": (20, 0, 0, 5.0)})
    situation = Situation.of(view, "b", Limits(accel=3.5, brake=5.0, lateral=3.5))
    position = np.zeros((1, 80, 2))
    position[0, :, 0] = 0.1 * speed * np.arange(1, 81)
    futures = Futures(agent_id="av", position_m=position, heading_rad=np.zeros((1, 80)))
    reaction = Forecast(futures=futures, probability=np.ones(1))
    found = av_moves(situation, [reaction], np.array([[float(step)]]))
    assert found[0, 0] == pytest.approx(expected)
