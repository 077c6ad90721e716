"""Number of the kind of collision of AV and opponent; `episode.accident` has the names.

Numbers of names: count them, do not average them.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import accident, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "number"
BETTER: Better = "neither"
DEFINITION = (
    "0 cut-in, 1 rear-end, 2 T-bone, 3 head-on, 4 sideswipe: ends (front or rear) or sides of the "
    "AV meet the other; headings parallel within 45 degrees (sides: 30), else a T-bone; ends: "
    "rear-end or head-on, sides: sideswipe; cut-in: a rear-end collision whose one in front was "
    "wholly beside the way of the other within 3 s before"
)
_QUANTITY = Quantity("accident_type", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = accident.accident_type(rollout, case)
    if found is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    return _QUANTITY.value(accident.ACCIDENT_TYPES.index(found))
