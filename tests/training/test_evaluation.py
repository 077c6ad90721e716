"""`evaluate` as a whole, with predictors whose answers are known."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from deepmf_sumo.cli.evaluate import command
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import OutputError, ReaderError
from deepmf_sumo.scene import Forecast, Futures, OpponentScores, Source, readers
from deepmf_sumo.scene.readers.base import Refusal
from deepmf_sumo.training import cards, evaluation
from deepmf_sumo.training.evaluation.measures import error_if_right
from deepmf_sumo.training.networks import clusters
from deepmf_sumo.training.samples import windows

from tests.support.synthetic import scene

SCENES = [scene(shift=3.0 * number, av_speed=8.0 + number) for number in range(3)]


def truth(view, agent_id):
    """What an agent does: all agents of these scenes keep their velocity."""
    row = view.history.row(agent_id)
    times = np.arange(1, 81)[:, None] * 0.1
    start, velocity = view.history.position_m[row, -1], view.history.velocity_mps[row, -1]
    return start + times * velocity


def forecast(view, agent_id, modes, off_m, temperature):
    """Modes side by side, 10 m apart; the best one is off by ``off_m`` at all times."""
    way = truth(view, agent_id) + np.array([off_m, 0.0])
    row = view.history.row(agent_id)
    positions = np.stack([way + np.array([0.0, 10.0 * mode]) for mode in range(modes)])
    heading = np.full(positions.shape[:2], view.history.heading_rad[row, -1])
    share = np.arange(modes, 0, -1.0) ** (1 / temperature)
    return Forecast(
        futures=Futures(agent_id=agent_id, position_m=positions, heading_rad=heading),
        probability=share / share.sum(),
        temperature=temperature,
    )


def density(off_m):
    return np.array([-(off_m**2) / 8])


@dataclass
class Opponent:
    temperature = 2.0
    offset = 0.0

    def score(self, view, *, everyone=False):
        return OpponentScores(
            ids=("south",), logits=np.array([1.0]), partner_logits=np.array([2.0])
        )


@dataclass
class Marginal:
    """Its own prediction: ``view`` and ``agent_id`` are those that it was made for."""

    temperature: float = 2.0
    view: object = None
    agent_id: str = ""
    off_m = 2.0

    def predict(self, view, agent_id):
        return replace(self, view=view, agent_id=agent_id)

    def modes(self, count, *, chosen_at=79):
        off_m = self.off_m * (1 + chosen_at) / 80  # nearer horizons are predicted better
        return forecast(self.view, self.agent_id, count, off_m, self.temperature)

    def end_density(self, ends_m, kernel_m):
        return density(self.off_m)


@dataclass
class Conditional:
    """Right given the truth; off by how far the given end is from the truth; 3 m given nothing.

    For nearer horizons the probabilities have temperature 1.
    """

    temperature: float = 2.0
    view: object = None
    agent_id: str = ""

    def predict(self, view, agent_id, *, planner=False):
        return replace(self, view=view, agent_id=agent_id)

    def given(self, futures, modes, *, chosen_at=None):
        count = 1 if futures is None else len(futures.position_m)
        temperature = self.temperature if chosen_at in (None, 79) else 1.0
        return [
            forecast(self.view, self.agent_id, modes, self._off(futures, row), temperature)
            for row in range(count)
        ]

    def end_density(self, futures, ends_m, kernel_m):
        return density(self._off(futures, 0))

    def _off(self, given, row):
        if given is None:
            return 3.0
        apart = given.position_m[row, -1] - truth(self.view, given.agent_id)[-1]
        return float(np.hypot(*apart))


@pytest.fixture
def predictors(monkeypatch):
    made = weights.Predictors(
        name="double", folder=None, opponent=Opponent(), marginal=Marginal(),
        conditional=Conditional(),
    )  # fmt: skip
    monkeypatch.setattr(weights, "load", lambda _: made)
    return made


@pytest.fixture
def given(monkeypatch):
    """Puts scenes and refusals in the place of recordings."""
    return lambda *scenes: monkeypatch.setattr(readers, "scenes", lambda _: iter(scenes))


def evaluate(report=lambda _: None, **options):
    return evaluation.evaluate([Path("here")], "double", report, **options)


class Of:
    """The values of one network; by default at 8 s, of the network itself."""

    def __init__(self, found, network, condition="network"):
        self.found, self.network, self.condition = found, network, condition

    def figure(self, quantity, modes=None, condition=None, seconds=8.0, group="all"):
        return self.found.of(
            self.network, quantity, seconds, modes, condition or self.condition, group
        )

    def __call__(self, *key, **more):
        return self.figure(*key, **more).value

    def by_modes(self, quantity, condition=None, seconds=8.0):
        table = self.found.pivot(self.network, quantity, condition or self.condition)
        return {modes: figures[seconds].value for modes, figures in table.items()}


def test_the_conditions_that_are_compared(predictors, given):
    given(*SCENES)
    found = evaluate()
    of = Of(found, "conditional", "given_true")
    fde = of.figure("min_fde", 6)
    assert found.of("conditional", "targets").value == fde.objects == 6
    assert of.by_modes("min_fde", "marginal") == {6: 2.0, 16: 2.0, 32: 2.0}
    assert of("min_fde", 6, "given_nothing") == 3.0
    assert fde.value == pytest.approx(0.0, abs=1e-6)
    assert of("min_fde_gain", 6) == pytest.approx(2.0)
    gain = of.figure("log_likelihood_gain")
    assert gain.value == pytest.approx(0.5)  # 2**2 / 8
    assert gain.standard_error == pytest.approx(0.0, abs=1e-6)
    assert of("log_likelihood_gain_over_nothing") == pytest.approx(1.125)  # 3**2 / 8
    assert of("log_likelihood_gain", None, "given_nothing") == pytest.approx(0.5 - 1.125)
    for role in ("av", "partner"):
        assert of.figure("min_fde", 6, group=role).objects == 3
        assert of("log_likelihood_gain", group=role) == pytest.approx(0.5)
    assert of("log_likelihood_gain", seconds=3.0) > 0.5


def test_what_is_said_given_the_truth_is_judged_as_any_forecast(predictors, given):
    given(*SCENES)
    found = evaluate()
    informed, alone = Of(found, "conditional", "given_true"), Of(found, "marginal")
    assert informed("min_ade", 6) == pytest.approx(0.0, abs=1e-3)
    assert alone("min_ade", 6) > 0.5
    assert informed.by_modes("miss_rate") == {6: 0.0, 16: 0.0, 32: 0.0}
    assert informed("negative_log_likelihood") == pytest.approx(0.0, abs=1e-6)
    assert informed("ece") == alone("ece"), "the modes of both doubles have the same chances"
    assert informed("ece_if_right_95") == alone("ece_if_right_95")
    assert informed("ece_of_horizon") == informed("ece"), "modes for 8 s serve at 8 s"
    early = {name: informed(name, seconds=3.0) for name in ("ece", "ece_of_horizon")}
    assert early["ece_of_horizon"] == informed("ece_uncalibrated", seconds=3.0) != early["ece"]
    for share in ("on_road", "overlap_free"):
        assert informed(share, None, "recorded") == alone(share, None, "recorded") is not None
        assert informed.by_modes(share).keys() == {6, 16, 32}
        assert 0.0 < informed(share, 6) < 1.0, "some modes leave the lane, or meet a vehicle"


def test_the_shuffled_future_is_another_scene_s_partner_in_the_same_role(predictors, given):
    given(*SCENES)
    of = Of(evaluate(), "conditional", "given_shuffled")
    # South drives at 9 m/s in all scenes, so that the AV is given the truth even when shuffled. Its
    # own speed is 8, 9, 10 m/s: the partner is given a motion that ends 16, 8, 8 m from the truth.
    assert of("min_fde", 6, group="av") == pytest.approx(0.0, abs=1e-6)
    assert of("min_fde", 6, group="partner") == pytest.approx((16 + 8 + 8) / 3, abs=0.01)
    assert of("log_likelihood_gain", group="partner") < 0


def test_a_single_scene_cannot_be_shuffled(predictors, given):
    given(SCENES[0])
    of = Of(evaluate(), "conditional", "given_true")
    assert of("min_fde", 6) == pytest.approx(0.0, abs=1e-6)
    assert of("min_fde", 6, "given_shuffled") is None
    assert of("log_likelihood_gain", None, "given_shuffled") is None
    assert of("log_likelihood_gain") == pytest.approx(0.5)


def test_marginal_figures_and_calibration_before_and_after(predictors, given):
    given(*SCENES)
    found = evaluate()
    of = Of(found, "marginal")
    assert of.figure("min_fde", 6).objects == 6
    assert of("most_probable_fde", 1) == 2.0
    # The likeliest mode is always the nearest. At temperature 1 the six have 6/21 ... 1/21: two of
    # them in each of the bins from 0.2, 0.1, 0 on.
    assert of("ece_uncalibrated") == pytest.approx((1 - 11 / 21 + 7 / 21 + 3 / 21) / 6, abs=1e-4)
    assert of("ece") > of("ece_uncalibrated")
    assert of("negative_log_likelihood") == -of("log_likelihood") == pytest.approx(0.5)
    assert of("min_fde", 1, "constant_velocity") == pytest.approx(0.0, abs=1e-6)
    assert of("min_fde", 1, "lane_following") < 0.5
    assert "clusters" not in {key.condition for key in found.figures}
    assert "not fitted" in found.clusters
    assert of("on_road", None, "recorded") == 1.0
    assert 0.1 < of("on_road", 6) < 0.9  # one of six modes is on the lane, some cross another
    assert of.by_modes("min_fde", seconds=1.0) == {6: 2.0, 16: 2.0, 32: 2.0}
    assert of.by_modes("min_fde_of_horizon", seconds=1.0) == {6: 0.25, 16: 0.25, 32: 0.25}
    # Modes for 8 s serve at 8 s; so few draws are far from their probability even if it is right.
    assert of("ece_of_horizon") == of("ece")
    assert 0.05 < of("ece_if_right") < of("ece_if_right_95") < 1.0
    assert of("min_fde_of_horizon", 6) == 2.0


def test_opponent_figures_among_all_and_among_scored(predictors, given):
    given(*SCENES)
    found = evaluate()

    def of(quantity, condition="label_head", group="all"):
        return found.of("opponent", quantity, condition=condition, group=group).value

    def count(quantity, group="all"):
        return of(quantity, "network", group)

    assert (count("candidates"), count("parked")) == (6, 3)  # south and the parked one
    assert (count("positives"), count("positives_parked")) == (3, 0)
    assert of("auroc") == of("average_precision") == 1.0
    assert of("top1_positive_scenes") == of("partner_top1_scenes", "partner_head") == 3
    assert count("candidates", "attackable") == 3
    assert of("auroc", group="attackable") is None  # there are only positives
    assert of("partner_top1", "nearest") == 0.0
    assert of("partner_top1", "nearest_moving") == 1.0
    sigmoid = 1 / (1 + np.exp(-1.0))
    right = {name: of(name, group="attackable") for name in ("ece_if_right", "ece_if_right_95")}
    assert of("ece", group="attackable") == pytest.approx(1 - sigmoid, abs=1e-4)
    uncalibrated = of("ece_uncalibrated", group="attackable")
    assert uncalibrated == pytest.approx(1 / (1 + np.exp(2.0)), abs=1e-4)
    assert 0.0 < right["ece_if_right"] < right["ece_if_right_95"] < 1.0


def test_what_right_probabilities_show_of_few_draws():
    assert error_if_right(np.zeros(0)) is None
    assert error_if_right(np.array([0.0, 1.0])) == (0.0, 0.0)
    mean, most = error_if_right(np.full(1, 0.3))
    assert mean == pytest.approx(0.3 * 0.7 + 0.7 * 0.3, abs=0.03)
    assert most == 0.7
    many = np.linspace(0.0, 1.0, 4000)
    assert error_if_right(many)[0] == pytest.approx(0.0159, abs=0.002)  # 10 bins of 400 draws each
    assert error_if_right(many)[1] > error_if_right(many)[0]


def test_of_events_that_exclude_each_other_one_happens():
    # Of two modes at .5 one is the nearest, always: their bin is right in each drawing.
    assert error_if_right(np.full(8, 0.5), [2] * 4) == (0.0, 0.0)
    assert error_if_right(np.full(8, 0.5))[0] > 0.1
    assert error_if_right(np.array([0.25, 0.75]), [2])[0] == pytest.approx(0.375, abs=0.02)


def test_other_numbers_of_modes_are_measured_too(predictors, given):
    given(SCENES[0])
    found = evaluate(candidates=24)
    assert list(Of(found, "marginal").by_modes("min_fde")) == [6, 16, 24, 32]
    assert found.modes == (6, 16, 24, 32)


def evaluate_again(given, *scenes):
    given(*scenes)
    return evaluate()


def attacked(number):
    source = Source(dataset=windows.ROLLOUT, file="-", record=number, sha256="")
    return replace(SCENES[number], source=source)


def test_attacked_avs_are_predicted_reactively_and_blindly(predictors, given):
    given(attacked(0), attacked(1), SCENES[2])
    found = evaluate()
    assert found.attacked_scenes == 2
    assert found.of("opponent", "scenes").value == 1
    of = Of(found, "conditional", "given_true")
    at_2 = {"seconds": 2.0, "group": "attacked"}
    for name, modes in (("most_probable_fde", 1), ("min_fde", 6)):
        reactive = of.figure(name, modes, **at_2)
        assert reactive.objects == 2
        assert reactive.value == pytest.approx(0.0, abs=1e-6)
        assert of(name, modes, "given_nothing", **at_2) == 3.0
        assert of(name, modes, "marginal", **at_2) == 2.0
        assert of(f"{name}_gain_over_nothing", modes, **at_2) == pytest.approx(3.0)


def test_scenes_without_labels_have_the_av_and_vehicles_that_move_near_it(predictors, given):
    given(scene(labelled=False, shift=20.0))  # south is 56 m away, `far` 90 m
    found = evaluate()
    assert found.labelled_objects == 0
    assert found.of("marginal", "targets").value == 1
    assert found.of("opponent", "scenes_with_partner").value == 0
    partner = found.of("opponent", "partner_top1", condition="partner_head")
    assert (partner.value, partner.objects) == (None, 0)


def test_broken_records_are_counted_and_named(predictors, given):
    lost = replace(
        SCENES[1], tracks=replace(SCENES[1].tracks, valid=np.zeros_like(SCENES[1].tracks.valid))
    )
    bad = Refusal(file="a.tfrecord", record=7, name="", reason="the checksum is wrong")
    given(bad, SCENES[0], lost)
    found = evaluate()
    assert (found.scenes, found.refused) == (1, 2)
    assert found.refusals[0] == "a.tfrecord, record 7: the checksum is wrong"
    assert "the AV is missing" in found.refusals[1]


def test_no_usable_scene_is_an_error(predictors, given):
    given(Refusal(file="a", record=0, name="", reason="torn"))
    with pytest.raises(ReaderError, match=r"no usable scene in here .*torn"):
        evaluate()
    given()
    with pytest.raises(ReaderError, match=r"no usable scene in here; give"):
        evaluate()


@pytest.mark.slow_unit
def test_the_command_shows_tables_or_json(predictors, given):
    bad = Refusal(file="a.tfrecord", record=7, name="", reason="torn [here]")
    given(*SCENES, attacked(0), bad)
    found = CliRunner().invoke(command, ["here", "--format", "json"])
    assert found.exit_code == 0, found.output
    written = evaluation.Evaluation.from_record(json.loads(found.stdout))
    assert written.scenes == 4
    assert written.figures == evaluate_again(given, *SCENES, attacked(0), bad).figures
    given(*SCENES, attacked(0), bad)
    found = CliRunner().invoke(command, ["here"])
    for text in (
        "4 scenes, 1 refused",
        "a.tfrecord, record 7: torn [here]",
        "corridor formula",
        "lane following, constant speed",
        "conditional, given a shuffled one",
        "AV: given true - marginal network",
        "AVs attacked in simulation",
    ):
        assert text in found.output


@pytest.mark.slow_unit
def test_main_figures_go_onto_the_cards(predictors, given, tmp_path, monkeypatch):
    given(*SCENES)
    monkeypatch.setattr(weights, "find", lambda _: tmp_path)
    for network in weights.NETWORKS:
        net = getattr(torch_networks.random(LIGHT, 0), network).net
        cards.write(tmp_path, network, net, {"network": network})
    found = evaluation.run(
        [Path("here")], name="double", file=None, card=True, threads=None, report=print
    )
    for network in weights.NETWORKS:
        results = weights.read_card(tmp_path, network)["results"]
        assert results["data"] == ["here"]
        assert len(json.dumps(results)) < 3000
    marginal = Of(found, "conditional").by_modes("min_fde", "marginal")
    assert results["8.0"]["min_fde_marginal"] == {str(m): value for m, value in marginal.items()}
    assert results["8.0"]["on_road"].keys() == {"6", "16", "32", "recorded"}
    assert results["8.0"]["log_likelihood_gain_true"] == pytest.approx(0.5)


def test_a_file_that_cannot_be_written_is_named(predictors, given, tmp_path):
    given(SCENES[0])
    file = tmp_path / "folder"
    (file / "inside").mkdir(parents=True)
    with pytest.raises(OutputError, match="folder cannot be written"):
        evaluation.run(
            [Path("here")], name="double", file=file, card=False, threads=None, report=print
        )
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


@pytest.mark.slow_unit
def test_real_networks_and_clusters_are_measured(monkeypatch, given, tmp_path):
    rng = np.random.default_rng(0)
    fitted = clusters.fit(
        rng.normal(size=(40, 80, 2)), np.ones((40, 80), bool), np.zeros((40, 6)), rng
    )
    clusters.write(fitted, tmp_path)
    made = replace(torch_networks.random(LIGHT, 0), folder=tmp_path)
    monkeypatch.setattr(weights, "load", lambda _: made)
    given(SCENES[0])
    found = evaluate()
    of = Of(found, "marginal")
    assert of.by_modes("min_fde", "clusters").keys() == {6, 16, 32}
    assert found.clusters == "fitted on 40 trajectories"
    errors = list(of.by_modes("min_fde").values())
    assert errors[0] == max(errors)  # of 6 modes; 16 and 32 are not nested
    assert np.isfinite(Of(found, "conditional", "given_true")("log_likelihood_gain"))
    assert 0 <= of("ece") <= 1
