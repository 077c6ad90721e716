"""One episode without an attack, on recordings and on SUMO networks; whom searches attack."""

import numpy as np
import pytest

from deepmf_sumo.attacks._episodes import OpponentChoice, scout
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.errors import RunError
from deepmf_sumo.planners import idm, replay
from deepmf_sumo.scene import FUTURE_STEPS
from deepmf_sumo.sumo.simulation import network_case
from deepmf_sumo.sumo.simulation import simulate as simulate_case

from tests.support import tiny_network
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, rollout_of, straight
from tests.support.simulated_worlds import LANE_M, scene_of, straight_motion, straight_road
from tests.support.simulated_worlds import case_of as recorded_case_of

NOW = 10


def simulating(case, planner):
    def simulate(policy):
        return simulate_case(case, planner, policy, rng=np.random.default_rng(0))

    return simulate


@pytest.mark.sumo
def test_a_recording_is_scouted(tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 12.0),
        "b": straight_motion(50.0, LANE_M, 0.0, 9.0),
    }
    case = recorded_case_of(scene_of(straight_road(), motions), tmp_path)
    found = scout(case, simulating(case, replay.build(replay.Settings())), lambda view, rng: "b")
    assert (found.opponent_id, found.rollout.opponent_id) == ("b", None)
    assert found.view.step == NOW
    assert found.view.history.ids == ("av", "b")
    np.testing.assert_allclose(found.reference.position_m, motions["b"][NOW + 1 :, :2])
    np.testing.assert_allclose(found.reference.speed_mps, 9.0)
    assert found.reference.valid.all()
    assert np.abs(found.av.position_m - motions["av"][NOW + 1 :, :2]).max() < 0.01


@pytest.mark.sumo
def test_a_sumo_network_is_scouted(tmp_path):
    case = network_case(tiny_network.build(tmp_path), 2.0, "av", 30)
    found = scout(case, simulating(case, idm.build(idm.Settings())), lambda view, rng: "leader")
    tracks = found.rollout.tracks
    assert found.reference.position_m.shape == (30, 2)
    np.testing.assert_array_equal(
        found.reference.position_m, tracks.position_m[tracks.row("leader"), NOW + 1 :]
    )
    assert np.diff(found.reference.position_m[:, 0]).min() > 0.1
    assert found.av.valid.all()


@pytest.mark.sumo
def test_contact_with_the_opponent_does_not_end_the_scouting(tmp_path):
    motions = {
        "av": straight_motion(60.0, 0.0, 0.0, 12.0),
        "b": straight_motion(80.0, 0.0, 0.0, 2.0),
    }
    case = recorded_case_of(scene_of(straight_road(), motions), tmp_path)
    found = scout(case, simulating(case, replay.build(replay.Settings())), lambda view, rng: "b")
    assert found.rollout.first("av_other") is not None
    assert found.reference.valid.sum() == FUTURE_STEPS


def test_after_the_end_of_the_rollout_nothing_is_valid():
    paths = {"av": straight(0, 0, 10, steps=40), "b": straight(-8, 3.5, 12, steps=40)}

    def simulate(policy):
        policy.reset(view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)}), None)
        return rollout_of(paths, opponent_id=None)

    found = scout(case_of(), simulate, lambda view, rng: "b")
    assert found.reference.position_m.shape == (80, 2)
    assert found.reference.valid.tolist() == [True] * 29 + [False] * 51


def test_nobody_to_attack():
    def simulate(policy):
        assert policy.reset(view_of({"av": (0, 0, 0, 10.0)}), None) == ()
        return rollout_of({"av": straight(0, 0, 10)}, opponent_id=None)

    assert scout(case_of(), simulate, lambda view, rng: None) is None


class TestChoice:
    view = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0), "c": (30, 0, 0, 8.0)})

    @pytest.fixture
    def loads(self, monkeypatch):
        names = []

        def load(name):
            names.append(name)
            return Doubles()

        monkeypatch.setattr(weights, "cached_predictors", load)
        return names

    def test_scores_come_from_the_weights_which_are_loaded_once(self, loads):
        choice = OpponentChoice("argmax", "mine")
        assert loads == []
        for _ in range(2):
            chosen = choice.of(case_of())(self.view, np.random.default_rng(0))
            scores = Doubles().opponent.score(self.view)
            assert chosen == scores.ids[int(np.argmax(scores.logits))]
        assert loads == ["mine"]

    def test_who_is_named_needs_no_weights(self, loads):
        rng = np.random.default_rng(0)
        assert OpponentChoice("c", "mine").of(case_of())(self.view, rng) == "c"
        labelled = OpponentChoice("labelled", "mine").of(case_of(partner_id="b"))
        assert labelled(self.view, rng) == "b"
        assert loads == []

    def test_who_is_not_there_is_refused(self, loads):
        with pytest.raises(RunError, match="opponent 'z' is not a vehicle"):
            OpponentChoice("z", "mine").of(case_of())(self.view, None)
        with pytest.raises(RunError, match="names no partner"):
            OpponentChoice("labelled", "mine").of(case_of())(self.view, None)
