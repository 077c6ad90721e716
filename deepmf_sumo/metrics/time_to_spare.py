"""Least time that the AV's encounters left before they would have been contacts.

Of everybody whose way crosses or joins the AV's, not of the opponent alone: how an attack disturbs
a junction shows in all of them. After the two measures of conflicts of Gettman et al. (FHWA-HRT-
08-051, 2008): post-encroachment time where ways cross, time to collision where they join.
"""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import encounters, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "lower"
DEFINITION = (
    "least post-encroachment time of the AV and a vehicle whose way crosses its own (by more than "
    "30 degrees), or time to collision with one that comes into its lane or into whose lane it "
    "comes (4 s before to now), over all vehicles; 0 in contact"
)
_QUANTITY = Quantity("time_to_spare", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    if rollout.opponent_id is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    tracks = rollout.tracks
    av = _trip(rollout, tracks.row(rollout.av_id))
    if len(av.step) == 0:
        return _QUANTITY.missing("the AV was gone at once")
    others = [
        _trip(rollout, row)
        for row, (agent_id, kind) in enumerate(zip(tracks.ids, tracks.kinds, strict=True))
        if kind == "vehicle" and agent_id != rollout.av_id
    ]
    spare = [
        encounters.time_to_spare(av, other, rollout.dt_s) for other in others if len(other.step)
    ]
    least = min(spare, default=np.inf)
    if np.isinf(least):
        return _QUANTITY.missing("nobody's way crossed or joined the AV's")
    return _QUANTITY.value(least)


def _trip(rollout: Rollout, row: int) -> encounters.Trip:
    """From the current step on."""
    tracks = rollout.tracks
    step = np.flatnonzero(tracks.valid[row])
    step = step[step >= rollout.now]
    return encounters.Trip(
        step=step,
        position_m=tracks.position_m[row, step],
        heading_rad=tracks.heading_rad[row, step],
        speed_mps=np.hypot(*tracks.velocity_mps[row, step].T),
        size_m=tracks.size_m[row, :2],
        z_m=tracks.z_m[row, step],
    )
