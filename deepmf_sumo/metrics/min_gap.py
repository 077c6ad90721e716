"""Least distance of the boxes of AV and opponent after the current step."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.geometry import boxes
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m"
BETTER: Better = "lower"
_QUANTITY = Quantity("min_gap", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    av, steps = parts.together(rollout, row)
    if not steps.any():
        return _QUANTITY.missing("AV and opponent were never there together")
    tracks = rollout.tracks
    gaps = boxes.gap(
        tracks.position_m[av, steps],
        tracks.heading_rad[av, steps],
        tracks.size_m[av, :2],
        tracks.position_m[row, steps],
        tracks.heading_rad[row, steps],
        tracks.size_m[row, :2],
    )
    return _QUANTITY.value(gaps.min())
