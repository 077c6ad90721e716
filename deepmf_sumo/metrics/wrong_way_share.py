"""Share of the policy-driven steps at which the opponent drives against the traffic."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.geometry import road
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "lower"
DEFINITION = (
    "share of the steps driven by the policy at which the opponent is on the road, moves faster "
    "than 1 m/s, and every lane there (half a width and 0.5 m around its centre line) runs more "
    "than 120 degrees off its direction of motion"
)
_QUANTITY = Quantity("wrong_way_share", UNIT, BETTER)
_MOVING_MPS = 1.0


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = parts.driving(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    row, steps = found
    velocity = rollout.tracks.velocity_mps[row, steps]
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    position_m, z_m = parts.places(rollout, found)
    against = road.against_traffic(case.road, position_m, course, z_m)
    return _QUANTITY.value((against & (np.hypot(*velocity.T) > _MOVING_MPS)).mean())
