"""Hausdorff distance of the opponent's planned path to its recording."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts, paths
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m"
BETTER: Better = "lower"
_QUANTITY = Quantity("path_hausdorff", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    logged = parts.logged_path(case, rollout.tracks.ids[row])
    if logged is None:
        return _QUANTITY.missing(parts.NO_LOG)
    path = parts.planned_path(rollout, row, case.duration_steps)
    if len(path) < 3:
        return _QUANTITY.missing(parts.NEVER_DRIVEN)
    return _QUANTITY.value(paths.hausdorff(path, logged))
