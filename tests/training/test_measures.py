import numpy as np
import pytest
import torch

from deepmf_sumo.errors import RunError
from deepmf_sumo.training.networks import clusters, opponent
from deepmf_sumo.training.samples.trajectory import distance_driven


def test_focal_loss_by_hand_and_its_limit():
    logits, labels = torch.tensor([0.0, 2.0]), torch.tensor([1.0, 0.0])
    first, second = opponent.focal(logits, labels, alpha=0.75, gamma=2.0).tolist()
    assert first == pytest.approx(0.75 * 0.25 * np.log(2))
    p = 1 / (1 + np.exp(-2.0))
    assert second == pytest.approx(-0.25 * p**2 * np.log(1 - p))
    plain = torch.nn.functional.binary_cross_entropy_with_logits(logits, labels, reduction="none")
    assert opponent.focal(logits, labels, 0.5, 0.0).tolist() == pytest.approx((plain / 2).tolist())


def test_profiles_hold_what_was_driven():
    rng = np.random.default_rng(0)
    speed = rng.uniform(0, 20, 400)
    gain = rng.choice([-1.0, 0.0, 1.0], 400)
    time = np.arange(1, 81) * 0.1
    driven = np.maximum(speed[:, None] * time + 0.5 * gain[:, None] * time**2, 0)
    driven = np.maximum.accumulate(driven, axis=1)
    table = clusters.speed_profiles(driven, speed, 24, rng)
    assert table.relative_m.shape == (13, 24, 80)
    assert (np.diff(table.relative_m[..., -1], axis=1) >= 0).all()
    assert np.exp(table.log_prior).sum(1) == pytest.approx(np.ones(13), abs=0.03)
    assert table.relative_m[7, -1, -1] == pytest.approx(32.0, abs=1.0)


def test_too_few_vehicles_for_profiles():
    with pytest.raises(RunError, match="Only 3 vehicles"):
        clusters.speed_profiles(np.zeros((3, 80)), np.zeros(3), 24, np.random.default_rng(0))


def test_driving_backwards_counts_as_standing():
    position = np.stack([np.linspace(0, -8, 81), np.zeros(81)], 1)
    assert distance_driven(position, np.zeros(81)).max() == 0.0
