"""What a search minimises: an attack that misses, that no driver would drive, or that jerks.

After AdvSim (Wang et al., CVPR 2021), whose cost of the planner is here the distance to the AV.
Limits of speed, acceleration and curvature need no term: the bicycle keeps them.
"""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, Case, Floats, Rollout
from deepmf_sumo.geometry import boxes, road
from deepmf_sumo.geometry.ground import distance_m

_FAR_M = 100.0
"""Distance to an AV or an opponent that was gone before the first step."""


class Weights(plugins.Settings):
    """Weights of the terms, added in metres of distance to the AV.

    Attributes:
        late: of a contact after 8 s, in proportion before.
        off_road: of an opponent that is off the road all the time, in proportion to the share.
        third_party: of a contact of the opponent with somebody else.
        jerk: of a mean square of 1 (m/s3)^2.
    """

    late: float = 0.1
    off_road: float = 1.0
    third_party: float = 1.0
    jerk: float = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """Terms of one rollout, weighted; ``distance`` is 0 at a contact."""

    distance: float
    late: float
    off_road: float
    third_party: float
    jerk: float

    @property
    def total(self) -> float:
        """What is minimised."""
        return self.distance + self.late + self.off_road + self.third_party + self.jerk


def cost_of(rollout: Rollout, case: Case, weights: Weights) -> Cost:
    """The cost of an attack that was simulated.

    It is judged up to the end of the episode, which is the contact where there is one.
    """
    tracks, first = rollout.tracks, rollout.now + 1
    opponent = tracks.row(str(rollout.opponent_id))
    there = tracks.valid[opponent, first:]
    path = tracks.position_m[opponent, first:][there]
    hit = rollout.first("av_opponent")
    late = 1.0 if hit is None else (hit.step - rollout.now) / FUTURE_STEPS
    heights = tracks.z_m[opponent, first:][there]
    off_road = 1 - road.on_road(case.road, path, heights).mean() if len(path) else 0.0
    return Cost(
        distance=nearest_m(rollout),
        late=weights.late * late,
        off_road=weights.off_road * float(off_road),
        third_party=weights.third_party * (rollout.first("opponent_other") is not None),
        jerk=weights.jerk * _mean_square_jerk(path),
    )


def nearest_m(rollout: Rollout) -> float:
    """Smallest distance between the boxes of AV and opponent after now, metres; 0 at a contact.

    100 m where one of them was gone before the first step.
    """
    if rollout.first("av_opponent") is not None:
        return 0.0
    tracks, after = rollout.tracks, slice(rollout.now + 1, None)
    av, opponent = tracks.row(rollout.av_id), tracks.row(str(rollout.opponent_id))
    both = tracks.valid[av, after] & tracks.valid[opponent, after]
    if not both.any():
        return _FAR_M
    (centre_a, heading_a), (centre_b, heading_b) = (
        (tracks.position_m[row, after][both], tracks.heading_rad[row, after][both])
        for row in (av, opponent)
    )
    sizes = tracks.size_m[:, :2]
    gap = boxes.gap(centre_a, heading_a, sizes[av], centre_b, heading_b, sizes[opponent])
    heights = (tracks.z_m[row, after][both] for row in (av, opponent))
    return float(distance_m(gap, *heights).min())


def _mean_square_jerk(path_m: Floats) -> float:
    """Mean square of the third difference of a path (T, 2), (m/s3)^2; 0 for fewer than four."""
    if len(path_m) < 4:
        return 0.0
    jerk = np.diff(path_m, n=3, axis=0) / DT_S**3
    return float((jerk**2).sum(-1).mean())
