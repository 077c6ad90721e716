"""Hardest braking of the AV after the current step, from speeds 0.2 s apart; 0 without any."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s2"
BETTER: Better = "higher"
DEFINITION = (
    "hardest braking of the AV after the current step, from speeds 0.2 s apart; 0 without any"
)
_QUANTITY = Quantity("planner_hardest_braking", UNIT, BETTER)
_STEPS = 2


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = rollout.tracks.row(rollout.av_id)
    steps = np.flatnonzero(rollout.tracks.valid[row])
    speed = rollout.tracks.speed_mps[row, steps[steps >= rollout.now]]
    if len(speed) <= _STEPS:
        return _QUANTITY.missing("the AV was there for fewer than three steps")
    braking = (speed[:-_STEPS] - speed[_STEPS:]) / (_STEPS * rollout.dt_s)
    return _QUANTITY.value(max(0.0, braking.max()))
