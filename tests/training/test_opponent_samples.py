from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import torch_networks
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.training.networks import opponent
from deepmf_sumo.training.samples import opponent as opponent_samples

from tests.support.synthetic import scene


@pytest.fixture
def samples(monkeypatch):
    monkeypatch.setattr(opponent_samples, "AV_STEPS", (10, 30))
    monkeypatch.setattr(opponent_samples, "STAND_IN_STEPS", (10,))
    return list(opponent_samples.opponent_samples(scene(), LIGHT))


def test_the_partner_stands_in_for_the_av_and_the_other_way_round(samples):
    by_av, by_other = samples[0], samples[1]
    assert [float(each["stands_in"]) for each in samples] == [0, 1, 0]
    assert by_av["partner"].sum() == by_other["partner"].sum() == 1
    row, other = by_av["partner"].argmax(), by_other["partner"].argmax()
    assert by_av["interacts"][row] == by_other["interacts"][other] == 1
    # in the frame of each, the other one comes from the other side
    assert np.sign(by_av["pair"][row, 1]) == -np.sign(by_other["pair"][other, 1])


def test_a_scene_that_names_no_partner_has_no_partner_label():
    for each in opponent_samples.opponent_samples(scene(labelled=False), LIGHT):
        assert not each["partner"].any()
        assert each["partner_known"] == 0


def test_later_windows_say_how_much_of_the_future_the_labels_know(samples):
    assert samples[0]["pair"][0, -1] == pytest.approx(1.0)
    assert samples[2]["pair"][0, -1] == pytest.approx(6.0 / 8.0)


def test_samples_are_the_same_each_time():
    first, second = (list(opponent_samples.opponent_samples(scene(), LIGHT)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_a_scene_without_other_vehicles_gives_nothing():
    given = scene(labelled=False)
    alone = replace(given, tracks=given.tracks.select([0]))
    assert list(opponent_samples.opponent_samples(alone, LIGHT)) == []


def test_labels_are_those_of_all_times_against_all_times():
    rng = np.random.default_rng(0)
    given = scene()
    tracks = given.tracks
    found, wanted = [], []
    for _ in range(20):
        start, speed = rng.uniform(-40, 40, 2), rng.uniform(-9, 9, 2)
        position = tracks.position_m.copy()
        position[1] = start + speed * np.arange(tracks.steps)[:, None] * 0.1
        heading = tracks.heading_rad.copy()
        heading[1] = np.arctan2(speed[1], speed[0])
        moved = replace(tracks, position_m=position, heading_rad=heading)
        found.append(opponent_samples.interacting(moved, given.road, "av", ["south"])[0])
        apart = np.linalg.norm(position[0] - position[1], axis=1)
        overlap = boxes.overlap(
            position[0][:, None], heading[0][:, None], tracks.size_m[0, :2],
            position[1][None], heading[1][None], tracks.size_m[1, :2],
        )  # fmt: skip
        wanted.append(apart.min() < tracks.size_m[0, 0] or overlap.any())
    assert found == wanted
    assert 5 < sum(found) < 25


@pytest.mark.slow_unit
def test_training_on_a_few_samples_lowers_both_losses(samples):
    torch.manual_seed(0)
    net = torch_networks.build("opponent", replace(LIGHT, raster=False, vectors=False))
    loss = opponent.loss_of(net)
    batch = {
        name: torch.from_numpy(np.stack([each[name] for each in samples])) for name in samples[0]
    }
    optimiser = torch.optim.AdamW(net.parameters(), lr=3e-3)
    before = loss(batch, torch.Generator()).item()
    for _ in range(20):
        optimiser.zero_grad()
        value = loss(batch, torch.Generator())
        value.backward()
        optimiser.step()
    assert value.item() < 0.5 * before
    net.eval()
    with torch.inference_mode():
        chosen = net(batch).mean(0)[..., 1].masked_fill(batch["vehicle"] < 1, -9e9).argmax(1)
    assert chosen[0] == samples[0]["partner"].argmax()


def test_both_encoders_learn_once_the_pairs_have_begun(samples):
    torch.manual_seed(0)
    net = torch_networks.build("opponent", LIGHT)
    for member in net.members:
        torch.nn.init.normal_(member.scene[-1].weight, std=0.1)
    batch = {
        name: torch.from_numpy(np.stack([each[name] for each in samples])) for name in samples[0]
    }
    opponent.loss_of(net)(batch, torch.Generator()).backward()
    for encoder in (net.vectors, net.image):
        assert all(each.grad is not None for each in encoder.parameters())
        assert max(float(each.grad.abs().max()) for each in encoder.parameters()) > 0


def test_a_batch_without_any_named_partner_has_a_loss(samples):
    net = torch_networks.build("opponent", replace(LIGHT, raster=False, vectors=False))
    batch = {
        name: torch.from_numpy(np.stack([each[name] for each in samples])) for name in samples[0]
    }
    batch["partner_known"] = torch.zeros(len(samples))
    assert torch.isfinite(opponent.loss_of(net)(batch, torch.Generator()))
