"""Hausdorff distance of the opponent's planned path to its recording."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import paths
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m"
BETTER: Better = "lower"
DEFINITION = (
    "the opponent's planned path of 8 s (after a contact its last plan goes on) against its "
    "recorded path over the same steps, without regard to time: largest distance of a point to the "
    "other polyline, both ways"
)
_QUANTITY = Quantity("path_hausdorff", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = paths.compared(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(paths.hausdorff(*found))
