"""Principal direction of force on the AV in its collision with the opponent."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.geometry import angles
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "rad"
BETTER: Better = "neither"
DEFINITION = (
    "direction from which the force of the impact comes, in the frame of the AV (0 from ahead, "
    "pi/2 from the left): that of its velocity relative to the opponent at the last step before "
    "the contact"
)
_QUANTITY = Quantity("pdof", UNIT, BETTER)
_LEAST_MPS = 1e-6


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    tracks, step = rollout.tracks, contact.step - 1
    velocity = tracks.velocity_mps[:, step]
    av, other = tracks.row(contact.first_id), tracks.row(contact.second_id)
    x, y = velocity[av] - velocity[other]
    if np.hypot(x, y) < _LEAST_MPS:
        return _QUANTITY.missing("AV and opponent touched without relative speed")
    force = float(np.arctan2(y, x))
    return _QUANTITY.value(float(angles.difference(force, tracks.heading_rad[av, step])))
