"""What is in the AV's way: boxes that reach into the corridor that the AV is going to sweep."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Floats, View
from deepmf_sumo.geometry import angles, boxes, polylines

_SIDE_STATIONS = np.linspace(0.0, 1.0, 5)[:-1, None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Leader:
    """Gap from the AV's bumper along its path, and the speed along the path, signed."""

    agent_id: AgentId
    gap_m: float
    speed_mps: float


def nearest_in_corridor(view: View, path_m: Floats, margin_m: float) -> Leader | None:
    """The nearest box, of whatever kind, that reaches into the swept corridor; None if clear.

    Args:
        view: the present.
        path_m: (P, 2) from the AV's front bumper on.
        margin_m: added to half the AV's width on both sides.
    """
    tracks = view.history
    me = tracks.row(view.av_id)
    half = float(tracks.size_m[me, 1]) / 2 + margin_m
    centre, size = tracks.position_m[:, -1], tracks.size_m[:, :2]
    reach = half + np.hypot(size[:, 0], size[:, 1]) / 2
    near = _within(centre, path_m, reach)
    near[me] = False
    rows = np.flatnonzero(near)
    if not len(rows):
        return None
    outline = _outline(centre[rows], tracks.heading_rad[rows, -1], size[rows])
    foot = polylines.project(path_m, outline)
    # points beyond the ends of the path have their foot at the end, farther away than sideways
    inside = (np.abs(foot.left_m) < half) & (foot.distance_m < np.abs(foot.left_m) + 1e-6)
    gap = np.where(inside, foot.along_m, np.inf)
    box, point = np.unravel_index(gap.argmin(), gap.shape)
    if not np.isfinite(gap[box, point]):
        return None
    row = int(rows[box])
    along = angles.unit(float(foot.heading_rad[box, point]))
    return Leader(
        agent_id=tracks.ids[row],
        gap_m=float(gap[box, point]),
        speed_mps=float(tracks.velocity_mps[row, -1] @ along),
    )


def _within(centre: Floats, path: Floats, reach: Floats) -> Bools:
    """(N) whether a box's circumcircle can touch the corridor."""
    low, high = path.min(0), path.max(0)
    outside = np.maximum(np.maximum(low - centre, centre - high), 0.0)
    candidate: Bools = np.hypot(outside[:, 0], outside[:, 1]) < reach
    if candidate.any():
        foot = polylines.project(path, centre[candidate])
        candidate[candidate] = foot.distance_m < reach[candidate]
    return candidate


def _outline(centre: Floats, heading: Floats, size: Floats) -> Floats:
    """(N, 16, 2) points around boxes: corners and three more a side."""
    corner = boxes.corners(centre, heading, size)
    following = np.roll(corner, -1, axis=-2)
    sides = corner[:, :, None] + _SIDE_STATIONS * (following - corner)[:, :, None]
    return sides.reshape(len(centre), -1, 2)
