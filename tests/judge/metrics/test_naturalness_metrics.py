"""Naturalness against independent implementations, and worked by hand."""

import dataclasses
import itertools

import numpy as np
import pytest
import scipy.signal
import scipy.spatial.distance
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics import _slices, naturalness
from deepmf_sumo.judge.metrics.naturalness import AccelerationSamples
from deepmf_sumo.judge.metrics.statistics import pooled

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

AV = straight(0, 0, 10)
SEEDS = pytest.mark.parametrize("seed", range(4))


def measured(name, path, **more):
    return plugins.load("metrics", name).measure(
        rollout_of({"av": AV[: len(path)], "b": path}, **more), case_of()
    )


def histogram(sample, bins):
    """Of a sample in single bins by hand: floor, ends clipped."""
    at = np.clip(np.floor(sample * (bins - 1) / 20 + bins / 2), 0, bins - 1).astype(int)
    return np.bincount(at, minlength=bins) + 1e-10


def two_samples(seed):
    rng = np.random.default_rng(seed)
    return rng.normal(0, 4, 300), rng.standard_t(2, 130) + 0.5


@SEEDS
@pytest.mark.parametrize("bins", [21, 201])
def test_divergences_against_scipy(seed, bins):
    a, b = two_samples(seed)
    p, q = histogram(a, bins), histogram(b, bins)
    assert naturalness.divergence(a, b, bins) == pytest.approx(scipy.stats.entropy(p, q))
    assert naturalness.divergence(b, a, bins) == pytest.approx(scipy.stats.entropy(q, p))
    expected = scipy.spatial.distance.jensenshannon(p, q) ** 2
    assert naturalness.jensen_shannon(a, b, bins) == pytest.approx(expected)


@SEEDS
def test_wasserstein_against_scipy(seed):
    a, b = two_samples(seed)
    expected = scipy.stats.wasserstein_distance(a, b)
    assert naturalness.wasserstein(a, b) == pytest.approx(expected)
    assert naturalness.wasserstein(a, a[::-1]) == 0.0


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1, 2.5])
def test_a_constant_speed_is_counted_in_one_bin_whichever_way_it_leads(angle):
    path = straight(-800, 3.5, 12, heading=angle)[11:, :2]
    steady = naturalness.speed_changes(path, 0.1)
    assert np.abs(steady).max() < 1e-6
    gaining = np.full(80, 0.4)  # in the bin from -0.5 to 0.5 as well
    assert naturalness.divergence(steady, gaining) == pytest.approx(0.0, abs=1e-9)


def test_a_tenth_of_a_millimetre_does_not_move_the_divergence_of_a_standing_car():
    noise = np.random.default_rng(0).normal(0, 1e-4, (2, 80))
    attack, recorded = (naturalness.speed_changes(np.c_[one, one], 0.1) for one in noise)
    assert 0.005 < np.abs(attack).max() < 0.5
    assert naturalness.divergence(attack, recorded) == pytest.approx(0.0, abs=1e-9)
    assert pooled([AccelerationSamples(attack, recorded)]).jsd < 0.01


def test_divergence_by_hand():
    # all mass in one bin against half in it and half in another: log 2
    kl = naturalness.divergence(np.full(10, 0.4), np.repeat([0.4, 3.6], 5))
    assert kl == pytest.approx(np.log(2), abs=1e-6)
    apart = np.full(10, -15.0), np.full(7, 99.0)  # counted in the end bins
    assert naturalness.jensen_shannon(*apart) == pytest.approx(np.log(2))
    assert naturalness.divergence(*apart) == pytest.approx(np.log(7 / 1e-10), rel=0.02)


@given(st.integers(11, 60), st.integers(0, 2**31))
def test_savitzky_golay_against_scipy(count, seed):
    values = np.random.default_rng(seed).normal(size=count).cumsum()
    expected = scipy.signal.savgol_filter(values, 11, 2, deriv=1, delta=0.1)
    np.testing.assert_allclose(naturalness.derivative(values, 0.1), expected, atol=1e-9)


def test_changes_of_speed():
    line = straight(0, 0, 5, steps=30, accel=2.0, now=0)[:, :2]
    np.testing.assert_allclose(naturalness.speed_changes(line, 0.1), 2.0, atol=1e-9)
    np.testing.assert_allclose(naturalness.smooth_changes(line, 0.1), 2.0, atol=1e-9)
    assert len(naturalness.speed_changes(line, 0.1)) == 28
    assert len(naturalness.smooth_changes(line, 0.1)) == 29
    assert len(naturalness.smooth_changes(line[:11], 0.1)) == 0


def test_smoothing_takes_noise_out_of_the_comparison():
    noise = np.random.default_rng(1).normal(0, 0.02, (91, 2))
    path = straight(-8, 3.5, 12)
    path[:, :2] += noise
    assert measured("acceleration_wasserstein", path).value > 2.0
    assert measured("acceleration_wasserstein_smooth", path).value < 0.5
    braking = straight(-8, 3.5, 40, accel=-3.0)
    for name in ("acceleration_wasserstein", "acceleration_wasserstein_smooth"):
        assert measured(name, braking).value == pytest.approx(3.0, abs=1e-6)
    assert measured("acceleration_jsd_smooth", braking).value == pytest.approx(np.log(2))


