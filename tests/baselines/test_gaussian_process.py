"""The Gaussian process: against its textbook formulas, and what its length scales say."""

import numpy as np
import pytest

from deepmf_sumo.baselines.bbo import GaussianProcess, fitted_scales

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-1, 1, (25, 3))
VALUES = np.sin(3 * POINTS[:, 0]) + POINTS[:, 1] ** 2
SCALES = np.array([0.8, 1.5, 2.0])


def kernel(first, second):
    away = np.sqrt((((first[:, None] - second) / SCALES) ** 2).sum(-1) * 5)
    return (1 + away + away**2 / 3) * np.exp(-away)


def test_mean_deviation_and_likelihood_are_the_textbooks():
    new = RNG.uniform(-1, 1, (7, 3))
    matrix = kernel(POINTS, POINTS) + 1e-4 * np.eye(25)
    inverse = np.linalg.inv(matrix)
    amplitude = VALUES @ inverse @ VALUES / 25
    process = GaussianProcess(POINTS, VALUES, SCALES)
    mean, deviation = process.predict(new)
    cross = kernel(new, POINTS)
    np.testing.assert_allclose(mean, cross @ inverse @ VALUES, rtol=1e-6)
    variance = amplitude * (1 - np.einsum("bi,ij,bj->b", cross, inverse, cross))
    np.testing.assert_allclose(deviation, np.sqrt(variance), rtol=1e-5)
    expected = -0.5 * np.linalg.slogdet(amplitude * matrix)[1]
    assert process.log_likelihood == pytest.approx(expected)


def test_an_axis_that_does_not_matter_gets_a_long_scale():
    scales = np.ones(3)
    for _ in range(4):
        scales = fitted_scales(POINTS, VALUES - VALUES.mean(), scales)
    assert scales[2] > 1.5 * scales[:2].max()
