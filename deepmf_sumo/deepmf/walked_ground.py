"""Candidates of people stay where people can be (`scene.geometry.walkable`).

A reference that leads off this ground stops at its end; a candidate that leaves it all the same is
none. That is no wish: nobody walks through a house. Who is elsewhere now, since a recording, SUMO
or a spec put it there, may be there until it comes onto this ground; a building or water that it
has left, or is not in, it does not enter.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.candidates import Candidates, References
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.scene import DT_S, Bools, Floats
from deepmf_sumo.scene.geometry.walkable import walkable

_BEFORE_M: Final = 0.3
"""References end so far before the ground does, because tracking cuts corners."""
_SHARE: Final = 0.85
"""Of the limit on braking; the rest corrects tracking errors."""


def staying(situation: Situation, references: References) -> References:
    """The references; those that leave the ground brake, and stop at its end."""
    position_m = references.position_m
    off = off_ground(situation, position_m)
    rows = np.flatnonzero(off.any(axis=1))
    if not len(rows):
        return references
    position_m = position_m.copy()
    for row in rows.tolist():
        position_m[row] = _stopping(situation, position_m[row], int(off[row].argmax()))
    return replace(references, position_m=position_m)


def among(situation: Situation, own: Candidates) -> Candidates:
    """The candidates that stay on the ground; if none does, those that leave it last."""
    off = off_ground(situation, own.forecast.futures.position_m)[:, : situation.horizon]
    first = np.where(off.any(axis=1), off.argmax(axis=1), situation.horizon)
    rows = np.flatnonzero(first == first.max())
    return own if len(rows) == len(own.origin) else own.take(rows)


def off_ground(situation: Situation, position_m: Floats) -> Bools:
    """(K, F) whether positions (K, F, 2) of a person are where it cannot be."""
    road, levels = walkable(situation.view.road), situation.levels
    now_z_m = None if levels is None else levels.opponent[2:]
    z_m = None if levels is None else levels.opponent_z_m(position_m).reshape(-1)
    shape = position_m.shape[:2]
    points, here = position_m.reshape(-1, 2), situation.start.position_m[None]
    on_it = road.holds(points, z_m).reshape(shape)
    if road.holds(here, now_z_m)[0]:
        return ~on_it
    come = np.maximum.accumulate(on_it, axis=1)
    barred = road.barred(points).reshape(shape)
    if road.barred(here)[0]:
        barred &= np.maximum.accumulate(~barred, axis=1)
    return np.asarray(~on_it & (come | barred))


def _stopping(situation: Situation, reference_m: Floats, first: int) -> Floats:
    """(F, 2) a reference that stops before its step ``first``."""
    line = np.concatenate([situation.start.position_m[None], reference_m])
    step = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    end_m = max(float(along[first]) - _BEFORE_M, 0.0)
    brake = _SHARE * situation.limits.brake
    speed = step / DT_S  # from each point to the next
    begin = int((along[:-1] + speed**2 / (2 * brake) >= end_m).argmax())
    left_m = max(end_m - float(along[begin]), 1e-3)
    brake = min(float(speed[begin]) ** 2 / (2 * left_m), situation.limits.brake)
    since = np.minimum(DT_S * np.arange(len(line) - begin), speed[begin] / max(brake, 1e-3))
    along_m = along.copy()
    along_m[begin:] = along[begin] + speed[begin] * since - brake * since**2 / 2
    return np.column_stack([np.interp(along_m[1:], along, axis) for axis in line.T])
