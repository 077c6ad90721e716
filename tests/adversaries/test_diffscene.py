"""DiffScene: its guide against differences and scipy, and the adversary with an untrained model."""

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicHermiteSpline

from deepmf_sumo import plugins
from deepmf_sumo.adversaries import _diffscene_guidance as guidance
from deepmf_sumo.adversaries import diffscene
from deepmf_sumo.adversaries._episodes import motion_of, scout
from deepmf_sumo.datatypes import Budget
from deepmf_sumo.geometry import boxes
from deepmf_sumo.predictors import torch_networks
from deepmf_sumo.predictors.motion_priors.diffscene import COMPONENTS

from tests.predictors.test_diffusion_prior import untrained
from tests.support.driven_world import World, driven_limits
from tests.support.rollout_doubles import case_of

TERMS = guidance.Terms(
    off_road=4.0, others=40.0, hardness=1.0, accel_mps2=4.0, brake_mps2=7.0, lateral_mps2=4.5
)


@pytest.fixture(autouse=True)
def net(monkeypatch):
    made = untrained()
    monkeypatch.setattr(torch_networks, "diffusion_prior", lambda name: made)
    return made


def attack(world, values=None, budget=None):
    chosen = plugins.settings("adversaries", "diffscene", {"opponent": "b", **(values or {})})
    made = plugins.load("adversaries", "diffscene").build(chosen, "open")
    return made.attack(case_of(), world, budget or Budget(), np.random.default_rng(0))


def costs_of(net, world=None):
    scouted = scout(case_of(), world or World(), lambda view, rng: "b")
    situation = guidance.situation_of(scouted, ["b"])
    return guidance._Costs(net, situation, "b", situation.to_path(scouted.av), TERMS), scouted


def straight(speed, count=1):
    ahead = torch.arange(1, 81) * 0.1 * speed
    return torch.stack([ahead, torch.zeros(80)], -1).expand(count, 80, 2)


def test_motions_are_joined_as_by_scipy():
    generator = np.random.default_rng(4)
    knots = np.cumsum(generator.normal([3.0, 0.0], 1.0, (1, 16, 2)), 1)
    made = guidance.joined(torch.from_numpy(knots), torch.tensor(7.0, dtype=torch.float64))
    points = np.concatenate([np.zeros((1, 2)), knots[0]])
    slope = np.diff(points, axis=0) / 0.5
    tangent = np.concatenate([[[7.0, 0.0]], (slope[:-1] + slope[1:]) / 2, slope[-1:]])
    spline = CubicHermiteSpline(np.arange(17) * 0.5, points, tangent)
    np.testing.assert_allclose(made[0], spline(np.arange(1, 81) * 0.1), atol=1e-5)


def test_the_gap_is_that_to_the_avs_rollout(net):
    """The AV drives beside it, 3.5 m to the right and 8 m ahead, 2 m/s slower: it passes."""
    guide, scouted = costs_of(net)
    gap = float(guide.gap(straight(12.0)))
    own = scouted.rollout.tracks
    av, b = own.row("av"), own.row("b")
    after = slice(31, 91)
    box = boxes.gap(
        own.position_m[b, after],
        own.heading_rad[b, after],
        own.size_m[b, :2],
        own.position_m[av, after],
        own.heading_rad[av, after],
        own.size_m[av, :2],
    ).min()
    # Discs stick out at the sides by a tenth of half a width each; and the desired overlap.
    assert gap == pytest.approx(float(box) - 0.2 + 0.4, abs=0.3)
    assert float(guide.gap(straight(40.0))) > 10.0


