"""Naturalness of the motion: compared with the same vehicle without the attack, and by itself.

Without the attack it moves as recorded, or as in the same episode of a network's traffic.

Accelerations are signed changes of speed. Raw ones are 10 Hz differences, as for the paper's
figures: noise of a centimetre adds 1 m/s2 or more, and the noise of recordings alone gives a KL
divergence of about 1. Compare adversaries, not absolute values. Smooth ones use the same filter on
both sides (Savitzky, Golay: Analytical Chemistry 36, 1964). Distances of paths ignore time (SSPD:
Besse et al., T-ITS 17, 2016).

The formulas use numpy instead of scipy: importing ``scipy.stats`` and ``scipy.signal`` takes longer
than an episode. The tests compare them with scipy.
"""

import functools
from typing import NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric, once
from deepmf_sumo.scene import Case, Floats, RecordedCase, Rollout
from deepmf_sumo.scene.geometry import polylines

WINDOW = 11
_ORDER = 2
LIMIT_MPS2 = 10.0
"""Centres of the end bins, which include all values outside."""
BINS = 21
"""Bins of one run's histograms, 1 m/s2 wide, from -10.5 to 10.5. An odd number puts a bin around 0:
most samples of slow cars lie there, and an edge at 0 would sort them by the sign of their noise."""
_PSEUDO_COUNT = 1e-10
TOO_SHORT_TO_SMOOTH = f"fewer than {WINDOW + 1} steps in a row with and without the attack"


class AccelerationSamples(NamedTuple):
    """Signed changes of speed in m/s2: of the attack (N), and without it (N)."""

    attack: Floats
    unattacked: Floats


def samples(rollout: Rollout, case: Case, *, smooth: bool) -> AccelerationSamples:
    """The opponent's changes of speed over the planned 8 s, and without the attack.

    Only at steps that both have. Raises NotMeasurable if there are none.
    """
    stretches = _slices.compared_stretches(rollout, case, beyond=True)
    change = smooth_changes if smooth else speed_changes
    sides = zip(*stretches, strict=True) if stretches else ([], [])
    found = AccelerationSamples(
        *(
            np.concatenate([np.empty(0), *(change(one, rollout.dt_s) for one in side)])
            for side in sides
        )
    )
    if len(found.attack) and len(found.unattacked):
        return found
    raise NotMeasurable(TOO_SHORT_TO_SMOOTH if smooth else _slices.TOO_SHORT)


def speed_changes(path_m: Floats, dt_s: float) -> Floats:
    """(K - 2) signed changes of speed along a path (K, 2) with a point every ``dt_s``."""
    changes: Floats = np.diff(_speed(path_m, dt_s)) / dt_s
    return changes


def smooth_changes(path_m: Floats, dt_s: float) -> Floats:
    """(K - 1) filtered changes of speed along a path (K, 2); empty if it is too short."""
    speed = _speed(path_m, dt_s)
    return derivative(speed, dt_s) if len(speed) >= WINDOW else np.empty(0)


def _speed(path_m: Floats, dt_s: float) -> Floats:
    speed: Floats = np.hypot(*np.diff(path_m, axis=0).T) / dt_s
    return speed


def derivative(values: Floats, dt_s: float) -> Floats:
    """(K) first derivative of samples (K), K >= `WINDOW`: slope of the parabola through 11 of them.

    The five samples at each end lie on the parabola of the first and of the last window.
    """
    values = np.asarray(values, float)
    half = WINDOW // 2
    slopes = _slopes()
    windows = np.lib.stride_tricks.sliding_window_view(values, WINDOW)
    inner = windows @ slopes[half]
    first, last = slopes[:half] @ windows[0], slopes[half + 1 :] @ windows[-1]
    rates: Floats = np.concatenate([first, inner, last]) / dt_s
    return rates


@functools.cache
def _slopes() -> Floats:
    """(WINDOW, WINDOW) row i: weights of the samples in the parabola's slope at sample i."""
    at = np.arange(WINDOW, dtype=float) - WINDOW // 2
    fit = np.linalg.pinv(np.vander(at, _ORDER + 1, increasing=True))
    slopes: Floats = fit[1] + 2 * at[:, None] * fit[2]
    return slopes


