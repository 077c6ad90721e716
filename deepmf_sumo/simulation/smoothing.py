"""SUMO's motion as a tracker would have recorded it: smooth, with velocities that fit."""

import numpy as np

from deepmf_sumo.datatypes import DT_S, Bools, Floats, Tracks
from deepmf_sumo.geometry import angles

_HALF_WINDOW = 5
_WEIGHTS = (_HALF_WINDOW + 1.0 - np.abs(np.arange(-_HALF_WINDOW, _HALF_WINDOW + 1))) / 36.0
"""A triangle of 1.1 s. SUMO's vehicles turn where two lanes meet at an angle: at once."""
_JUMP_MPS = 70.0
"""Nobody drives so fast: SUMO has teleported the vehicle."""
_FINEST = 1024.0
"""Motion is rounded to 1/1024 m, m/s and rad: finer than any tracker, and files are half as big."""


def smooth(tracks: Tracks) -> Tracks:
    """The same motion smoothed: bumpers, headings, and of them centres and their velocities.

    A track ends where SUMO teleports its vehicle.
    """
    half = tracks.size_m[:, None, :1] / 2
    front = tracks.position_m + half * angles.unit(tracks.heading_rad)
    valid = _until_jump(front, tracks.valid)
    heading = np.zeros_like(tracks.heading_rad)
    position = np.zeros_like(tracks.position_m)
    velocity = np.zeros_like(tracks.velocity_mps)
    for row in range(tracks.agents):
        for run in _runs(valid[row]):
            heading[row, run] = angles.wrap(_mean(np.unwrap(tracks.heading_rad[row, run])))
            bumper = np.stack([_mean(axis) for axis in front[row, run].T], axis=-1)
            position[row, run] = bumper - half[row] * angles.unit(heading[row, run])
            # one step alone has no difference; then SUMO's speed stands
            if run.stop - run.start > 1:
                velocity[row, run] = np.gradient(position[row, run], DT_S, axis=0)
            else:
                velocity[row, run] = tracks.velocity_mps[row, run]
    return Tracks(
        ids=tracks.ids,
        kinds=tracks.kinds,
        size_m=tracks.size_m,
        position_m=np.round(position * _FINEST) / _FINEST,
        z_m=tracks.z_m,
        heading_rad=np.round(heading * _FINEST) / _FINEST,
        velocity_mps=np.round(velocity * _FINEST) / _FINEST,
        valid=valid,
    )


def _until_jump(position: Floats, valid: Bools) -> Bools:
    both = valid[:, 1:] & valid[:, :-1]
    step = np.hypot(*np.moveaxis(np.diff(position, axis=1), -1, 0))
    jump = both & (step > _JUMP_MPS * DT_S)
    # a teleported vehicle is away for a while: whatever comes back is not the same motion
    back = valid[:, 1:] & ~valid[:, :-1] & (np.cumsum(valid, axis=1)[:, :-1] > 0)
    after = np.cumsum(jump | back, axis=1) > 0
    kept: Bools = valid & ~np.pad(after, ((0, 0), (1, 0)))
    return kept


def _runs(valid: Bools) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _mean(values: Floats) -> Floats:
    """Weighted mean over time; both ends go on as they were, so that even motion stays as it is."""
    if len(values) < 2:
        return values
    padded = np.pad(values, _HALF_WINDOW, mode="reflect", reflect_type="odd")
    mean: Floats = np.convolve(padded, _WEIGHTS, mode="valid")
    return mean
