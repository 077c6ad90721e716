"""How fast bends are taken."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.scene import Lane, RoadMap
from deepmf_sumo.training.recording import many


def limited(centre_m, *, interpolating, limit=15.0):
    """The limit that a lane is left with."""
    limits = {"lane": limit}
    api = SimpleNamespace(
        lane=SimpleNamespace(getMaxSpeed=limits.__getitem__, setMaxSpeed=limits.__setitem__)
    )
    lane = Lane(
        id="lane",
        kind="street",
        centre_m=centre_m,
        z_m=np.zeros(len(centre_m)),
        interpolating=interpolating,
    )
    many.slow_down(api, RoadMap(lanes={"lane": lane}))
    return limits["lane"]


def arc(radius_m, turn_rad):
    angle = np.linspace(0.0, turn_rad, 30)
    return radius_m * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)


@pytest.mark.parametrize("radius_m", [6.0, 15.0, 40.0])
def test_a_turn_costs_the_comfortable_acceleration(radius_m):
    speed = limited(arc(radius_m, np.pi / 2), interpolating=True)
    assert speed**2 / radius_m == pytest.approx(many.COMFORTABLE_MPS2, rel=0.1)


def test_a_lower_limit_stays():
    assert limited(arc(40.0, np.pi / 2), interpolating=True, limit=5.0) == 5.0


def test_straight_lanes_and_sidesteps_inside_junctions_are_taken_at_the_limit():
    assert limited(np.array([[0.0, 0.0], [80.0, 0.0]]), interpolating=False) == 15.0
    assert limited(np.array([[0.0, 0.0], [0.5, 0.0]]), interpolating=True) == 15.0
    share = np.linspace(0, 1, 9)
    sidestep = np.stack([8 * share, 3.2 * (3 * share**2 - 2 * share**3)], axis=1)
    assert limited(sidestep, interpolating=True) == 15.0


def test_a_bend_of_a_street_is_slower_than_its_straights():
    bend = np.concatenate([[[-60.0, 0.0]], arc(25.0, 1.0)])
    assert 6.0 < limited(bend, interpolating=False) < 10.5
