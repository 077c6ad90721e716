"""Whether AV and opponent collided, and neither of them with anybody else before: 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "1 where AV and opponent collide and neither of them had a contact with anybody else before, "
    "else 0"
)
_QUANTITY = Quantity("collision_clean", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    hit = rollout.first("av_opponent")
    before = hit and [contact for contact in rollout.contacts if contact.step < hit.step]
    return _QUANTITY.value(hit is not None and not before)
