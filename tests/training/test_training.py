import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from deepmf_sumo.cli.train import command
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT, PAPER, UNPAIRED
from deepmf_sumo.errors import OutputError, RunError, UsageError, WeightsError
from deepmf_sumo.scene import ROLLOUT, readers
from deepmf_sumo.scene.readers.base import Refusal
from deepmf_sumo.training import run
from deepmf_sumo.training.config import Optimisation
from deepmf_sumo.training.fit import loop
from deepmf_sumo.training.fit.checkpoints import Checkpoints, LearningCurves
from deepmf_sumo.training.networks import clusters, trajectory
from deepmf_sumo.training.samples import dataset, feature_cache
from deepmf_sumo.training.samples import opponent as opponent_samples
from deepmf_sumo.training.samples import trajectory as trajectory_samples
from deepmf_sumo.training.samples.dataset import SampleSource, mix
from deepmf_sumo.training.samples.feature_cache import Data
from deepmf_sumo.training.samples.places import SceneArea

from tests.support.synthetic import scene, view

pytestmark = pytest.mark.slow_unit


@pytest.fixture
def recordings(monkeypatch, tmp_path):
    """Twenty crossings, and one record that cannot be used."""
    made = [
        scene(shift=2.0 * number - 30, av_speed=4.0 + number % 9, turn=0.3 * number)
        for number in range(20)
    ]
    refusal = Refusal(file="-", record=20, name="bad", reason="damaged")
    monkeypatch.setattr(readers, "scenes", lambda _: iter([*made, refusal]))
    monkeypatch.setattr(trajectory_samples, "WINDOW_STEPS", (10, 40))
    monkeypatch.setattr(opponent_samples, "AV_STEPS", (10,))
    monkeypatch.setattr(opponent_samples, "STAND_IN_STEPS", ())
    file = tmp_path / "recordings.bin"
    file.write_bytes(b"x")
    return file


@pytest.fixture
def training(recordings, tmp_path):
    return run.Training(
        data=[Data(path=recordings)],
        folder=tmp_path / "set",
        cache=tmp_path / "cache",
        preset=LIGHT,
        optimisation=dict.fromkeys(weights.NETWORKS, Optimisation(steps=2)),
        licence="ours",
        command="test",
    )


def test_all_networks_are_trained_and_usable(training, recordings):
    lines = []
    for network in weights.NETWORKS:
        run.train(network, training, lines.append)
    found = weights.load(training.folder)
    card = json.loads((training.folder / "conditional.json").read_text(encoding="utf-8"))
    assert card["scenes"] == 20
    assert card["refused"] == 1
    assert card["began_from"] == "marginal"
    assert card["licence"] == "ours"
    assert not list(training.folder.glob("*.checkpoint"))
    assert found.marginal.net.prior.std() > 0


def test_an_opponent_network_without_pairs_is_trained_and_usable(training):
    for network in weights.NETWORKS:
        preset = UNPAIRED if network == "opponent" else LIGHT
        run.train(network, replace(training, preset=preset), print)
    found = weights.load(training.folder).opponent
    assert found.net.preset == UNPAIRED
    assert not any("pair" in name for name in found.net.state_dict())
    scores = found.score(view(), everyone=True)
    assert len(scores.ids) > 1
    assert np.isfinite(scores.logits).all()


def test_networks_with_and_without_pairs_share_features(training, monkeypatch):
    first = run.open_dataset("opponent", training, print)
    monkeypatch.setattr(readers, "scenes", None)
    second = run.open_dataset("opponent", replace(training, preset=UNPAIRED), print)
    assert first.sources[0].digest == second.sources[0].digest


def test_training_lowers_the_loss(training):
    made = run.open_dataset("marginal", training, print)
    torch.manual_seed(0)
    net = torch_networks.build("marginal", LIGHT)
    trajectory.fit_profiles(net, made, 0)
    loss = trajectory.loss_of(net)
    schedule = loop.Schedule(steps=16, batch=8, evaluate_every=16)
    before = loop.validation_losses(net, made, loss, schedule)[0]
    checkpoints = Checkpoints(training.folder / "c")
    curves = LearningCurves(training.folder / "c.csv", ["recordings"], print)
    loop.train(net, made, loss, schedule, checkpoints, curves, lambda _: None)
    assert loop.validation_losses(net, made, loss, schedule)[0] < before - 0.5


def test_held_out_scenes_are_never_trained_on(training):
    made = run.open_dataset("opponent", training, print)
    train, held = made.rows(held_out=False), made.rows(held_out=True)
    assert not set(made.scene[train]) & set(made.scene[held])
    assert len(set(made.scene[held])) == 2


def test_scenes_without_samples_do_not_make_all_others_held_out():
    for scenes in (5, 40):
        source = SampleSource(
            name="mine",
            arrays={},
            scene=np.array([3, 3, 4]),  # of the scenes only two have samples
            scenes=[str(number) for number in range(scenes)],
            areas=[SceneArea("", ((0, 0),))] * scenes,
            refused={},
            digest="",
        )
        assert mix([source]).held_out.tolist() == [False, False, True]


