"""Whether the attack is worth something: a collision that is possible, lawful in space, avoidable.

1 if AV and opponent collided and neither had touched anybody else before, the opponent drove within
the limits of a car (`feasible`) and, once on the road, did not leave it before the contact, and a
reference driver would have avoided the contact (`avoidable`). Else 0, also where they did not
collide: the mean is a rate over attacked scenes, like that of `collision`.
"""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.geometry import road
from deepmf_sumo.metrics import collision_clean, feasible
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.judgement import judgement
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "1 if AV and opponent collided, neither hit anybody else before, the opponent drove within "
    "the limits of a car and did not leave the road, and a reference driver would have avoided "
    "the collision; else 0"
)
_QUANTITY = Quantity("valid_collision", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    if not collision_clean.measure(rollout, case).value:
        return _QUANTITY.value(0.0)
    found = judgement(rollout, case)
    avoidable = not isinstance(found, str) and found.avoidable
    # an opponent that the policy never drove did what it would have done: nothing to check
    possible = feasible.measure(rollout, case).value != 0.0
    return _QUANTITY.value(avoidable and possible and not _leaves_road(rollout, case, row))


def _leaves_road(rollout: Rollout, case: Case, row: int) -> bool:
    """Whether the opponent is off the road after it has been on it, while the policy drives it."""
    driven = parts.driven(rollout, row)
    inside = road.on_road(case.road, *parts.places(rollout, (row, driven)))
    return bool((~inside & np.maximum.accumulate(inside)).any())
