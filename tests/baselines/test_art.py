"""ART: bounded perturbations of the opponent's history and of its future."""

import itertools
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepmf_sumo import plugins
from deepmf_sumo.attacks import _episodes as episodes
from deepmf_sumo.baselines import _art_descent as art_descent
from deepmf_sumo.baselines import _art_history as art_history
from deepmf_sumo.baselines._art_descent import PerturbationBounds
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT, changed
from deepmf_sumo.deepmf.networks.densetnt import as_batch
from deepmf_sumo.deepmf.networks.encode import features
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import Budget

from tests.support.driven_world import NOW, World, driven_limits
from tests.support.predictor_doubles import view_of
from tests.support.rollout_doubles import case_of

BOUNDS = PerturbationBounds(reach_m=1.0, speed_mps=30.0, accel_mps2=4.0, jerk_mps3=20.0)
SMALL = changed(LIGHT, "small", {"raster": False, "hidden": 16, "profiles": 7, "dropout": 0.0})
FOREVER = np.inf


@pytest.fixture(scope="module")
def predictors():
    return distinct(torch_networks.random(SMALL, seed=3))


def distinct(made):
    """Goals of an untrained network are all alike: make them differ."""
    made.marginal.net.score.weight.data *= 30.0
    return made


@pytest.fixture
def loaded(monkeypatch, predictors):
    monkeypatch.setattr(weights, "cached_predictors", lambda *_: predictors)


def attack(world, values=None, budget=None, seed=0):
    values = {"opponent": "b", "restarts": 3, "iterations": 40, **(values or {})}
    made = plugins.load("adversaries", "art").build(
        plugins.settings("adversaries", "art", values), "open"
    )
    return made.attack(case_of(), world, budget or Budget(), np.random.default_rng(seed))


def turning_view():
    """The opponent b turns and brakes; it stands obliquely, so that frames matter."""
    view = view_of({"av": (0.0, 0.0, 0.3, 9.0), "b": (-14.0, 6.0, -0.4, 8.0)})
    tracks = view.history
    back = (np.arange(11) - 10) * 0.1
    heading = -0.4 + 0.3 * back
    speed = 8.0 - 1.5 * back
    step = 0.1 * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    position, velocity = tracks.position_m.copy(), tracks.velocity_mps.copy()
    position[1] = position[1, -1] + np.cumsum(step, axis=0) - np.cumsum(step, axis=0)[-1]
    velocity[1] = 10 * step
    headings = tracks.heading_rad.copy()
    headings[1] = heading
    return replace(
        view,
        history=replace(tracks, position_m=position, velocity_mps=velocity, heading_rad=headings),
    )


@pytest.mark.slow_unit
def test_without_a_limit_in_seconds_the_clock_ends_nothing(monkeypatch):
    """However slow the machine: a day between two looks at the clock."""
    clock = itertools.count(0.0, 86400.0)
    slow = SimpleNamespace(perf_counter=lambda: next(clock))
    for module in (art_descent, episodes):
        monkeypatch.setattr(module, "time", slow)
    calm = attack(World())
    assert not calm.out_of_time
    monkeypatch.undo()
    same = attack(World())
    assert calm.trials == same.trials
    limited = attack(World(), {"seconds": 1e-9})
    assert limited.out_of_time
    assert limited.trials[0].values["iterations"] == 1


