"""Grade of the contact: 0 for A, unavoidable, to 3 for D, avoided by every reference driver."""

from deepmf_sumo.avoidance.grading import GRADES
from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.judgement import judgement
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "neither"
DEFINITION = (
    "of contacts: 0 A unavoidable, 1 B avoided by some braking or steering without delay but "
    "by no reference driver, 2 C avoided by some of the reference drivers, 3 D avoided by all"
)
_QUANTITY = Quantity("avoidance_grade", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = judgement(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(GRADES.index(found.grade))
