"""Share of the policy-driven steps at which the opponent's centre is off the road.

The complement of ``on_road``. Human drivers do not reach 0 everywhere: driveways and car parks have
no lanes.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.geometry import road
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "lower"
DEFINITION = (
    "share of the steps driven by the policy at which the centre of the opponent is farther than "
    "half a width (3.7 m where unknown) and 0.5 m from the centre line of every lane for cars"
)
_QUANTITY = Quantity("offroad_share", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = parts.driving(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    inside = road.on_road(case.road, *parts.places(rollout, found))
    return _QUANTITY.value(1.0 - inside.mean())
