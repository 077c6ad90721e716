"""DiffScene: its guide against differences and scipy, and the adversary with an untrained model."""

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicHermiteSpline

from deepmf_sumo import plugins
from deepmf_sumo.attacks._episodes import scout
from deepmf_sumo.baselines import _diffscene_guidance as guidance
from deepmf_sumo.baselines import diffscene
from deepmf_sumo.baselines.priors import reading
from deepmf_sumo.baselines.priors.diffscene import COMPONENTS
from deepmf_sumo.deepmf.settings import LIMITS
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.planners import replay
from deepmf_sumo.scene import Budget
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.sumo.simulation import simulate as simulate_case

from tests.baselines.priors.test_diffusion_prior import untrained
from tests.support.driven_world import World, driven_limits
from tests.support.rollout_doubles import case_of
from tests.support.simulated_worlds import LANE_M, scene_of, straight_motion, straight_road
from tests.support.simulated_worlds import case_of as recorded_case

TERMS = guidance.GuidanceTerms(
    off_road=4.0, others=40.0, hardness=1.0, accel_mps2=4.0, brake_mps2=7.0, lateral_mps2=4.5
)


@pytest.fixture(autouse=True)
def net(monkeypatch):
    made = untrained()
    monkeypatch.setattr(reading, "diffusion_prior", lambda name: made)
    return made


def attack(world, values=None, budget=None):
    chosen = plugins.settings("adversaries", "diffscene", {"opponent": "b", **(values or {})})
    made = plugins.load("adversaries", "diffscene").build(chosen, "open")
    return made.attack(case_of(), world, budget or Budget(), np.random.default_rng(0))


def guide_of(net, world=None):
    scouted = scout(case_of(), world or World(), lambda view, rng: "b")
    return guidance.Guide(net, scouted, scouted.av, TERMS), scouted


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
    guide, scouted = guide_of(net)
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
    guide, _ = guide_of(net)
    times = torch.arange(1, 81) * 0.1
    brake = torch.stack([12 * times - 4.5 * times.clamp_max(1.33) ** 2, torch.zeros(80)], -1)
    within, hard = guide._beyond_limits(straight(12.0)), guide._beyond_limits(brake[None])
    assert (float(within), float(hard) > 0.05) == (0.0, True)
    circle = 20.0 * torch.stack([(times * 0.6).sin(), 1 - (times * 0.6).cos()], -1)  # 7.2 m/s2
    assert float(guide._beyond_limits(circle[None])) == pytest.approx(7.2 - 4.5, rel=0.2)


def test_the_first_half_second_has_limits_too(net):
    """From 12 m/s, knots at another speed or course at once."""
    guide, _ = guide_of(net)
    ahead = straight(12.0)
    turned_by = torch.tensor([[0.5, 0.866], [-0.866, 0.5]])  # 60 degrees
    for position in (straight(2.0), straight(30.0), ahead @ turned_by):
        assert float(guide._beyond_limits(position)) > 0.5


def test_gradients_agree_with_differences(net):
    guide, _ = guide_of(net)
    generator = torch.Generator().manual_seed(5)
    clean = (0.3 * torch.randn(8, COMPONENTS, generator=generator)).requires_grad_()
    (slope,) = torch.autograd.grad(guide(clean).sum(), clean)
    ahead = torch.randn(8, COMPONENTS, generator=generator)
    with torch.no_grad():
        moved = [guide(clean + step * ahead) for step in (2e-3, -2e-3)]
    # The weights of the soft minimum are held fixed: the gradient is nearly that of the cost.
    measured, told = (moved[0] - moved[1]) / 4e-3, (slope * ahead).sum(-1)
    assert float(torch.corrcoef(torch.stack([measured, told]))[0, 1]) > 0.95


def test_motions_are_placed_in_the_frame_of_the_av(net):
    """The opponent drives up, across the AV's way: local x is the AV's y."""
    guide, _ = guide_of(net, World(opponent=(30.0, -40.0, np.pi / 2, 10.0)))
    place, heading = guide._placed(straight(10.0))
    np.testing.assert_allclose(place[0, :, 0], 30.0, atol=0.05)
    np.testing.assert_allclose(torch.diff(place[0, :, 1]), 2.0, atol=1e-3)
    np.testing.assert_allclose(heading, np.pi / 2, atol=1e-3)


def test_a_vehicle_that_turned_and_stands_keeps_its_heading(net):
    guide, _ = guide_of(net)
    angle = (torch.arange(1, 81) * 0.05).clamp_max(np.pi / 2)
    turn = 10.0 * torch.stack([angle.sin(), 1 - angle.cos()], -1)
    heading = guide._placed(turn[None])[1]
    np.testing.assert_allclose(heading[0, -10:], np.pi / 2, atol=0.1)
    assert guide._placed(straight(0.0))[1].abs().max() == 0


