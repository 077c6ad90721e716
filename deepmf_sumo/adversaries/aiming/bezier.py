"""Cubic Bezier curves from an opponent's motion into the AV's."""

import numpy as np

from deepmf_sumo.datatypes import Floats


def curve_into(start_m: Floats, own_m: Floats, av_m: Floats, meeting_steps: int) -> Floats:
    """(K, 2) a curve that is where the AV is at the meeting step, and stays with the AV then.

    Control points are the opponent's position now and after a third of the time, the AV's after
    two thirds and at the meeting. ``start_m`` (2) is now; ``own_m`` and ``av_m`` (K, 2) are what
    both do un-attacked from the next step on; ``meeting_steps`` lies in 1..K. The parameter runs
    with time.
    """
    third = max(meeting_steps // 3, 1)
    control = np.stack(
        [start_m, own_m[third - 1], av_m[meeting_steps - third - 1], av_m[meeting_steps - 1]]
    )
    share = np.arange(1, meeting_steps + 1)[:, None] / meeting_steps
    rest = 1 - share
    weight = np.concatenate([rest**3, 3 * rest**2 * share, 3 * rest * share**2, share**3], axis=1)
    return np.concatenate([weight @ control, av_m[meeting_steps:]])
