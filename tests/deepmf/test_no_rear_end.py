"""Which pairs are rams from behind, and what `no_rear_end` does to a plan."""

import numpy as np
import pytest
from pydantic import ValidationError

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.candidates import collisions, rear_ends
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.scene import Forecast, Futures

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of

CAR_M = np.array([4.8, 2.0])
BEHIND = {"av": (0, 0, 0, 10.0), "near": (-9, 0.0, 0, 14.0), "far": (60, -40, np.pi / 2, 9.0)}
BESIDE = {"av": (0, 0, 0, 10.0), "near": (-3, 3.5, 0, 12.0), "far": (60, -40, np.pi / 2, 9.0)}


def straight(x, y, heading, speed, steps=30):
    way = np.arange(1, steps + 1)[:, None] * 0.1 * speed
    position = np.array([x, y]) + way * [np.cos(heading), np.sin(heading)]
    return Futures(
        agent_id="b", position_m=position[None], heading_rad=np.full((1, steps), heading)
    )


@pytest.mark.parametrize(
    ("opponent", "expected"),
    [
        ((-12, 0.5, 0.0, 15.0), True),  # the follower
        ((12, 0.5, 0.0, 2.0), False),  # a leader that is too slow
        ((20, -20, np.pi / 2, 10.0), False),  # from the side
        ((-1, 2.6, -0.15, 10.5), False),  # a neighbour that comes over
        ((-9, -4.0, 0.35, 16.0), True),  # from the next lane into the rear end
        ((40, 0.0, np.pi, 10.0), False),  # oncoming
        ((-6.3, -11.5, 0.9, 20.0), False),  # out of a side street, into the rear end askew
    ],
)
def test_a_ram_is_an_impact_on_the_rear_end_in_the_same_direction(opponent, expected):
    """And nothing changes if all is turned."""
    for turn in (0.0, 2.4):
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, heading, speed = opponent
        own = straight(cos * x - sin * y, sin * x + cos * y, heading + turn, speed)
        av = [Forecast(futures=straight(0, 0, turn, 10.0), probability=np.ones(1))]
        collides, step = collisions(own, av, CAR_M, CAR_M, 30)
        assert collides.all()
        assert rear_ends(own, av, CAR_M, CAR_M, step).tolist() == [[expected]]


def test_pairs_without_a_contact_are_no_rams():
    own, av = straight(-12, 0, 0.0, 9.0), straight(0, 0, 0.0, 10.0)
    step = np.full((1, 1), 30.0)
    alone = [Forecast(futures=av, probability=np.ones(1))]
    assert not rear_ends(own, alone, CAR_M, CAR_M, step).any()


def plan(agents, **values):
    made = build(plugins.settings("adversaries", "deepmf", values), Doubles())
    view = view_of(agents)
    made.reset(view, np.random.default_rng(0))
    return plan_of(made, view).reason


def test_a_follower_does_not_ram_and_others_still_attack():
    rams = plan(BEHIND, opponent="near")
    assert rams.collides[rams.chosen].any()
    kept = plan(BEHIND, opponent="near", constraints=["no_rear_end"])
    allowed = kept.allowed["no_rear_end"]
    assert not allowed.all()
    assert kept.unmet == ("no_rear_end",) or allowed[kept.chosen]
    if kept.unmet:
        mass = kept.collision_mass
        assert kept.rule == "nothing no_rear_end"
        assert mass[kept.chosen] == pytest.approx(mass.min())
    beside = plan(BESIDE, opponent="near", constraints=["no_rear_end"])
    assert beside.collides[beside.chosen].any()
    assert beside.allowed["no_rear_end"][beside.chosen]


def test_it_contradicts_a_wish_for_the_rear_and_the_published_form():
    for values in ({"sector": "rear"}, {"form": "paper"}):
        with pytest.raises(ValidationError, match="contradict"):
            Settings(constraints=["no_rear_end"], **values)
