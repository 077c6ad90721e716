"""Share of the policy-driven steps at which the opponent's centre is on the road.

On the road: within half a lane's width (3.7 m where unknown) and 0.5 m of the centre line of a lane
for cars. Human drivers do not reach 1 everywhere: driveways and car parks have no lanes.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.geometry import road
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "share of the steps driven by the policy at which the opponent's centre is within half a "
    "width (3.7 m where unknown) and 0.5 m of the centre line of a lane for cars"
)
_QUANTITY = Quantity("on_road", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = parts.driving(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(road.on_road(case.road, *parts.places(rollout, found)).mean())
