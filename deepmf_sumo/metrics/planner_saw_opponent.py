"""Whether the AV's planner followed the opponent before their contact: 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import attention, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "neither"
DEFINITION = (
    "1 where, before a contact, the opponent was at some step whom the planner named, or the "
    "leader on its lanes of SUMO (within 100 m) for a planner that lets SUMO drive, else 0; "
    "vehicles that it yields to at junctions are no leaders"
)
_QUANTITY = Quantity("planner_saw_opponent", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    if parts.opponent_row(rollout) is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    seen = attention.steps_with_opponent(rollout)
    if seen is None:
        return _QUANTITY.missing(attention.BLIND)
    return _QUANTITY.value(bool(len(seen)))