def test_a_single_scene_that_is_held_out_leaves_nothing_to_train_on(training, monkeypatch):
    monkeypatch.setattr(dataset, "held_out", lambda areas, _: (np.ones(len(areas), bool), True))
    with pytest.raises(RunError, match="are held out; give more recordings"):
        run.train("opponent", training, print)


def test_attacks_teach_neither_opponents_nor_how_people_drive(training, monkeypatch):
    made = [scene(shift=2.0 * number - 30) for number in range(3)]
    attacks = [replace(one, source=replace(one.source, dataset=ROLLOUT)) for one in made]
    people = [scene(shift=2.0 * number - 30) for number in range(20)]
    monkeypatch.setattr(readers, "scenes", lambda _: iter([*attacks, *people]))
    lines = []
    run.train("opponent", training, lines.append)
    run.train("marginal", training, lines.append)
    assert any("3 scenes have no samples: attacks" in line for line in lines)
    assert any("samples with a planner as the driver are left out" in line for line in lines)
    monkeypatch.setattr(readers, "scenes", lambda _: iter(attacks))
    alone = replace(training, cache=training.cache / "other")
    with pytest.raises(RunError, match="planners drive in all samples"):
        run.train("marginal", replace(alone, folder=training.folder / "other"), lines.append)


def test_clusters_that_cannot_be_written_leave_a_training_to_finish(training, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(clusters, "write", full)
        with pytest.raises(OutputError, match="No space left"):
            run.train("marginal", training, print)
    assert list(training.folder.glob("*.checkpoint"))
    run.train("marginal", training, print)
    assert list(training.folder.glob("clusters*"))
    assert not list(training.folder.glob("*.checkpoint"))


def test_a_cache_is_made_once(training, monkeypatch):
    first = run.open_dataset("opponent", training, print)
    monkeypatch.setattr(readers, "scenes", None)
    second = run.open_dataset("opponent", training, print)
    assert first.sources[0].digest == second.sources[0].digest
    rows = np.array([5, 2, 9])
    assert np.array_equal(second.batch(rows)["pair"], np.asarray(first.arrays["pair"])[rows])


def test_the_paper_preset_takes_one_step():
    arrays = list(trajectory_samples.trajectory_samples(scene(), PAPER))[:2]
    batch = {
        name: torch.from_numpy(np.stack([each[name] for each in arrays])) for name in arrays[0]
    }
    torch.manual_seed(0)
    net = torch_networks.build("conditional", PAPER)
    given = trajectory.partner_condition(batch, PAPER, None)
    assert given.image.shape == (2, 80, 224, 224)
    goals = net(batch, given)
    loss = trajectory.mixture_loss(net, goals, batch).mean()
    loss.backward()
    assert torch.isfinite(loss)
    assert net.image.blocks[0][0].weight.grad.abs().max() > 0


def test_the_loss_is_lower_for_what_happened(training):
    made = run.open_dataset("marginal", training, print)
    net = torch_networks.build("marginal", LIGHT)
    trajectory.fit_profiles(net, made, 0)
    net.eval()
    batch = loop.tensors(made.batch(np.arange(8)))
    with torch.inference_mode():
        goals = net(batch)
        true = trajectory.mixture_loss(net, goals, batch).mean()
        batch["future"] = batch["future"] + 30.0
        assert trajectory.mixture_loss(net, goals, batch).mean() > true + 5.0


def test_data_that_does_not_exist_is_named(tmp_path):
    missing = Data(path=tmp_path / "no")
    with pytest.raises(UsageError, match="does not exist"):
        feature_cache.open_or_build(opponent_samples.features_for(LIGHT), missing, tmp_path, print)


def test_the_command_makes_a_named_set(recordings, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path / "home"))
    arguments = ["opponent", "--data", str(recordings), "--name", "mine", "--set", "steps=1"]
    found = CliRunner().invoke(command, [*arguments, "--set", "licence=ours"])
    assert found.exit_code == 0, found.output
    card = json.loads(
        (tmp_path / "home" / "weights" / "mine" / "opponent.json").read_text(encoding="utf-8")
    )
    assert card["steps"] == 1
    assert card["scenes"] == 20
    assert "step 1 of 1: loss" in found.output


def test_cuda_that_is_not_there_is_refused(training, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(WeightsError, match="no CUDA device for DEEPMF_SUMO_DEVICE=cuda; use"):
        run.train("opponent", replace(training, device="cuda"), print)
    assert torch_networks.device("auto") == "cpu"
    monkeypatch.setenv(weights.DEVICE, "cuda")
    with pytest.raises(WeightsError, match="no CUDA device for DEEPMF_SUMO_DEVICE=cuda"):
        weights.load("open", "torch")
    monkeypatch.setenv(weights.DEVICE, "gpu")
    with pytest.raises(WeightsError, match="is 'gpu'; set it to cpu, cuda, auto"):
        torch_networks.device()