def test_an_av_that_has_left_is_not_fought_for(net):
    """It leaves after 2.5 s; the opponent would be at its place later."""
    there, _ = guide_of(net, World(opponent=(-40.0, 0.0, 0.0, 12.0)))
    gone, _ = guide_of(net, World(opponent=(-40.0, 0.0, 0.0, 12.0), av_steps=36))
    fast = straight(17.0)
    assert float(there.gap(fast)) == 0.0
    assert float(gone.gap(fast)) > 5.0


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A recorded street: `b` beside the AV, and `c` that stands 44 m ahead of it."""
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 10.0),
        "b": straight_motion(66.0, LANE_M, 0.0, 10.0),
        "c": straight_motion(110.0, LANE_M, 0.0, 0.0),
    }
    case = recorded_case(scene_of(straight_road(), motions), tmp_path_factory.mktemp("street"))

    def simulate(policy):
        planner = replay.build(replay.Settings())
        return simulate_case(case, planner, policy, rng=np.random.default_rng(0))

    return scout(case, simulate, lambda view, rng: "b")


@pytest.mark.sumo
def test_the_road_and_others_cost(net, street):
    guide = guidance.Guide(net, street, street.av, TERMS)
    lane = guide.constraints(straight(10.0))[0]
    # 44 m are between the centres: from 3.92 s to 4.88 s they overlap, looked at every 0.4 s.
    np.testing.assert_array_equal(lane > 0, [9 <= step <= 11 for step in range(20)])
    beside = straight(10.0) + torch.tensor([0.0, 30.0])
    apart = guide.constraints(beside + torch.tensor([0.0, 10.0])) - guide.constraints(beside)
    np.testing.assert_allclose(apart, 10.0 * TERMS.off_road, atol=0.05)
    fast = guide.constraints(straight(26.0))[0]
    assert fast[10:].abs().max() == 0  # far ahead, but still on its lane
    cost = guide.costs_until(straight(10.0).double().numpy(), np.array([20]))
    assert (float(cost[0]), float(lane.mean()) > 0) == (0.0, True)  # it hits the AV before


@pytest.mark.sumo
def test_others_on_the_way_are_met_first(net, street):
    start = Start.of(street.view, "b")
    ahead = start.position_m + np.arange(1, 81)[:, None] * [1.0, 0.0]
    tracked = track(np.stack([ahead, ahead - [0.0, LANE_M]]), start, LIMITS.rows(2))
    first = diffscene._first_other(street, tracked)
    way_m = 110.0 - start.position_m[0] - 4.8  # 1 m a step, half a length of each
    assert first[0] == pytest.approx(way_m, abs=2)
    assert first[1] == 81


def test_guided_motions_come_nearer_and_hit(net):
    guide, _ = guide_of(net)
    gaps = []
    for reach in (0.0, 10.0):
        drawn = guide.draw(32, 20, reach, np.random.default_rng(0), np.inf)
        assert drawn.shape == (32, 80, 2)
        gaps.append(guide.gap(torch.from_numpy(drawn).float()))
    assert gaps[1].mean() < 0.5 * gaps[0].mean()
    assert (gaps[1] == 0).sum() > (gaps[0] == 0).sum()


def test_out_of_time_it_stops(net, monkeypatch):
    calls = []
    denoised = net.denoised
    monkeypatch.setattr(net, "denoised", lambda *values: calls.append(1) or denoised(*values))
    found = attack(World(), {"steps": 500, "seconds": 1e-6})
    assert (len(calls), found.out_of_time) == (1, True)
    assert found.simulations == 2


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
    everywhere = np.ones(4, bool)
    assert diffscene._best(gap, everywhere, cost) == 1
    assert diffscene._best(gap, np.array([True, False, True, True]), cost) == 0
    assert diffscene._best(gap, ~everywhere, cost) == 1
    assert diffscene._best(np.array([3.0, 1.0, 2.0]), everywhere[:3], np.zeros(3)) == 1


def test_longer_cases_continue_straight():
    longer = diffscene._as_long(straight(5.0).double().numpy(), 100)
    np.testing.assert_allclose(longer[0, -1], [50.0, 0.0], atol=1e-5)
    assert diffscene._as_long(straight(5.0).numpy(), 30).shape == (1, 30, 2)


def test_without_another_vehicle_nothing_is_attacked():
    assert attack(World(others=False), {"opponent": "argmax"}).rollout.opponent_id is None
