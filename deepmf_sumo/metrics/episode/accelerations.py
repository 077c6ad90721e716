"""The opponent's changes of speed, and its recording's: what naturalness is judged by."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Case, Floats, Rollout
from deepmf_sumo.metrics.episode import parts, savitzky_golay

TOO_SHORT = f"fewer than {savitzky_golay.WINDOW + 1} steps in a row, both recorded and planned"


class Samples(NamedTuple):
    """Signed changes of speed in m/s2: of the attack (N), and of the recording (N)."""

    attack: Floats
    recorded: Floats


def compared(rollout: Rollout, case: Case, *, smooth: bool = False) -> Samples | str:
    """Samples of one rollout, or the reason why there are none.

    Over the steps of the planned 8 s that the recording has, too.

    Raw: 10 Hz differences, as the paper's figures ask for; noise of a centimetre makes 1 m/s2 and
    more of them. Smooth: the same Savitzky-Golay filter of 1.1 s on both sides.
    """
    row = parts.opponent_row(rollout)
    if row is None:
        return parts.NO_OPPONENT
    if not parts.is_recorded(case, rollout.tracks.ids[row]):
        return parts.NO_LOG
    if not parts.driven(rollout, row).any():
        return parts.NEVER_DRIVEN
    stretches = parts.compared_stretches(rollout, case, row, beyond=True)
    change = smooth_changes if smooth else speed_changes
    sides = zip(*stretches, strict=True) if stretches else ([], [])
    found = Samples(
        *(
            np.concatenate([np.empty(0), *(change(one, rollout.dt_s) for one in side)])
            for side in sides
        )
    )
    if len(found.attack) and len(found.recorded):
        return found
    return TOO_SHORT if smooth else parts.TOO_SHORT


def speed_changes(path_m: Floats, dt_s: float) -> Floats:
    """(K - 2) signed changes of speed along a path (K, 2) with a point every ``dt_s``."""
    changes: Floats = np.diff(_speed(path_m, dt_s)) / dt_s
    return changes


def smooth_changes(path_m: Floats, dt_s: float) -> Floats:
    """(K - 1) filtered changes of speed along a path (K, 2); empty where it is too short."""
    speed = _speed(path_m, dt_s)
    if len(speed) < savitzky_golay.WINDOW:
        return np.empty(0)
    return savitzky_golay.derivative(speed, dt_s)


def _speed(path_m: Floats, dt_s: float) -> Floats:
    speed: Floats = np.hypot(*np.diff(path_m, axis=0).T) / dt_s
    return speed
