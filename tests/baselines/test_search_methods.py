"""BRS, BGA and BBO: budgets, determinism, learning, scenes without anybody to attack."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import _episodes as episodes
from deepmf_sumo.baselines import bbo, bga, brs
from deepmf_sumo.errors import PluginError
from deepmf_sumo.planners import idm
from deepmf_sumo.scene import Budget
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support import tiny_network
from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import view_of
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

METHODS = ("brs", "bga", "bbo")
VIEW = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)})


class World:
    """The AV goes straight on; the opponent drives what is planned."""

    def __init__(self, view=VIEW, contact_below_m=0.0):
        self.view = view
        self.contact_below_m = contact_below_m
        self.plans = []
        self.episodes = 0

    def __call__(self, policy):
        self.episodes += 1
        chosen = policy.reset(self.view, np.random.default_rng(0)) if policy else ()
        paths = {"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)}
        if not chosen:
            return rollout_of(paths, opponent_id=None)
        plan = plan_of(policy, self.view)
        self.plans.append(plan)
        paths["b"][11:] = np.column_stack([plan.position_m, plan.heading_rad])
        away = np.hypot(*(paths["b"][11:, :2] - paths["av"][11:, :2]).T).min()
        hit = [contact_of(step=40)] if away < self.contact_below_m else []
        return rollout_of(paths, contacts=hit)


def attack(name, values=None, budget=None, world=None, seed=0):
    world = world or World()
    settings = plugins.settings("adversaries", name, {"opponent": "b", **(values or {})})
    adversary = plugins.load("adversaries", name).build(settings, "open")
    found = adversary.attack(case_of(), world, budget or Budget(), np.random.default_rng(seed))
    return found, world


@pytest.mark.parametrize(("name", "simulations"), [("brs", 4), ("bga", 100), ("bbo", 100)])
def test_default_budgets(name, simulations):
    assert plugins.settings("adversaries", name, {}).simulations == simulations


@pytest.mark.parametrize("name", METHODS)
def test_the_budget_is_kept_and_told(name):
    found, world = attack(name, budget=Budget(simulations=7))
    assert (found.simulations, world.episodes, len(found.trials)) == (7, 7, 6)
    assert found.generation_s > 0
    assert set(found.trials[0].values) == {
        f"{control}_{knot}" for control in ("accel", "steer") for knot in range(5)
    }


@pytest.mark.parametrize("name", METHODS)
def test_seconds_end_a_search(name):
    found, world = attack(name, budget=Budget(seconds=0.05))
    assert found.generation_s < 2.0
    assert found.simulations == world.episodes >= 2
    found, _ = attack(name, budget=Budget(seconds=0.0))
    assert found.simulations == 2  # the unattacked episode, and one attack that is better than none


@pytest.mark.parametrize("name", METHODS)
def test_the_best_trial_is_returned(name):
    values = {"drawn": 3} if name == "bbo" else {}
    found, world = attack(name, values, budget=Budget(simulations=6))
    best = int(np.argmax([trial.objective for trial in found.trials]))
    np.testing.assert_array_equal(
        found.rollout.tracks.position_m[1, 11:], world.plans[best].position_m
    )


@pytest.mark.parametrize("name", METHODS)
def test_a_hit_is_better_than_any_miss(name):
    # Leaving out the distance, every hit costs more than the best miss.
    dear_hits = {"cost": {"late": -50.0}}
    found, world = attack(name, dear_hits, Budget(simulations=40), World(contact_below_m=2.5))
    costs = [-trial.objective for trial in found.trials]
    assert found.rollout.first("av_opponent") is not None
    chosen = found.rollout.tracks.position_m[1, 11:]
    row = next(
        row for row, plan in enumerate(world.plans) if np.array_equal(plan.position_m, chosen)
    )
    assert costs[row] > min(costs)


@pytest.mark.parametrize(("simulations", "counted"), [(4, 4), (2, 1)])
@pytest.mark.parametrize("name", METHODS)
def test_the_time_holds_every_episode_that_something_depends_on(
    name, simulations, counted, monkeypatch
):
    world = World()
    clock = SimpleNamespace(perf_counter=lambda: world.episodes)
    monkeypatch.setattr(episodes, "time", clock)
    found, _ = attack(name, budget=Budget(simulations=simulations), world=world)
    # The only attack of two simulations is what it is, however it ends.
    assert found.generation_s == counted


@pytest.mark.parametrize("name", METHODS)
def test_a_search_says_whether_seconds_ended_it(name, monkeypatch):
    world = World()
    monkeypatch.setattr(episodes, "time", SimpleNamespace(perf_counter=lambda: world.episodes))
    found, _ = attack(name, budget=Budget(simulations=4, seconds=3.0), world=world)
    assert (found.out_of_time, found.simulations) == (True, 3)
    found, _ = attack(name, budget=Budget(simulations=4, seconds=100.0))
    assert (found.out_of_time, found.simulations) == (False, 4)


@pytest.mark.parametrize(("name", "simulations"), [("brs", 14), ("bga", 40), ("bbo", 6)])
def test_same_seed_same_attack(name, simulations):
    values = {"drawn": 3} if name == "bbo" else {}
    first, again, other = (
        attack(name, values, budget=Budget(simulations=simulations), seed=seed)[0]
        for seed in (3, 3, 4)
    )
    assert first.trials == again.trials
    assert first.trials != other.trials
    assert first.rollout.tracks.position_m.tobytes() == again.rollout.tracks.position_m.tobytes()


@pytest.mark.parametrize("name", METHODS)
def test_a_contact_ends_the_search_only_if_asked(name):
    values = {"stop_at_contact": True}
    found, _ = attack(name, values, Budget(simulations=6), World(contact_below_m=1e9))
    assert found.simulations == 2
    found, _ = attack(name, {}, Budget(simulations=6), World(contact_below_m=1e9))
    assert found.simulations == 6


@pytest.mark.parametrize("name", METHODS)
def test_nobody_to_attack(name, monkeypatch):
    from deepmf_sumo.deepmf.networks import weights

    from tests.support.predictor_doubles import Doubles

    monkeypatch.setattr(weights, "cached_predictors", lambda name: Doubles())
    world = World(view_of({"av": (0, 0, 0, 10.0)}))
    found, _ = attack(name, {"opponent": "argmax"}, world=world)
    assert found.rollout.opponent_id is None
    assert found.trials == ()
    assert found.simulations == world.episodes == 2


@pytest.mark.parametrize("opponent", [(30, 3.5, 0, 0.0), (-8, 3.5, 0, 12.0)])
def test_who_stands_and_who_moves_is_brought_to_the_av(opponent):
    view = view_of({"av": (0, 0, 0, 10.0), "b": opponent})
    found, _ = attack("bga", budget=Budget(simulations=100), world=World(view))
    nearest = max(trial.objective for trial in found.trials)
    assert nearest > -0.5  # boxes less than half a metre apart


class TestOptimisers:
    def quadratic(self, points):
        return ((points - 0.3) ** 2).sum(-1)

    def minimum(self, optimiser, evaluations):
        best, done = np.inf, 0
        while done < evaluations:
            points = optimiser.ask()
            assert np.abs(points).max() <= 1.0
            costs = self.quadratic(points)
            optimiser.tell(costs)
            best, done = min(best, costs.min()), done + len(points)
        return best

    def test_genetic_search_converges(self):
        rng = np.random.default_rng(0)
        drawn = self.minimum(brs.RandomSearch(6, rng), 200)
        assert self.minimum(bga.GeneticSearch(bga.Settings(), 6, rng), 200) < drawn / 3

    def test_bayesian_search_converges(self):
        rng = np.random.default_rng(0)
        assert self.minimum(bbo.BayesianSearch(bbo.Settings(drawn=6), 2, rng), 12) < 0.02

    @pytest.mark.slow_unit
    def test_optuna_does_it_too(self):
        rng = np.random.default_rng(0)
        assert self.minimum(bbo.OptunaSearch(6, 2, rng), 12) < 0.02

    def test_bayesian_search_learns_more_of_a_trial_than_the_others(self):
        rng = np.random.default_rng(0)
        bred = self.minimum(bga.GeneticSearch(bga.Settings(), 10, rng), 60)
        assert self.minimum(bbo.BayesianSearch(bbo.Settings(), 10, rng), 60) < bred / 3

    def test_of_many_points_the_best_and_the_latest_are_remembered(self):
        search = bbo.BayesianSearch(bbo.Settings(), 2, np.random.default_rng(0))
        search._points = np.random.default_rng(1).uniform(-1, 1, (500, 2))
        search._costs = np.abs(search._points).sum(-1)
        rows = search._remembered()
        assert len(rows) == 300
        assert set(range(400, 500)) <= set(rows.tolist())
        assert int(search._costs.argmin()) in rows
        asked = search.ask()
        assert np.abs(asked).max() < 0.2

    def test_costs_that_are_all_the_same_teach_nothing_and_break_nothing(self):
        search = bbo.BayesianSearch(bbo.Settings(drawn=2), 3, np.random.default_rng(0))
        for _ in range(6):
            assert np.isfinite(search.ask()).all()
            search.tell(np.array([100.0]))

    def test_the_elite_lives_on(self):
        search = bga.GeneticSearch(bga.Settings(population=4, elite=2), 2, np.random.default_rng(0))
        assert len(search.ask()) == 4
        search.tell(np.array([3.0, 1.0, 2.0, 4.0]))
        assert len(search.ask()) == 2
        assert search._costs.tolist() == [1.0, 2.0]


def test_without_the_extra_it_is_said_how_to_install_it(monkeypatch):
    monkeypatch.setattr(bbo, "find_spec", lambda name: None if name == "optuna" else sys)
    with pytest.raises(PluginError, match=r"needs optuna.*pip install \"deepmf-sumo\[search\]\""):
        bbo.build(bbo.Settings(optimiser="optuna"), "open")
    assert bbo.build(bbo.Settings(), "open")


@pytest.mark.parametrize("name", METHODS)
def test_settings_are_checked(name):
    with pytest.raises(PluginError, match="simulations"):
        plugins.settings("adversaries", name, {"simulations": 1})
    with pytest.raises(PluginError, match="jrk"):
        plugins.settings("adversaries", name, {"cost": {"jrk": 1.0}})


@pytest.mark.sumo
def test_checking_settings_loads_nothing_heavy():
    program = f"""
import sys
from deepmf_sumo import plugins
for name in {METHODS}:
    plugins.settings("adversaries", name, {{}})
assert not {{"torch", "optuna", "scipy", "libsumo"}} & set(sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.sumo
def test_traffic_of_a_sumo_network_is_attacked(tmp_path):
    case = network_case(tiny_network.build(tmp_path), 2.0, "av", 30)
    planner = idm.build(idm.Settings())

    def episode(policy):
        return simulate(case, planner, policy, rng=np.random.default_rng(0))

    adversary = brs.build(brs.Settings(opponent="leader"), "open")
    found = adversary.attack(case, episode, Budget(simulations=3), np.random.default_rng(0))
    assert (found.simulations, found.rollout.opponent_id) == (3, "leader")
    (plan,) = found.rollout.plans
    assert plan.position_m.shape == (30, 2)
    tracks = found.rollout.tracks
    row, now = tracks.row("leader"), found.rollout.now
    joined = tracks.position_m[row, now + 1] - tracks.position_m[row, now]
    assert np.hypot(*(joined - 0.1 * tracks.velocity_mps[row, now])) < 0.1