class TestDescent:
    time = np.arange(60) * 0.1
    base = np.stack([5000.0 + 10.0 * time, -3000.0 + 0.0 * time], -1)
    basis = np.concatenate([np.zeros((10, 10)), art_descent._integrals(50, 10)])

    def descend(self, loss, bounds, **more):
        given = {"iterations": 100, "deadline": FOREVER, "begin": np.zeros((2, 10, 2)), **more}
        begin = given["begin"]
        effort = art_descent.Effort(len(begin), given["iterations"], given["deadline"])
        return art_descent.descend(loss, self.base, self.basis, begin, bounds, effort)

    @pytest.mark.slow_unit
    @pytest.mark.parametrize(
        "bounds",
        [
            PerturbationBounds(reach_m=2.0, speed_mps=30.0, accel_mps2=4.0, jerk_mps3=20.0),
            PerturbationBounds(reach_m=50.0, speed_mps=11.0, accel_mps2=4.0, jerk_mps3=20.0),
            PerturbationBounds(reach_m=50.0, speed_mps=30.0, accel_mps2=1.0, jerk_mps3=20.0),
            PerturbationBounds(reach_m=50.0, speed_mps=30.0, accel_mps2=4.0, jerk_mps3=0.5),
        ],
        ids=["reach", "speed", "acceleration", "jerk"],
    )
    def test_bounds_hold_whatever_pulls(self, bounds):
        found = self.descend(lambda offset: -10.0 * offset[:, -1].sum(-1), bounds)
        path = self.base + found.offset_m
        span = [path]
        for _ in range(3):
            span.append((span[-1][:, 2:] - span[-1][:, :-2]) / 0.2)
        speed, accel, jerk = (np.hypot(*np.moveaxis(each, -1, 0)).max() for each in span[1:])
        moved = np.hypot(*np.moveaxis(found.offset_m, -1, 0)).max()
        slack = 1 + 1e-4
        assert moved <= bounds.reach_m * slack
        assert speed <= bounds.speed_mps * slack
        assert accel <= bounds.accel_mps2 * slack
        assert jerk <= bounds.jerk_mps3 * slack + 1e-3
        assert moved > 0.3

    def test_what_exceeds_the_bounds_by_itself_may_stay(self):
        noisy = self.base.copy()
        noisy[30] += 0.2
        bounds = BOUNDS.widened(noisy)
        assert bounds.accel_mps2 == pytest.approx(2 * 0.2 * np.sqrt(2) / 0.04)
        assert bounds.allow(noisy, np.zeros_like(noisy))
        assert not BOUNDS.allow(noisy, np.zeros_like(noisy))

    def test_it_finds_a_minimum_within_the_bounds(self):
        wanted = torch.tensor([1.5, -1.0])
        bounds = PerturbationBounds(reach_m=10.0, speed_mps=30.0, accel_mps2=4.0, jerk_mps3=20.0)
        found = self.descend(lambda offset: (offset[:, -1] - wanted).square().sum(-1), bounds)
        np.testing.assert_allclose(found.offset_m[:, -1], [[1.5, -1.0]] * 2, atol=0.05)

    def test_it_ends_without_gain_and_in_time(self):
        flat = self.descend(lambda offset: 0.0 * offset.sum((1, 2)), BOUNDS)
        assert flat.iterations == 21
        late = self.descend(lambda o: o[:, -1].sum(-1), BOUNDS, deadline=time.perf_counter())
        assert late.iterations == 1

    def test_the_best_is_kept_not_the_last(self):
        # A loss that rises after the tenth evaluation.
        calls = []

        def loss(offset):
            calls.append(offset.detach().clone())
            sign = -1.0 if len(calls) <= 10 else 1.0
            return sign * offset[:, -1].sum(-1) + (0.0 if len(calls) <= 10 else 100.0)

        wide = PerturbationBounds(reach_m=99.0, speed_mps=99.0, accel_mps2=99.0, jerk_mps3=99.0)
        found = self.descend(loss, wide)
        assert found.iterations == 30
        np.testing.assert_allclose(found.offset_m, calls[9].numpy(), atol=1e-5)


