"""Difference of the speeds of AV and opponent at the last step before their contact."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s"
BETTER: Better = "higher"
DEFINITION = (
    "difference of the lengths of the velocities of AV and opponent at the last step before their "
    "contact (the other reading of the paper's relative velocity)"
)
_QUANTITY = Quantity("collision_speed_difference", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    tracks = rollout.tracks
    pair = [tracks.row(contact.first_id), tracks.row(contact.second_id)]
    first, second = tracks.speed_mps[pair, contact.step - 1]
    return _QUANTITY.value(abs(first - second))
