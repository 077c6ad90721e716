"""Training of STRIVE's motion prior: samples, loss, errors, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from deepmf_sumo.baselines.priors import reading
from deepmf_sumo.baselines.priors.strive import MotionPrior
from deepmf_sumo.cli.train import command
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.scene import ROLLOUT, SIMULATED, readers
from deepmf_sumo.training.networks import strive
from deepmf_sumo.training.samples import graph

from tests.support.synthetic import scene

pytestmark = pytest.mark.slow_unit


def of_dataset(name, made):
    return replace(made, source=replace(made.source, dataset=name))


@pytest.fixture(scope="module")
def batch():
    rows = [
        next(graph.graph_samples(scene(shift=3.0 * n - 12, av_speed=5.0 + n))) for n in range(4)
    ]
    return {name: torch.from_numpy(np.stack([row[name] for row in rows])) for name in rows[0]}


def test_futures_are_in_each_vehicles_frame(batch):
    future = batch["future"][3]
    assert future[:5, :, 3].all()
    assert not future[5:].any()
    times = 0.5 * torch.arange(1, 17)
    torch.testing.assert_close(future[0, :, 0], 8.0 * times)
    assert future[0, :, 1:3].abs().max() < 1e-4


def test_later_windows_know_less():
    made = list(graph.graph_samples(scene()))
    known = [int(each["future"][0, :, 3].sum()) for each in made]
    assert known == [16, 14, 12, 10]


def test_of_an_attack_the_av_alone_teaches():
    made = next(graph.graph_samples(of_dataset(ROLLOUT, scene())))
    assert made["future"][0, :, 3].all()
    assert not made["future"][1:].any()


def test_simulated_scenes_are_looked_at_once():
    assert len(list(graph.graph_samples(of_dataset(SIMULATED, scene())))) == 1


def test_training_lowers_the_loss_and_the_errors(batch):
    torch.manual_seed(0)
    net = MotionPrior(LIGHT)
    find = strive.loss_of(net)
    few = {name: values[:3, :4] for name, values in batch.items()}
    before = strive.errors(net, [few], torch.Generator().manual_seed(0))
    optimiser = torch.optim.Adam(net.parameters(), lr=3e-3)
    net.train()
    for turn in range(6):
        value = find(few, torch.Generator().manual_seed(turn))
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
    after = strive.errors(net, [few], torch.Generator().manual_seed(0))
    assert before["vehicles"] == 3 * 3
    assert after["reconstruction_ade"] < before["reconstruction_ade"]
    assert after["min_ade_16"] <= after["mean_ade"] * 1.5
    assert int(net.seen) == 6


def test_all_of_the_divergence_counts_in_evaluation(batch):
    torch.manual_seed(0)
    net = MotionPrior(LIGHT)
    find = strive.loss_of(net)
    batch = {name: values[:2] for name, values in batch.items()}
    with torch.no_grad():
        net.eval()
        late = find(batch, torch.Generator().manual_seed(0))
        net.train()
        early = find(batch, torch.Generator().manual_seed(0))
    assert early < late


def test_a_batch_without_known_futures_among_the_nearest_teaches_nothing(batch):
    blind = {**batch, "future": torch.zeros_like(batch["future"])}
    value = strive.loss_of(MotionPrior(LIGHT))(blind, torch.Generator().manual_seed(0))
    assert torch.isfinite(value)


def test_no_vehicle_moves():
    assert strive.errors(MotionPrior(LIGHT), [], torch.Generator()) == {}


def test_the_command_trains_writes_and_does_not_train_twice(monkeypatch, tmp_path):
    made = [scene(shift=2.0 * n - 15, turn=0.3 * n) for n in range(12)]
    monkeypatch.setattr(readers, "scenes", lambda _: iter(made))
    monkeypatch.setattr(graph, "WINDOW_STEPS", (10,))
    file = tmp_path / "recordings.bin"
    file.write_bytes(b"x")
    line = ["strive", "--data", str(file), "--out", str(tmp_path / "set"), "--cache",
            str(tmp_path / "cache"), "--set", "steps=2", "--set", "batch=4"]  # fmt: skip
    done = CliRunner().invoke(command, line, catch_exceptions=False)
    assert "strive: best step" in done.output
    card = json.loads((tmp_path / "set" / "strive.json").read_text())
    assert card["network"] == "strive"
    assert card["held_out_errors_m"]["vehicles"] > 0
    assert not list((tmp_path / "set").glob("*.checkpoint*"))
    assert isinstance(reading.motion_prior(tmp_path / "set"), MotionPrior)
    done = CliRunner().invoke(command, line, catch_exceptions=False)
    assert "this training is complete" in done.output


def test_all_leaves_the_priors_out():
    assert "strive" not in weights.NETWORKS
    assert weights.BASELINES == ("strive", "diffscene")
