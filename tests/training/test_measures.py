import numpy as np
import pytest
import torch

from deepmf_sumo.errors import RunError
from deepmf_sumo.training import losses, profiles
from deepmf_sumo.training.accuracy import DisplacementErrors, auroc, average_precision


def test_auroc_counts_pairs_and_halves_ties():
    scores = np.array([3.0, 2.0, 2.0, 1.0])
    labels = np.array([True, True, False, False])
    assert auroc(scores, labels) == pytest.approx(3.5 / 4)
    assert auroc(scores, np.ones(4, bool)) is None


def test_average_precision_by_hand():
    scores = np.array([4.0, 3.0, 2.0, 1.0])
    labels = np.array([True, False, True, False])
    assert average_precision(scores, labels) == pytest.approx((1 + 2 / 3) / 2)


def test_errors_and_misses_by_hand():
    true = np.stack([np.arange(1, 81) * 1.0, np.zeros(80)], 1)
    errors = DisplacementErrors()
    valid = np.ones(80, bool)
    errors.add(
        np.stack([true + np.array([0, 4.0]), true + np.array([7.0, 0])]),
        true,
        np.zeros(80),
        valid,
        20.0,
    )
    assert errors.fde["8.0"] == [4.0]
    assert errors.ade["3.0"] == [4.0]
    assert errors.missed["8.0"] == [1.0]  # 4 m beside, 7 m ahead: outside 3 and 6
    errors.add(true[None] + [5.0, 0], true, np.zeros(80), valid, 20.0)
    assert errors.missed["8.0"][-1] == 0.0
    assert errors.missed["3.0"][-1] == 1.0
    errors.add(true[None] + [5.0, 0], true, np.zeros(80), valid, 0.0)
    assert errors.missed["8.0"][-1] == 1.0  # thresholds are halved at low speed
    errors.add(true[None], true, np.zeros(80), np.arange(80) < 60, 0.0)
    assert len(errors.fde["8.0"]) == 3


def test_focal_loss_by_hand_and_its_limit():
    logits, labels = torch.tensor([0.0, 2.0]), torch.tensor([1.0, 0.0])
    first, second = losses.focal(logits, labels, alpha=0.75, gamma=2.0).tolist()
    assert first == pytest.approx(0.75 * 0.25 * np.log(2))
    p = 1 / (1 + np.exp(-2.0))
    assert second == pytest.approx(-0.25 * p**2 * np.log(1 - p))
    plain = torch.nn.functional.binary_cross_entropy_with_logits(logits, labels, reduction="none")
    assert losses.focal(logits, labels, 0.5, 0.0).tolist() == pytest.approx((plain / 2).tolist())


def test_profiles_hold_what_was_driven():
    rng = np.random.default_rng(0)
    speed = rng.uniform(0, 20, 400)
    gain = rng.choice([-1.0, 0.0, 1.0], 400)
    time = np.arange(1, 81) * 0.1
    driven = np.maximum(speed[:, None] * time + 0.5 * gain[:, None] * time**2, 0)
    driven = np.maximum.accumulate(driven, axis=1)
    table = profiles.fit(driven, speed, rng)
    assert table.relative_m.shape == (13, 24, 80)
    assert (np.diff(table.relative_m[..., -1], axis=1) >= 0).all()
    assert np.exp(table.log_prior).sum(1) == pytest.approx(np.ones(13), abs=0.03)
    assert table.relative_m[7, -1, -1] == pytest.approx(32.0, abs=1.0)


def test_too_few_vehicles_for_profiles():
    with pytest.raises(RunError, match="Only 3 vehicles"):
        profiles.fit(np.zeros((3, 80)), np.zeros(3), np.random.default_rng(0))


def test_driving_backwards_counts_as_standing():
    position = np.stack([np.linspace(0, -8, 81), np.zeros(81)], 1)
    assert profiles.driven(position, np.zeros(81)).max() == 0.0