class TestHistory:
    def test_the_spline_goes_through_its_points_and_ends_smoothly(self):
        knots = np.array([0.4, -0.7])
        move = art_history._spline() @ knots
        np.testing.assert_allclose(move[[0, 5, 10]], [-0.7, 0.4, 0.0], atol=1e-12)
        assert abs(move[9]) < 0.06  # slope 0 now
        assert np.abs(np.diff(move, n=3)).max() < 0.1

    @pytest.mark.parametrize("missing", [0, 4])
    def test_features_in_torch_are_those_of_the_perturbed_view(self, predictors, missing):
        view = turning_view()
        valid = view.history.valid.copy()
        valid[1, :missing] = False
        view = replace(view, history=replace(view.history, valid=valid))
        past = art_history.PerturbedPast(view, "b", predictors.marginal.net)
        offset = past.basis @ np.array([[0.3, -0.2], [0.6, 0.5]])
        batch = past.batch(torch.from_numpy(offset.astype(np.float32))[None])
        expected = as_batch(features(past.view(offset), "b", SMALL)[0])
        assert set(batch) == set(expected)
        for name, values in expected.items():
            np.testing.assert_allclose(batch[name].numpy(), values.numpy(), atol=2e-4, err_msg=name)
        unmoved = as_batch(features(view, "b", SMALL)[0])
        assert not np.allclose(unmoved["motion"], expected["motion"], atol=1e-2)

    def test_the_present_stays(self, predictors):
        view = turning_view()
        past = art_history.PerturbedPast(view, "b", predictors.marginal.net)
        moved = past.view(past.basis @ np.array([[0.3, -0.2], [0.6, 0.5]])).history
        for name in ("position_m", "velocity_mps", "heading_rad"):
            before, after = getattr(view.history, name), getattr(moved, name)
            np.testing.assert_array_equal(before[1, -1], after[1, -1])
            np.testing.assert_array_equal(before[0], after[0])
            assert np.abs(before[1, :-1] - after[1, :-1]).max() > 0.01

    @pytest.mark.slow_unit
    def test_the_gradient_is_that_of_finite_differences(self, predictors, monkeypatch):
        doubled = as_batch
        monkeypatch.setattr(
            art_history, "as_batch",
            lambda arrays: {name: each.double() for name, each in doubled(arrays).items()},
        )  # fmt: skip
        view = turning_view()
        net = distinct(torch_networks.random(SMALL, seed=3)).marginal.net.double()
        past = art_history.PerturbedPast(view, "b", net)
        av = np.stack([0.9 * np.arange(1, 81), np.zeros(80)], -1)
        meeting = art_history.GoalMeeting(view, "b", av, np.ones(80, dtype=bool))
        basis = torch.from_numpy(past.basis)

        def loss(points):
            return meeting.loss(net(past.batch(torch.einsum("wn,rnc->rwc", basis, points))))[0]

        points = torch.tensor([[[0.21, -0.13], [0.37, 0.29]]], dtype=torch.float64)
        points.requires_grad_()
        (gradient,) = torch.autograd.grad(loss(points), points)
        assert gradient.abs().max() > 1e-4
        small = 1e-5
        for place in np.ndindex(1, 2, 2):
            ahead, back = points.detach().clone(), points.detach().clone()
            ahead[place] += small
            back[place] -= small
            slope = float((loss(ahead) - loss(back)).detach()) / (2 * small)
            assert float(gradient[place]) == pytest.approx(slope, rel=1e-3, abs=1e-6)

    def test_goals_near_the_av_become_likelier(self, predictors):
        view, net = turning_view(), predictors.marginal.net
        av = np.stack([0.9 * np.arange(1, 81), np.zeros(80)], -1)
        there = np.ones(80, dtype=bool)
        meeting = art_history.GoalMeeting(view, "b", av, there)
        past = art_history.PerturbedPast(view, "b", net)
        effort = art_descent.Effort(2, 8, FOREVER)
        found = art_history.perturb(net, past, meeting, BOUNDS, effort, np.random.default_rng(0))
        offsets = np.concatenate([np.zeros((1, 11, 2)), found.offset_m])
        with torch.no_grad():
            loss = meeting.loss(net(past.batch(torch.from_numpy(offsets.astype(np.float32)))))
        assert loss[1:].max() < loss[0]
        assert np.hypot(*np.moveaxis(found.offset_m, -1, 0)).max() <= 1.0 + 1e-5
        assert all(each.grad is None for each in net.parameters())

    def test_a_history_of_one_step_cannot_be_perturbed(self, predictors):
        view = turning_view()
        valid = view.history.valid.copy()
        valid[1, :-1] = False
        view = replace(view, history=replace(view.history, valid=valid))
        net = predictors.marginal.net
        meeting = art_history.GoalMeeting(view, "b", np.zeros((80, 2)), np.ones(80, dtype=bool))
        past = art_history.PerturbedPast(view, "b", net)
        effort = art_descent.Effort(2, 5, FOREVER)
        found = art_history.perturb(net, past, meeting, BOUNDS, effort, np.random.default_rng(0))
        assert np.array_equal(found.offset_m, np.zeros((2, 11, 2)))

    def test_it_drives_what_is_predicted(self, loaded):
        found = attack(World(), {"form": "history", "iterations": 5, "modes": 3})
        assert found.simulations == 2
        plan = found.rollout.plans[0]
        assert plan.position_m.shape == (80, 2)
        assert np.isfinite(plan.position_m).all()


