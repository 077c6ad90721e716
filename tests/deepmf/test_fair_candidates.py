"""Which candidates a competent driver could avoid, from what the AV is predicted to do."""

import numpy as np

from deepmf_sumo.datatypes import Forecast, Futures
from deepmf_sumo.deepmf import constraints
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Limits

from tests.support.predictor_doubles import STEPS, view_of


def straight(agent_id, x, y, speeds):
    """A future along x; ``speeds`` (80)."""
    position = np.stack([x + np.cumsum(speeds) * 0.1, np.full(80, float(y))], -1)
    return Futures(
        agent_id=agent_id, position_m=position[None], heading_rad=np.zeros((1, len(speeds)))
    )


def forecast(futures):
    return Forecast(futures=futures, probability=np.ones(1))


def fair(view, futures, av):
    limits = Limits(accel=3.0, brake=4.0, lateral=3.0)
    return constraints.fair_candidates(Situation.of(view, "b", limits), futures, av)


def test_a_driver_can_avoid_a_leader_that_slows_down_but_not_one_that_stops_dead():
    view = view_of({"av": (0, 0, 0, 15.0), "b": (30, 0, 0, 15.0)})
    av = forecast(straight("av", 0, 0, np.full(80, 15.0)))
    slow = straight("b", 30, 0, np.maximum(15.0 - 3.0 * STEPS, 0.0))
    near = view_of({"av": (0, 0, 0, 15.0), "b": (7, 0, 0, 15.0)})
    dead = straight("b", 7, 0, np.maximum(15.0 - 9.0 * STEPS, 0.0))
    assert fair(view, slow, av)[0]
    assert not fair(near, dead, av)[0]


def test_a_follower_that_an_av_meets_because_it_brakes_is_not_avoidable():
    view = view_of({"av": (0, 0, 0, 12.0), "b": (-12, 0, 0, 12.0)})
    behind = straight("b", -12, 0, np.full(80, 12.0))
    keeps = forecast(straight("av", 0, 0, np.full(80, 12.0)))
    brakes = forecast(straight("av", 0, 0, np.maximum(12.0 - 3.0 * STEPS, 0.0)))
    assert fair(view, behind, keeps)[0]
    assert not fair(view, behind, brakes)[0]
