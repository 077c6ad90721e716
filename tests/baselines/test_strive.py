"""STRIVE: its stages on a scene made by hand, and the adversary with an untrained prior."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepmf_sumo.attacks import _episodes as episodes
from deepmf_sumo.attacks._episodes import scout
from deepmf_sumo.baselines import _strive, strive
from deepmf_sumo.baselines._scene_graph import Path, situation_of
from deepmf_sumo.baselines._strive import Costs, LatentSearch, plan_of
from deepmf_sumo.baselines.priors import reading
from deepmf_sumo.baselines.priors.strive import MotionPrior
from deepmf_sumo.deepmf.networks import weights as weights_module
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.planners import replay
from deepmf_sumo.scene import Budget
from deepmf_sumo.sumo.simulation import simulate as simulate_case

from tests.support.predictor_doubles import Doubles
from tests.support.simulated_worlds import LANE_M, case_of, scene_of, straight_motion, straight_road

pytestmark = pytest.mark.sumo

WEIGHTS = Costs(others=40.0, road=4.0, prior=0.02, init=0.01)


class Simulation:
    """Counts episodes."""

    def __init__(self, case):
        self.case, self.policies = case, []

    def __call__(self, policy):
        self.policies.append(policy)
        planner = replay.build(replay.Settings())
        return simulate_case(self.case, planner, policy, rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(1)
    made = MotionPrior(LIGHT)
    made.control.weight.data *= 10.0  # as if it had learned that latents matter
    return made.eval()


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """The opponent beside the AV and a little ahead; one far behind."""
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 10.0),
        "b": straight_motion(66.0, LANE_M, 0.0, 10.0),
        "c": straight_motion(20.0, 0.0, 0.0, 10.0),
    }
    return case_of(scene_of(straight_road(), motions), tmp_path_factory.mktemp("strive"))


@pytest.fixture(scope="module")
def scouted(case):
    return scout(case, Simulation(case), lambda view, rng: "b")


@pytest.fixture(autouse=True)
def _no_weights(monkeypatch, net):
    monkeypatch.setattr(reading, "motion_prior", lambda name: net)
    monkeypatch.setattr(weights_module, "cached_predictors", lambda name: Doubles())


def search_of(net, scouted, seconds=60.0):
    import time

    situation = situation_of(scouted, ("b",))
    return situation, LatentSearch(net, situation, ["b"], WEIGHTS, time.perf_counter() + seconds)


def test_the_situation_is_in_the_frame_of_the_av(net, scouted):
    situation = situation_of(scouted, ("b",))
    assert situation.ids == ("av", "b", "c")
    np.testing.assert_allclose(situation.paths[1].position[0], [7.0, LANE_M], atol=0.02)
    assert situation.paths[1].there.all()
    assert (situation.road[:, 0].min(), situation.road[:, 0].max()) == pytest.approx(
        (-60, 250), abs=2
    )
    assert situation.allowed.shape == (3, 1)


def test_plans_are_in_the_scenes_frame_and_as_long_as_the_case(net, scouted):
    situation, search = search_of(net, scouted)
    found = search.attack(situation.paths[0], 0)
    plan = plan_of(situation, found.motions, "b", 100)
    assert plan.position_m.shape == (100, 2)
    np.testing.assert_allclose(plan.position_m[0], [67.0, LANE_M], atol=0.1)
    speed = np.hypot(*np.diff(plan.position_m, axis=0).T) / 0.1
    np.testing.assert_allclose(speed, plan.speed_mps[1:], atol=0.3)
    assert plan_of(situation, found.motions, "b", 30).position_m.shape == (30, 2)


def test_matching_brings_motions_to_the_paths(net, scouted):
    _, search = search_of(net, scouted)
    before = search.match(0)
    assert search.match(6) < before


def test_the_attack_brings_the_opponent_nearer(net, scouted):
    situation, search = search_of(net, scouted)
    before = search.attack(situation.paths[0], 0).gap_m
    after = search.attack(situation.paths[0], 10)
    assert after.gap_m < before
    assert after.closest == "b"
    assert 1 <= after.iterations <= 10


def test_the_gap_of_now_is_not_what_is_fought_for(net, scouted):
    _, search = search_of(net, scouted)
    gaps = torch.linspace(1.0, 9.0, 80)[None].requires_grad_()  # cars that part
    (gradient,) = torch.autograd.grad(search._adversarial(gaps), gaps)
    assert gradient[0, :20].abs().max() == 0
    assert int(gradient.argmax()) == 20


def test_the_attack_ends_where_the_discs_meet(net, scouted):
    situation, search = search_of(net, scouted)
    onto = Path(situation.paths[1].position, situation.paths[1].heading, situation.paths[1].there)
    found = search.attack(onto, 10)
    assert (found.iterations, found.gap_m < 0) == (0, True)


def test_no_iteration_is_begun_after_the_deadline(net, scouted):
    situation, search = search_of(net, scouted, seconds=-1.0)
    search.match(10)
    assert search.attack(situation.paths[0], 10).iterations == 0


def test_the_av_is_saved_where_nobody_comes_and_not_from_one_upon_it(net, scouted):
    situation, search = search_of(net, scouted)
    search.match(5)
    weights = Costs(others=40.0, road=4.0, prior=0.005, init=0.0)
    away = situation.paths[1]._replace(position=situation.paths[1].position + 300.0)
    assert search.save({"b": away}, 2, weights)
    wall = torch.zeros(80, 2)
    wall[:, 0] = 7.0  # stands right ahead of an AV at 10 m/s
    assert not search.save({"b": Path(wall, torch.zeros(80), away.there)}, 2, weights)


def test_out_of_time_it_is_not_said_that_nothing_saves_the_av(net, scouted):
    situation, search = search_of(net, scouted, seconds=-1.0)
    wall = situation.paths[1]._replace(position=torch.tensor([7.0, 0.0]).expand(80, 2))
    assert search.save({"b": wall}, 2, Costs(40.0, 4.0, 0.005, 0.0)) is None


def test_the_adversary_spends_what_it_may_and_says_so(case):
    simulate = Simulation(case)
    settings = strive.Settings(opponent="b", match_iterations=2, iterations=4, rounds=2,
                               solution_iterations=1)  # fmt: skip
    found = strive.build(settings, "open").attack(
        case, simulate, Budget(), np.random.default_rng(0)
    )
    assert found.rollout.opponent_id == "b"
    assert found.simulations == len(simulate.policies) <= 3
    assert found.trials[-1].values["solvable"] in {0.0, 1.0}
    assert found.trials[0].values["match_error_m"] >= 0
    assert found.generation_s > 0


@pytest.mark.parametrize("seconds", [None, 1e-6])
def test_seconds_end_it_only_where_they_are_set_and_then_it_says_so(case, monkeypatch, seconds):
    clock = itertools.count(0.0, 86400.0)
    slow = SimpleNamespace(perf_counter=lambda: next(clock))
    for module in (strive, _strive, episodes):
        monkeypatch.setattr(module, "time", slow)
    settings = strive.Settings(opponent="b", match_iterations=2, iterations=4, rounds=2,
                               solution_iterations=1, seconds=seconds)  # fmt: skip
    found = strive.build(settings, "open").attack(
        case, Simulation(case), Budget(), np.random.default_rng(0)
    )
    assert found.out_of_time == (seconds is not None)
    assert (found.simulations == 2) == (seconds is not None)


def test_simulations_of_the_budget_stand_above_the_rounds(case):
    simulate = Simulation(case)
    settings = strive.Settings(opponent="b", match_iterations=0, iterations=1, rounds=5,
                               solution_iterations=0)  # fmt: skip
    strive.build(settings, "open").attack(
        case, simulate, Budget(simulations=2), np.random.default_rng(0)
    )
    assert len(simulate.policies) == 2


def test_any_vehicle_attacks_that_is_not_behind_all_the_time(case):
    settings = strive.Settings(opponent="any", match_iterations=0, iterations=1, rounds=1,
                               solution_iterations=0)  # fmt: skip
    found = strive.build(settings, "open").attack(
        case, Simulation(case), Budget(), np.random.default_rng(0)
    )
    assert found.rollout.opponent_id == "b"


def test_without_a_vehicle_ahead_the_nearest_attacks(tmp_path):
    behind = {
        name: straight_motion(x, 0.0, 0.0, 10.0) for name, x in (("av", 60), ("c", 20), ("d", 40))
    }
    scene = case_of(scene_of(straight_road(), behind), tmp_path)
    settings = strive.Settings(opponent="any", match_iterations=0, iterations=1, rounds=1,
                               solution_iterations=0)  # fmt: skip
    found = strive.build(settings, "open").attack(
        scene, Simulation(scene), Budget(), np.random.default_rng(0)
    )
    assert found.rollout.opponent_id == "d"


def test_nobody_to_attack(tmp_path):
    alone = case_of(
        scene_of(straight_road(), {"av": straight_motion(60.0, 0.0, 0.0, 10.0)}), tmp_path
    )
    found = strive.build(strive.Settings(opponent="any"), "open").attack(
        alone, Simulation(alone), Budget(), np.random.default_rng(0)
    )
    assert (found.rollout.opponent_id, found.trials) == (None, ())


def test_a_set_without_the_prior_is_refused(monkeypatch, case, tmp_path):
    monkeypatch.undo()
    with pytest.raises(WeightsError, match="deepmf-sumo train strive"):
        strive.build(strive.Settings(opponent="b"), str(tmp_path)).attack(
            case, Simulation(case), Budget(), np.random.default_rng(0)
        )
