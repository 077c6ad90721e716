"""Training of DiffScene's diffusion model: components, futures, loss, errors, and the command."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from deepmf_sumo.baselines.priors import reading
from deepmf_sumo.baselines.priors.diffscene import COMPONENTS, DiffusionPrior
from deepmf_sumo.cli.train import command
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import RunError
from deepmf_sumo.scene import readers
from deepmf_sumo.training.networks import diffscene
from deepmf_sumo.training.samples import graph

from tests.support.synthetic import scene

pytestmark = pytest.mark.slow_unit


def samples(count):
    rows = []
    for number in range(count):
        made = scene(shift=3.0 * number - 12, av_speed=5.0 + number, turn=0.1 * number)
        rows.append(next(graph.graph_samples(made)))
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def accelerated(arrays):
    """The same with futures that nothing in the past foretells."""
    rng, times = np.random.default_rng(1), 0.5 * np.arange(1, 17)
    future = arrays["future"].copy()
    accel = rng.uniform(-0.3, 1.0, (*future.shape[:2], 1, 2))
    future[..., :2] += 0.5 * accel * times[:, None] ** 2 * future[..., 3:]
    return {**arrays, "future": future.astype(np.float32)}


@pytest.fixture(scope="module")
def arrays():
    return samples(12)


def dataset(arrays):
    rows = np.arange(len(arrays["future"]))
    return SimpleNamespace(
        rows=lambda held_out: rows,
        batch=lambda some: {name: values[some] for name, values in arrays.items()},
    )


def tensors(arrays):
    return {name: torch.from_numpy(values) for name, values in arrays.items()}


def test_futures_continue_at_their_last_velocity(arrays):
    batch = tensors(arrays)
    whole, _ = diffscene.futures(batch)
    batch["future"] = batch["future"].clone()
    batch["future"][:, 0, 11:] = 0.0  # the AV drives straight on at constant speed
    filled, weight = diffscene.futures(batch)
    torch.testing.assert_close(filled[:, 0], whole[:, 0], atol=1e-3, rtol=1e-4)
    assert (weight[:, 0] == 1).all()
    batch["future"][:, 0, 9:] = 0.0  # too short
    assert (diffscene.futures(batch)[1][:, 0] == 0).all()
    batch["future"][:, 0, :9] = whole.new_tensor([0.0, 0.0, 0.0, 1.0])
    batch["future"][:, 0, 3] = 0.0  # a gap
    assert (diffscene.futures(batch)[1][:, 0] == 0).all()


def test_components_are_those_of_numpy():
    """Principal components of random futures: unit variance, the least error of all bases."""
    rng = np.random.default_rng(0)
    future = np.zeros((64, 16, 16, 4), np.float32)
    future[..., 3] = 1.0
    future[..., :2] = np.cumsum(rng.normal([1.2, 0.0], 3, (64, 16, 16, 2)), 2)
    arrays = {"future": future, "motion": np.zeros((64, 16, 3), np.float32)}
    net = DiffusionPrior(LIGHT)
    diffscene.fit_components(net, dataset(arrays), 0)
    flat = future[..., :2].reshape(-1, 32).astype(float)
    clean = net.components(torch.from_numpy(future[..., :2]), torch.zeros(64, 16))
    np.testing.assert_allclose(clean.flatten(0, 1).std(0), 1.0, atol=0.02)
    kept = net.positions(clean, torch.zeros(64, 16)).reshape(-1, 32).double().numpy()
    values = np.linalg.eigvalsh(np.cov(flat.T, bias=True))
    lost = np.square(flat - kept).sum(1).mean()
    assert lost == pytest.approx(values[: 32 - COMPONENTS].sum(), rel=1e-3)


def test_too_few_vehicles_are_refused():
    empty = {name: np.zeros_like(values) for name, values in samples(3).items()}
    with pytest.raises(RunError, match="Only 0 vehicles move"):
        diffscene.fit_components(DiffusionPrior(LIGHT), dataset(empty), 0)
    assert diffscene.held_out_errors(DiffusionPrior(LIGHT), dataset(empty)) == {}


def test_training_lowers_the_loss(arrays):
    torch.manual_seed(0)
    net, arrays = DiffusionPrior(LIGHT), accelerated(arrays)
    diffscene.fit_components(net, dataset(arrays), 0)
    find, batch = diffscene.loss_of(net), tensors(arrays)
    with torch.no_grad():
        before = float(find(batch, torch.Generator().manual_seed(99)))
    optimiser = torch.optim.Adam(net.parameters(), lr=3e-3)
    for turn in range(40):
        value = find(batch, torch.Generator().manual_seed(turn))
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
    with torch.no_grad():
        after = float(find(batch, torch.Generator().manual_seed(99)))
    assert after < 0.7 * before
    errors = diffscene.held_out_errors(net, dataset(arrays))
    assert errors["vehicles"] > 0
    assert errors["components_ade"] < errors["min_ade_16"]


def test_the_command_trains_and_writes(monkeypatch, tmp_path):
    made = [scene(shift=2.0 * n - 15, turn=0.3 * n) for n in range(12)]
    monkeypatch.setattr(readers, "scenes", lambda _: iter(made))
    monkeypatch.setattr(graph, "WINDOW_STEPS", (10,))
    file = tmp_path / "recordings.bin"
    file.write_bytes(b"x")
    line = ["diffscene", "--data", str(file), "--out", str(tmp_path / "set"), "--cache",
            str(tmp_path / "cache"), "--set", "steps=2", "--set", "batch=4"]  # fmt: skip
    done = CliRunner().invoke(command, line, catch_exceptions=False)
    assert "diffscene: best step" in done.output
    card = json.loads((tmp_path / "set" / "diffscene.json").read_text())
    assert card["held_out_errors_m"]["vehicles"] > 0
    before = reading.diffusion_prior(tmp_path / "set").basis
    assert before.abs().max() > 0
    again = [*line[:3], "--out", str(tmp_path / "again"), *line[5:], "--set", "seed=7"]
    CliRunner().invoke(
        command, [*again, "--set", f"begin_from={tmp_path / 'set'}"], catch_exceptions=False
    )
    after = reading.diffusion_prior(tmp_path / "again").basis
    torch.testing.assert_close(after, before)  # layers that were trained know these components