def test_limits_cost_where_they_are_broken(net):
    guide, _ = costs_of(net)
    times = torch.arange(1, 81) * 0.1
    brake = torch.stack([12 * times - 4.5 * times.clamp_max(1.33) ** 2, torch.zeros(80)], -1)
    within, hard = guide._beyond_limits(straight(12.0)), guide._beyond_limits(brake[None])
    assert (float(within), float(hard) > 0.05) == (0.0, True)
    circle = 20.0 * torch.stack([(times * 0.6).sin(), 1 - (times * 0.6).cos()], -1)  # 7.2 m/s2
    assert float(guide._beyond_limits(circle[None])) == pytest.approx(7.2 - 4.5, rel=0.2)


def test_gradients_agree_with_differences(net):
    guide, _ = costs_of(net)
    generator = torch.Generator().manual_seed(5)
    clean = (0.3 * torch.randn(4, COMPONENTS, generator=generator)).requires_grad_()
    (slope,) = torch.autograd.grad(guide(clean).sum(), clean)
    ahead = torch.randn(4, COMPONENTS, generator=generator)
    with torch.no_grad():
        moved = [guide(clean + step * ahead) for step in (2e-3, -2e-3)]
    # The weights of the soft minimum are held fixed, so that the gradient is that of a bound.
    measured = (moved[0] - moved[1]) / 4e-3
    agreeing = torch.sign((slope * ahead).sum(-1)) == torch.sign(measured)
    assert agreeing.sum() >= 3


def test_guided_motions_come_nearer_and_hit(net):
    scouted = scout(case_of(), World(), lambda view, rng: "b")
    gaps = []
    for reach in (0.0, 1.0):
        rng = np.random.default_rng(0)
        drawn = guidance.draw(net, scouted, scouted.av, TERMS, 32, 20, reach, rng)
        assert drawn.position_m.shape == (32, 80, 2)
        guide, _ = costs_of(net)
        gaps.append(guide.gap(torch.from_numpy(drawn.position_m).float()))
    assert gaps[1].mean() < 0.7 * gaps[0].mean()
    assert (gaps[1] == 0).sum() > (gaps[0] == 0).sum()


def test_it_hits_and_keeps_the_limits():
    found = attack(World())
    assert found.rollout.first("av_opponent")
    assert found.simulations == 2
    accel, brake, lateral = driven_limits(found.rollout)
    assert (accel <= 4.0 + 0.1, brake <= 7.0 + 0.1, lateral <= 4.5 + 0.5) == (True, True, True)
    again = attack(World())
    np.testing.assert_array_equal(
        found.rollout.plans[-1].position_m, again.rollout.plans[-1].position_m
    )


def test_a_miss_is_aimed_again():
    """The AV is elsewhere in the second episode, and there again in the third."""
    found = attack(World(av_y_m=(0.0, -14.0, -14.0)), {"rounds": 3, "samples": 8})
    assert len(found.trials) >= 2
    assert {"sample", "hits", "cost_m", "predicted_gap_m"} == set(found.trials[0].values)


def test_the_cheapest_of_those_that_hit_attacks():
    gap, cost = np.array([0.0, -0.1, 2.0, 0.5]), np.array([5.0, 3.0, 0.0, 1.0])
    assert diffscene._best(gap, cost) == 1
    assert diffscene._best(gap + 1.0, cost) == 1
    assert diffscene._best(np.array([3.0, 1.0, 2.0]), np.zeros(3)) == 1


def test_longer_cases_continue_straight():
    longer = diffscene._as_long(straight(5.0).double().numpy(), 100)
    np.testing.assert_allclose(longer[0, -1], [50.0, 0.0], atol=1e-5)
    assert diffscene._as_long(straight(5.0).numpy(), 30).shape == (1, 30, 2)


def test_without_another_vehicle_nothing_is_attacked():
    assert attack(World(others=False), {"opponent": "argmax"}).rollout.opponent_id is None


def test_the_guide_knows_the_av_at_its_own_times(net):
    guide, scouted = costs_of(net)
    motion = motion_of(scouted.rollout, "b", 80)
    assert motion.valid.all()
    assert float(guide.speed) == pytest.approx(12.0, abs=0.1)
