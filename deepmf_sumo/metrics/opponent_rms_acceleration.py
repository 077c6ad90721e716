"""RMS of the opponent's acceleration along its motion while the policy drove it."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import motion, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s2"
BETTER: Better = "lower"
DEFINITION = (
    "root mean square of the opponent's acceleration along its motion (second differences over "
    "0.2 s) while the policy drives it"
)
_QUANTITY = Quantity("opponent_rms_acceleration", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = parts.driving(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    row, steps = found
    position, heading = rollout.tracks.position_m[row], rollout.tracks.heading_rad[row]
    along = np.concatenate(
        [
            motion.accelerations(position[run], heading[run], rollout.dt_s).along
            for run in motion.runs(steps)
        ]
    )
    if len(along) == 0:
        return _QUANTITY.missing("the policy drove fewer than five steps in a row")
    return _QUANTITY.value(np.sqrt(np.mean(along**2)))
