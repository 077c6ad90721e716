import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.append(str(Path(__file__).resolve().parents[1] / "predictors"))
from click.testing import CliRunner
from synthetic import scene

from deepmf_sumo import readers
from deepmf_sumo.cli.train import command
from deepmf_sumo.errors import UsageError, WeightsError
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.presets import LIGHT, PAPER
from deepmf_sumo.readers.base import Refusal
from deepmf_sumo.training import cache, evaluation, loop, losses, run, samples, trajectory


@pytest.fixture
def recordings(monkeypatch, tmp_path):
    """Twenty crossings, and one record that cannot be used."""
    made = [
        scene(shift=2.0 * number - 30, av_speed=4.0 + number % 9, turn=0.3 * number)
        for number in range(20)
    ]
    refusal = Refusal(file="-", record=20, name="bad", reason="damaged")
    monkeypatch.setattr(readers, "scenes", lambda _: iter([*made, refusal]))
    monkeypatch.setattr(samples, "WINDOW_STEPS", (10, 40))
    monkeypatch.setattr(samples, "OPPONENT_STEPS", (10,))
    file = tmp_path / "recordings.bin"
    file.write_bytes(b"x")
    return file


@pytest.fixture
def training(recordings, tmp_path):
    return run.Training(
        data=[recordings],
        folder=tmp_path / "set",
        cache=tmp_path / "cache",
        preset=LIGHT,
        steps=2,
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
    file = training.folder.parent / "figures.json"
    figures = evaluation.run(
        [recordings], name=str(training.folder), file=file, card=True, threads=None, report=print
    )
    assert json.loads(file.read_text(encoding="utf-8")) == figures
    card = json.loads((training.folder / "marginal.json").read_text(encoding="utf-8"))
    assert card["results"]["8.0"] == figures["marginal"]["8.0"]
    assert figures["scenes"] == 20
    assert figures["marginal"]["targets"] == 40
    assert set(figures["marginal"]["8.0"]["min_fde"]) == {"6", "16", "32"}
    assert figures["marginal"]["8.0"]["constant_velocity_fde"] == pytest.approx(0.0, abs=1e-6)
    assert figures["opponent"]["partner_top1"] is not None
    assert figures["conditional"]["targets"] > 30


def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(training):
    made = run._cache("marginal", training, print)

    def start():
        torch.manual_seed(0)
        net = weights.build("marginal", LIGHT)
        trajectory.start(net, made, 0)
        return net

    file = training.folder / "a.checkpoint"
    schedule = loop.Schedule(steps=4, batch=4, evaluate_every=2)
    whole = start()
    loop.train(whole, made, trajectory.loss_of(whole), schedule, file, lambda _: None)

    class CutError(Exception):
        pass

    def cut(line):
        if line.startswith("step 2"):
            raise CutError

    part = start()
    with pytest.raises(CutError):
        loop.train(part, made, trajectory.loss_of(part), schedule, file, cut)
    again = start()
    loop.train(again, made, trajectory.loss_of(again), schedule, file, lambda _: None)
    for one, other in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_training_lowers_the_loss(training):
    made = run._cache("marginal", training, print)
    torch.manual_seed(0)
    net = weights.build("marginal", LIGHT)
    trajectory.start(net, made, 0)
    loss = trajectory.loss_of(net)
    schedule = loop.Schedule(steps=16, batch=8, evaluate_every=16)
    before = loop.evaluate(net, made, loss, schedule)
    loop.train(net, made, loss, schedule, training.folder / "c", lambda _: None)
    assert loop.evaluate(net, made, loss, schedule) < before - 0.5


def test_held_out_scenes_are_never_trained_on(training):
    made = run._cache("opponent", training, print)
    train, held = made.rows(held_out=False), made.rows(held_out=True)
    assert not set(made.scene[train]) & set(made.scene[held])
    assert len(set(made.scene[held])) == 2


def test_a_cache_is_made_once(training, monkeypatch):
    first = run._cache("opponent", training, print)
    monkeypatch.setattr(readers, "scenes", None)
    second = run._cache("opponent", training, print)
    assert first.digest == second.digest
    rows = np.array([5, 2, 9])
    assert np.array_equal(second.batch(rows)["pair"], np.asarray(first.arrays["pair"])[rows])


def test_a_cache_that_was_cut_off_leaves_nothing(training, monkeypatch, recordings):
    def broken(_):
        yield scene()
        raise RuntimeError("cut")

    monkeypatch.setattr(readers, "scenes", broken)
    with pytest.raises(RuntimeError, match="cut"):
        run._cache("opponent", training, print)
    assert not list(training.cache.iterdir())


def test_the_paper_preset_takes_one_step():
    arrays = list(samples.trajectory_samples(scene(), PAPER))[:2]
    batch = {
        name: torch.from_numpy(np.stack([each[name] for each in arrays])) for name in arrays[0]
    }
    torch.manual_seed(0)
    net = weights.build("conditional", PAPER)
    given = trajectory.partner_condition(batch, PAPER, None)
    assert given.image.shape == (2, 80, 224, 224)
    goals = net(batch, given)
    loss = losses.mixture(net, goals, batch).mean()
    loss.backward()
    assert torch.isfinite(loss)
    assert net.image.blocks[0][0].weight.grad.abs().max() > 0


def test_the_loss_is_lower_for_what_happened(training):
    made = run._cache("marginal", training, print)
    net = weights.build("marginal", LIGHT)
    trajectory.start(net, made, 0)
    net.eval()
    batch = loop.tensors(made.batch(np.arange(8)))
    with torch.inference_mode():
        goals = net(batch)
        true = losses.mixture(net, goals, batch).mean()
        batch["future"] = batch["future"] + 30.0
        assert losses.mixture(net, goals, batch).mean() > true + 5.0


def test_data_that_does_not_exist_is_named(training, tmp_path):
    missing = cache.open_or_make
    with pytest.raises(UsageError, match="does not exist"):
        missing("opponent", [tmp_path / "no"], "", lambda _: [], tmp_path, print)


def test_the_command_makes_a_named_set(recordings, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path / "home"))
    arguments = ["opponent", "--data", str(recordings), "--name", "mine", "--steps", "1"]
    found = CliRunner().invoke(command, [*arguments, "--licence", "ours"])
    assert found.exit_code == 0, found.output
    card = json.loads(
        (tmp_path / "home" / "weights" / "mine" / "opponent.json").read_text(encoding="utf-8")
    )
    assert card["steps"] == 1
    assert card["scenes"] == 20
    assert "held-out loss" in found.output


def test_cuda_that_is_not_there_is_refused(training):
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(WeightsError, match="--device cpu"):
        run.train("opponent", replace(training, device="cuda"), print)
