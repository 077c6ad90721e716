"""Whether a car can drive as the opponent did while the policy drove it: 1 or 0.

Cars neither accelerate nor steer beyond limits, nor slide sideways. Of 241 recorded cars 240 steer
and slide within these limits; the limits of acceleration are those of dry roads.
"""

import numpy as np

from deepmf_sumo.datatypes import Bools, Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import motion, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "1 where, at every step driven by the policy, the opponent's acceleration (second differences "
    "over 0.2 s) is at most 8 m/s2 along and 5 m/s2 across its motion, it turns by at most 0.3 "
    "rad a metre (and 0.1 rad) and moves within 30 degrees of its heading (above 2 m/s; over 0.4 "
    "s), and each pose is at most 0.14 m from where the state before leads, else 0"
)
_QUANTITY = Quantity("feasible", UNIT, BETTER)
_ALONG_MPS2, _ACROSS_MPS2 = 8.0, 5.0
_CURVATURE, _TURN_NOISE_RAD = 0.3, 0.1  # turning circles are at least 3.3 m in radius
_SIDEWAYS, _MOVING_MPS = 0.5, 2.0  # sine of 30 degrees; slower motion has no sure direction
_NOISE_M = (
    0.1  # what states may be wrong by: the measured one before the first driven pose, most of all
)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = parts.driving(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    row, steps = found
    if not _follows(rollout, row, steps).all():
        return _QUANTITY.value(0.0)
    tracks = rollout.tracks
    for run in motion.runs(steps):
        poses = tracks.position_m[row, run], tracks.heading_rad[row, run], rollout.dt_s
        along, across = motion.accelerations(*poses)
        if (np.abs(along) > _ALONG_MPS2).any() or (np.abs(across) > _ACROSS_MPS2).any():
            return _QUANTITY.value(0.0)
        way = motion.steering(*poses)
        slides = (way.sideways > _SIDEWAYS) & (way.speed_mps > _MOVING_MPS)
        if slides.any() or (way.turn_rad > _CURVATURE * way.way_m + _TURN_NOISE_RAD).any():
            return _QUANTITY.value(0.0)
    return _QUANTITY.value(1.0)


def _follows(rollout: Rollout, row: int, steps: Bools) -> Bools:
    """(K) whether the poses of some steps (T) follow from the states one step before them.

    Differences over 0.2 s see neither a run of fewer than five poses nor a jump to and fro.
    """
    tracks, at = rollout.tracks, np.flatnonzero(steps)
    before = np.maximum(at - 1, 0)
    moved = tracks.position_m[row, at] - tracks.position_m[row, before]
    missed = np.hypot(*(moved - tracks.velocity_mps[row, before] * rollout.dt_s).T)
    allowed = _ALONG_MPS2 * rollout.dt_s**2 / 2 + _NOISE_M
    return np.asarray((missed <= allowed) | ~tracks.valid[row, before])
