"""KL divergence of the opponent's accelerations from its recording's.

Of the signed change of speed (10 Hz differences, as measured) over the planned 8 s: KL(planned ||
recorded) over 20 bins of 1 m/s2 on [-10, 10], values outside in the end bins, 1e-10 added to each.
The noise of recordings alone gives about 1: compare adversaries, not absolute values.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import distributions, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "nat"
BETTER: Better = "lower"
_QUANTITY = Quantity("acceleration_kl", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    logged = distributions.speed_changes_of(
        parts.logged_stretches(case, rollout.tracks.ids[row]), rollout.dt_s
    )
    if len(logged) == 0:
        return _QUANTITY.missing(parts.NO_LOG)
    path = parts.planned_path(rollout, row, case.duration_steps)
    if len(path) < 3:
        return _QUANTITY.missing(parts.NEVER_DRIVEN)
    return _QUANTITY.value(
        distributions.divergence(distributions.speed_changes(path, rollout.dt_s), logged)
    )
