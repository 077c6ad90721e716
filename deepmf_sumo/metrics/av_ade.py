"""Mean distance of the AV to its own recording at the same time, after the current step."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m"
BETTER: Better = "neither"
DEFINITION = (
    "mean distance of the AV's centre to that of its recording at the same time, over the "
    "simulated steps at which the recording has it"
)
_QUANTITY = Quantity("av_ade", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    scene = case.scene
    if scene is None:
        return _QUANTITY.missing(parts.NO_LOG)
    row, logged = rollout.tracks.row(rollout.av_id), scene.tracks.row(scene.av_id)
    count = min(rollout.tracks.steps - rollout.now, scene.tracks.steps - scene.now)
    here = slice(rollout.now + 1, rollout.now + count)
    there = slice(scene.now + 1, scene.now + count)
    both = rollout.tracks.valid[row, here] & scene.tracks.valid[logged, there]
    if not both.any():
        return _QUANTITY.missing("the recording does not have the AV while it was simulated")
    away = rollout.tracks.position_m[row, here] - scene.tracks.position_m[logged, there]
    return _QUANTITY.value(np.hypot(*away[both].T).mean())