def test_too_short_for_the_filter():
    value = measured("acceleration_kl_smooth", straight(-8, 3.5, 12)[:16])
    assert (value.value, value.reason) == (None, naturalness.TOO_SHORT_TO_SMOOTH)


def test_path_distances_by_hand():
    """An L against a straight line: every point's distance is known."""
    line = np.array([[0.0, 0], [10, 0], [20, 0]])
    bent = np.array([[0.0, 0], [10, 0], [10, 6]])
    # of the L's points to the line: 0, 0, 6; of the line's to the L: 0, 0, 10
    assert naturalness.symmetric_mean(bent, line) == pytest.approx((6 / 3 + 10 / 3) / 2)
    assert naturalness.hausdorff(bent, line) == pytest.approx(10.0)
    longer = np.array([[0.0, 0], [30, 0]])
    assert naturalness.hausdorff(line, longer) == pytest.approx(10.0)
    assert naturalness.symmetric_mean(line, longer) == pytest.approx(10 / 4)


def brute_force(points, path):
    """Least distance of each point to any of ten thousand points of each piece."""
    share = np.linspace(0, 1, 2001)[:, None]
    dense = np.concatenate([a + share * (b - a) for a, b in itertools.pairwise(path)])
    return np.array([np.hypot(*(dense - point).T).min() for point in points])


@SEEDS
def test_path_distances_against_brute_force(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(12, 2)).cumsum(0), rng.normal(size=(9, 2)).cumsum(0)
    there, back = brute_force(a, b), brute_force(b, a)
    assert naturalness.symmetric_mean(a, b) == pytest.approx(
        (there.mean() + back.mean()) / 2, abs=2e-3
    )
    assert naturalness.hausdorff(a, b) == pytest.approx(max(there.max(), back.max()), abs=2e-3)


def test_a_path_cut_at_the_contact_is_compared_up_to_it():
    aside = straight(-8, 3.5, 12)[:31]
    aside[11:, 1] += 1.0
    hit = {"contacts": [contact_of(step=30)]}
    rollout = rollout_of({"av": AV[:31], "b": aside}, **hit)
    for name in ("path_sspd", "path_hausdorff"):
        cut = plugins.load("metrics", f"{name}_cut").measure(rollout, case_of()).value
        assert cut == pytest.approx(1.0, abs=1e-9)
        # no plan says what comes after the contact: that is not compared with the rest of the log
        whole = plugins.load("metrics", name).measure(rollout, case_of()).value
        assert whole == pytest.approx(1.0, abs=1e-9)


def test_a_log_that_ends_early_is_compared_over_its_own_time():
    """The attack swerves after 3 s; a log of 3 s cannot say that this is unnatural, or natural."""
    swerve = straight(-8, 3.5, 12)
    swerve[11:, 1] += 1.0
    swerve[41:, 1] += 4.0
    rollout = rollout_of({"av": AV, "b": swerve})
    whole, short = case_of(), with_log_until(case_of(), 41)
    for name in ("path_sspd", "path_hausdorff"):
        metric = plugins.load("metrics", name)
        assert metric.measure(rollout, short).value == pytest.approx(1.0, abs=1e-9)
        assert metric.measure(rollout, whole).value > 2.0
    found = naturalness.samples(rollout, short, smooth=False)
    assert len(found.attack) == len(found.unattacked) == 30 - 2
    assert len(naturalness.samples(rollout, whole, smooth=False).attack) == 80 - 2
    none = plugins.load("metrics", "path_sspd").measure(rollout, with_log_until(short, 13))
    assert none.reason == _slices.TOO_SHORT


def with_log_until(case, step):
    """The case, whose recording loses sight of the opponent at a step."""
    tracks = case.scene.tracks
    valid = tracks.valid.copy()
    valid[tracks.row("b"), step:] = False
    scene = dataclasses.replace(case.scene, tracks=dataclasses.replace(tracks, valid=valid))
    return dataclasses.replace(case, scene=scene)


def test_pooled_naturalness():
    rng = np.random.default_rng(0)
    runs = [AccelerationSamples(rng.normal(0, 1, 80), rng.normal(0, 1, 80)) for _ in range(60)]
    same = pooled(runs)
    assert (same.runs, same.attack_samples, same.recorded_samples) == (60, 4800, 4800)
    every = [np.concatenate(side) for side in zip(*runs, strict=True)]
    assert same.wasserstein == pytest.approx(scipy.stats.wasserstein_distance(*every))
    histograms = [histogram(side, 201) for side in every]
    assert same.kl == pytest.approx(scipy.stats.entropy(*histograms))
    assert same.kl_reverse == pytest.approx(scipy.stats.entropy(*histograms[::-1]))
    harder = pooled([AccelerationSamples(run.attack * 3, run.unattacked) for run in runs])
    assert harder.jsd > 2 * same.jsd
    assert harder.wasserstein > 1.0
    assert pooled([]) is None
