"""Whether AV and opponent collided: 1 or 0; its mean is the collision rate."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "1 where the boxes of AV and opponent overlap at a simulated step, else 0; its mean is the "
    "collision rate"
)
_QUANTITY = Quantity("collision", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    return _QUANTITY.value(rollout.first("av_opponent") is not None)