def wasserstein(a: Floats, b: Floats) -> float:
    """First Wasserstein distance of two samples: area between their distribution functions."""
    a, b = np.sort(a), np.sort(b)
    both = np.sort(np.concatenate([a, b]))
    below = [np.searchsorted(sample, both[:-1], "right") / len(sample) for sample in (a, b)]
    return float((np.abs(below[0] - below[1]) * np.diff(both)).sum())


def divergence(a: Floats, b: Floats, bins: int = BINS) -> float:
    """KL(a || b) in nats of histograms of two samples, 1e-10 added to each count."""
    p, q = shares(a, bins), shares(b, bins)
    return float((p * np.log(p / q)).sum())


def jensen_shannon(a: Floats, b: Floats, bins: int = BINS) -> float:
    """Jensen-Shannon divergence in nats, 0..log 2, of histograms of two samples."""
    p, q = shares(a, bins), shares(b, bins)
    middle = (p + q) / 2
    return float((p * np.log(p / middle) + q * np.log(q / middle)).sum() / 2)


def shares(sample: Floats, bins: int) -> Floats:
    """(bins) relative frequencies, all positive; the end bins are centred on -10 and 10 m/s2."""
    inside = np.clip(sample, -LIMIT_MPS2, LIMIT_MPS2)
    end = LIMIT_MPS2 * bins / (bins - 1)
    count = np.histogram(inside, bins, (-end, end))[0] + _PSEUDO_COUNT
    frequency: Floats = count / count.sum()
    return frequency


class Paths(NamedTuple):
    """The opponent's path (K, 2) and that without the attack (K, 2), at least three points."""

    attack: Floats
    unattacked: Floats


def paths(rollout: Rollout, case: Case, *, until_contact: bool) -> Paths:
    """The two paths over the steps that both have.

    The attack is what the policy drove and, unless ``until_contact``, its last plan after the end.
    Raises NotMeasurable if there are fewer than three steps.
    """
    stretches = _slices.compared_stretches(rollout, case, beyond=not until_contact)
    if sum(len(one.attack_m) for one in stretches) < 3:
        raise NotMeasurable(_slices.TOO_SHORT)
    attack, unattacked = (np.concatenate(side) for side in zip(*stretches, strict=True))
    return Paths(attack, unattacked)


def directed(points_m: Floats, path_m: Floats) -> Floats:
    """(N) distances of points (N, 2) to a path (P, 2), P >= 2, as a polyline."""
    distance: Floats = polylines.project(path_m, points_m).distance_m
    return distance


def symmetric_mean(a_m: Floats, b_m: Floats) -> float:
    """Symmetrised segment-path distance: mean of the two mean directed distances."""
    return float((directed(a_m, b_m).mean() + directed(b_m, a_m).mean()) / 2)


def hausdorff(a_m: Floats, b_m: Floats) -> float:
    """The larger of the two greatest directed distances."""
    return float(np.maximum(directed(a_m, b_m).max(), directed(b_m, a_m).max()))


@once
def _raw(episode: Episode) -> AccelerationSamples:
    return samples(episode.rollout, episode.case, smooth=False)


@once
def _smooth(episode: Episode) -> AccelerationSamples:
    return samples(episode.rollout, episode.case, smooth=True)


@once
def _whole(episode: Episode) -> Paths:
    return paths(episode.rollout, episode.case, until_contact=False)


@once
def _cut(episode: Episode) -> Paths:
    return paths(episode.rollout, episode.case, until_contact=True)


@metric("nat", better="lower")
def acceleration_kl(episode: Episode) -> float:
    """Signed change of the opponent's speed over the planned 8 s against that without the attack,
    at the steps that both have, raw 10 Hz differences: KL(attack || without), 21 bins of 1 m/s2 on
    [-10.5, 10.5], values outside in the end bins, 1e-10 added to each count.
    """
    found = _raw(episode)
    return divergence(found.attack, found.unattacked)


@metric("nat", better="lower")
def acceleration_kl_reverse(episode: Episode) -> float:
    """Signed change of the opponent's speed over the planned 8 s against that without the attack,
    at the steps that both have, raw 10 Hz differences: KL(without || attack), 21 bins of 1 m/s2 on
    [-10.5, 10.5], values outside in the end bins, 1e-10 added to each count.
    """
    found = _raw(episode)
    return divergence(found.unattacked, found.attack)