class TestFuture:
    def test_it_hits_an_av_that_does_not_react(self):
        found = attack(World(), {"reach_m": 8.0})
        assert found.rollout.first("av_opponent") is not None
        (trial,) = found.trials
        assert trial.values["predicted_gap_m"] == 0.0
        assert 0.0 < trial.values["mean_move_m"] < 8.0
        accel, brake, lateral = driven_limits(found.rollout)
        assert accel <= 3.0 + 1e-6
        assert brake <= 4.0 + 1e-6
        assert lateral <= 3.0 * 1.05

    def test_a_bound_of_a_metre_does_not_reach_an_av_that_is_far(self):
        found = attack(World(av_y_m=(-30.0,)), {"reach_m": 1.0})
        assert found.rollout.first("av_opponent") is None
        free = np.stack([-8.0 + 1.2 * np.arange(1, 81), np.full(80, 3.5)], -1)
        moved = np.hypot(*(found.rollout.plans[0].position_m - free).T)
        assert moved.max() < 1.1

    def test_the_same_seed_finds_the_same_plan(self):
        first, second = (attack(World(), {"iterations": 20}, seed=7) for _ in range(2))
        one, other = first.rollout.plans[0], second.rollout.plans[0]
        np.testing.assert_array_equal(one.position_m, other.position_m)
        assert first.trials == second.trials

    def test_seconds_end_it(self):
        found = attack(World(), budget=Budget(seconds=0.0))
        assert found.trials[0].values["iterations"] == 1.0
        assert found.simulations == 2

    def test_its_own_seconds_end_the_rounds_too(self):
        world = World(av_y_m=(0.0, -60.0, 60.0, -60.0, 60.0))
        found = attack(world, {"seconds": 1e-6}, Budget(simulations=5))
        assert found.simulations == 2

    @pytest.mark.slow_unit
    def test_a_standing_opponent(self):
        found = attack(World(opponent=(20.0, 3.5, 0.0, 0.0)))
        assert np.isfinite(found.rollout.plans[0].position_m).all()

    @pytest.mark.parametrize("steps", [NOW + 2, NOW + 30])
    def test_one_that_vanishes_goes_on(self, steps):
        found = attack(World(av_steps=steps))
        plan = found.rollout.plans[0]
        assert len(plan.position_m) == 80
        assert np.isfinite(plan.position_m).all()
        assert plan.speed_mps.min() > 5.0

    def test_gradients_of_standing_boxes_are_finite(self):
        position = np.zeros((80, 2))
        target = art_descent.ArtTarget(
            position_m=position, heading_rad=np.zeros(80), there=np.arange(80) < 0,
            av_size_m=np.array([4.8, 2.0]), own_size_m=np.array([4.8, 2.0]),
        )  # fmt: skip
        start = Start(
            position_m=np.zeros(2), heading_rad=0.0, course_rad=0.0, speed_mps=0.0, length_m=4.8
        )
        found = art_descent.bend(
            position,
            start,
            target,
            BOUNDS,
            art_descent.Effort(2, 5, FOREVER),
            np.random.default_rng(0),
        )
        assert np.isfinite(found.offset_m).all()


@pytest.mark.sumo
def test_making_them_does_not_load_torch():
    program = """
import sys
from deepmf_sumo import plugins
for name in ("art", "cat", "rule"):
    plugins.load("adversaries", name).build(plugins.settings("adversaries", name, {}), "open")
assert "torch" not in sys.modules
"""
    done = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
