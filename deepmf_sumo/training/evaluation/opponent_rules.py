"""Untrained opponent scores: what a network has to beat. Higher suits better."""

from collections.abc import Callable
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats, Ints, View
from deepmf_sumo.geometry import frames
from deepmf_sumo.geometry.slow import WAITING_MPS

_TIMES_S = np.arange(0.0, 8.01, 0.1)
_STILL_M = 0.5
_BESIDE, _AHEAD = 2.0, 0.2
"""Cost of a metre beside the AV's heading, and of a metre along it."""


def corridor(view: View, rows: Ints) -> Floats:
    """(A) the AV drives on along its heading: nearness to that line counts ten times as much."""
    place = _local(view, rows)
    return np.asarray(-(_BESIDE * np.abs(place[:, 1]) + _AHEAD * np.abs(place[:, 0])), float)


def nearest(view: View, rows: Ints) -> Floats:
    """(A) nearness now."""
    distance: Floats = np.hypot(*_local(view, rows).T)
    return -distance


def nearest_moving(view: View, rows: Ints) -> Floats:
    """(A) nearness of those that move now or have moved in the last second; -inf for others."""
    tracks = view.history
    first = tracks.valid[rows].argmax(1)
    moved = np.hypot(*(tracks.position_m[rows, -1] - tracks.position_m[rows, first]).T)
    moving = (tracks.speed_mps[rows, -1] > WAITING_MPS) | (moved > _STILL_M)
    return np.where(moving, nearest(view, rows), -np.inf)


def constant_velocity(view: View, rows: Ints) -> Floats:
    """(A) nearness at the closest approach within 8 s if nobody changes velocity."""
    tracks, av = view.history, view.history.row(view.av_id)
    apart = tracks.position_m[rows, -1] - tracks.position_m[av, -1]
    relative = tracks.velocity_mps[rows, -1] - tracks.velocity_mps[av, -1]
    way = apart[:, None] + _TIMES_S[:, None] * relative[:, None]
    return np.asarray(-np.linalg.norm(way, axis=-1).min(1), float)


RULES: Final[dict[str, Callable[[View, Ints], Floats]]] = {
    "corridor": corridor,
    "nearest": nearest,
    "nearest_moving": nearest_moving,
    "constant_velocity": constant_velocity,
}


def _local(view: View, rows: Ints) -> Floats:
    """(A, 2) positions now, ahead and to the left of the AV."""
    tracks, av = view.history, view.history.row(view.av_id)
    return frames.to_local(
        tracks.position_m[rows, -1], tracks.position_m[av, -1], float(tracks.heading_rad[av, -1])
    )
