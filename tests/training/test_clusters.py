import time

import numpy as np
import pytest

from deepmf_sumo.errors import RunError, WeightsError
from deepmf_sumo.training.networks import clusters

TIMES = np.arange(1, 81) * 0.1


def driven(count, rng):
    """Vehicles that brake, keep their speed or accelerate, and turn as they turn now."""
    speed, yaw_rate = rng.uniform(0, 15, count), rng.choice([0.0, 0.2], count)
    gain = rng.choice([-0.8, 0.0, 0.8], count)
    going = np.maximum(speed[:, None] + gain[:, None] * TIMES, 0.0)
    heading = yaw_rate[:, None] * TIMES
    step = 0.1 * going[..., None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    motion = np.zeros((count, 6))
    motion[:, 0], motion[:, 2] = speed, yaw_rate
    return np.cumsum(step, axis=1), motion


@pytest.fixture(scope="module")
def fitted():
    future, motion = driven(3000, np.random.default_rng(0))
    valid = np.ones((3000, 80), bool)
    return clusters.fit(future, valid, motion, np.random.default_rng(1))


def test_clusters_come_near_to_what_is_like_the_training_data(fitted):
    future, motion = driven(60, np.random.default_rng(2))
    errors = {}
    for modes in clusters.MODES:
        found = [clusters.predict(fitted, row[0], row[2], modes) for row in motion]
        assert found[0].shape == (modes, 80, 2)
        ends = [
            np.linalg.norm(f[:, -1] - t[-1], axis=-1) for f, t in zip(found, future, strict=True)
        ]
        errors[modes] = np.mean([each.min() for each in ends])
    assert errors[32] < errors[16] < errors[6] < 12.0
    assert errors[32] < 4.0


def test_a_prediction_begins_at_the_vehicle_and_is_smooth(fitted):
    found = clusters.predict(fitted, 10.0, 0.0, 6)
    assert np.abs(found[:, 0] - [1.0, 0.0]).max() < 0.5
    assert np.linalg.norm(np.diff(found, axis=1), axis=-1).max() < 2.5


def test_a_fit_is_the_same_for_the_same_seed_and_fast():
    future, motion = driven(500, np.random.default_rng(3))
    began = time.process_time()
    made = [
        clusters.fit(future, np.ones((500, 80), bool), motion, np.random.default_rng(4))
        for _ in range(2)
    ]
    assert time.process_time() - began < 4.0
    for modes in clusters.MODES:
        assert np.array_equal(made[0].deviation_m[modes], made[1].deviation_m[modes])


def test_futures_that_end_early_are_left_out():
    future, motion = driven(200, np.random.default_rng(5))
    valid = np.ones((200, 80), bool)
    valid[:100, 60:] = False
    assert clusters.fit(future, valid, motion, np.random.default_rng(0)).samples == 100
    valid[:190, 60:] = False
    with pytest.raises(RunError, match="Only 10 vehicles"):
        clusters.fit(future, valid, motion, np.random.default_rng(0))


def test_other_numbers_of_modes_are_refused(fitted):
    with pytest.raises(ValueError, match="not 7"):
        clusters.predict(fitted, 1.0, 0.0, 7)


def test_clusters_are_kept_beside_the_weights(fitted, tmp_path):
    assert clusters.read(tmp_path) is None
    clusters.write(fitted, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == [clusters.FILE]
    again = clusters.read(tmp_path)
    assert again.samples == 3000
    ours, theirs = (clusters.predict(each, 8.0, 0.2, 16) for each in (fitted, again))
    assert theirs == pytest.approx(ours, abs=0.1)


def test_a_damaged_file_is_named(fitted, tmp_path):
    clusters.write(fitted, tmp_path)
    file = tmp_path / clusters.FILE
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(WeightsError, match="damaged"):
        clusters.read(tmp_path)