@metric("nat", better="lower")
def acceleration_kl_smooth(episode: Episode) -> float:
    """Signed change of the opponent's speed over the planned 8 s against that without the attack,
    at the steps that both have, Savitzky-Golay filtered (11 samples, order 2) on both sides:
    KL(attack || without), 21 bins of 1 m/s2 on [-10.5, 10.5], values outside in the end bins, 1e-10
    added to each count.
    """
    found = _smooth(episode)
    return divergence(found.attack, found.unattacked)


@metric("nat", better="lower")
def acceleration_jsd_smooth(episode: Episode) -> float:
    """Signed change of the opponent's speed over the planned 8 s against that without the attack,
    at the steps that both have, Savitzky-Golay filtered (11 samples, order 2) on both sides:
    Jensen-Shannon divergence (0 to 0.693), 21 bins of 1 m/s2 on [-10.5, 10.5], values outside in
    the end bins, 1e-10 added to each count.
    """
    found = _smooth(episode)
    return jensen_shannon(found.attack, found.unattacked)


@metric("m/s2", better="lower")
def acceleration_wasserstein(episode: Episode) -> float:
    """Signed change of the opponent's speed over the planned 8 s against that without the attack,
    at the steps that both have, raw 10 Hz differences: first Wasserstein distance of the two
    samples.
    """
    return wasserstein(*_raw(episode))


@metric("m/s2", better="lower")
def acceleration_wasserstein_smooth(episode: Episode) -> float:
    """Signed change of the opponent's speed over the planned 8 s against that without the attack,
    at the steps that both have, Savitzky-Golay filtered (11 samples, order 2) on both sides: first
    Wasserstein distance of the two samples.
    """
    return wasserstein(*_smooth(episode))


@metric("m", better="lower")
def path_sspd(episode: Episode) -> float:
    """The opponent's planned path of 8 s (after a contact its last plan goes on) against its path
    without the attack over the same steps, without regard to time: mean of the two mean distances
    of points to the other polyline.
    """
    return symmetric_mean(*_whole(episode))


@metric("m", better="lower")
def path_sspd_cut(episode: Episode) -> float:
    """The opponent's path until the contact (or the end) against its path without the attack over
    the same steps, without regard to time: mean of the two mean distances of points to the other
    polyline.
    """
    return symmetric_mean(*_cut(episode))


@metric("m", better="lower")
def path_hausdorff(episode: Episode) -> float:
    """The opponent's planned path of 8 s (after a contact its last plan goes on) against its path
    without the attack over the same steps, without regard to time: largest distance of a point to
    the other polyline, both ways.
    """
    return hausdorff(*_whole(episode))


@metric("m", better="lower")
def path_hausdorff_cut(episode: Episode) -> float:
    """The opponent's path until the contact (or the end) against its path without the attack over
    the same steps, without regard to time: largest distance of a point to the other polyline, both
    ways.
    """
    return hausdorff(*_cut(episode))


@metric("m/s2", better="lower")
def opponent_rms_acceleration(episode: Episode) -> float:
    """Root mean square of the opponent's acceleration along its motion (second differences over 0.2
    s) while the policy drives it.
    """
    rollout = episode.rollout
    row, steps = _slices.driving(rollout)
    position, heading = rollout.tracks.position_m[row], rollout.tracks.heading_rad[row]
    along = np.concatenate(
        [
            _slices.accelerations(position[run], heading[run], rollout.dt_s).along
            for run in _slices.runs(steps)
        ]
    )
    if len(along) == 0:
        raise NotMeasurable("the policy drove fewer than five steps in a row")
    return float(np.sqrt(np.mean(along**2)))


@metric("m", better="neither")
def av_ade(episode: Episode) -> float:
    """Mean distance of the AV's centre to that of its recording at the same time, over the
    simulated steps at which the recording has it.
    """
    rollout, case = episode.rollout, episode.case
    if not isinstance(case, RecordedCase):
        raise NotMeasurable(_slices.NO_LOG)
    scene = case.scene
    row, logged = rollout.tracks.row(rollout.av_id), scene.tracks.row(scene.av_id)
    count = min(rollout.tracks.steps - rollout.now, scene.tracks.steps - scene.now)
    here = slice(rollout.now + 1, rollout.now + count)
    there = slice(scene.now + 1, scene.now + count)
    both = rollout.tracks.valid[row, here] & scene.tracks.valid[logged, there]
    if not both.any():
        raise NotMeasurable("the recording does not contain the AV during the simulated steps")
    away = rollout.tracks.position_m[row, here] - scene.tracks.position_m[logged, there]
    return float(np.hypot(*away[both].T).mean())
