"""Whether a car can drive as the opponent did while the policy drove it: 1 or 0.

Cars neither accelerate nor steer beyond limits, nor slide sideways. Of 241 recorded cars 240 steer
and slide within these limits; the limits of acceleration are those of dry roads.
"""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import motion, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "1 where, at every step driven by the policy, the opponent's acceleration (second differences "
    "over 0.2 s) is at most 8 m/s2 along and 5 m/s2 across its motion, it turns by at most 0.3 "
    "rad a metre (and 0.1 rad) and moves within 30 degrees of its heading (above 2 m/s; over 0.4 "
    "s), and its first pose follows from its last state, else 0"
)
_QUANTITY = Quantity("feasible", UNIT, BETTER)
_ALONG_MPS2, _ACROSS_MPS2 = 8.0, 5.0
_CURVATURE, _TURN_NOISE_RAD = 0.3, 0.1  # turning circles are at least 3.3 m in radius
_SIDEWAYS, _MOVING_MPS = 0.5, 2.0  # sine of 30 degrees; slower motion has no sure direction
_NOISE_M = 0.1  # what measured states before the first driven pose may be wrong by


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    steps = parts.driven(rollout, row)
    if not steps.any():
        return _QUANTITY.missing(parts.NEVER_DRIVEN)
    tracks = rollout.tracks
    for run in motion.runs(steps):
        if not _joins(rollout, row, run.start):
            return _QUANTITY.value(0.0)
        poses = tracks.position_m[row, run], tracks.heading_rad[row, run], rollout.dt_s
        along, across = motion.accelerations(*poses)
        if (np.abs(along) > _ALONG_MPS2).any() or (np.abs(across) > _ACROSS_MPS2).any():
            return _QUANTITY.value(0.0)
        way = motion.steering(*poses)
        slides = (way.sideways > _SIDEWAYS) & (way.speed_mps > _MOVING_MPS)
        if slides.any() or (way.turn_rad > _CURVATURE * way.way_m + _TURN_NOISE_RAD).any():
            return _QUANTITY.value(0.0)
    return _QUANTITY.value(1.0)


def _joins(rollout: Rollout, row: int, first: int) -> bool:
    """Whether one step from the state before leads to the first driven pose."""
    tracks = rollout.tracks
    if first == 0 or not tracks.valid[row, first - 1]:
        return True
    moved = tracks.position_m[row, first] - tracks.position_m[row, first - 1]
    expected = tracks.velocity_mps[row, first - 1] * rollout.dt_s
    allowed = _ALONG_MPS2 * rollout.dt_s**2 / 2 + _NOISE_M
    return bool(np.hypot(*(moved - expected)) <= allowed)
