"""Boxes that reach into the corridor that the AV is going to sweep."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.scene import AgentId, Bools, Floats, View
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import off_level

_SPACING_M = 1.0
"""Spacing of points on a box's outline: well below any corridor's width."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leader:
    """Gap from the AV's bumper along its path, and the speed along the path, signed."""

    agent_id: AgentId
    gap_m: float
    speed_mps: float


def nearest_in_corridor(view: View, path_m: Floats, margin_m: float) -> Leader | None:
    """The nearest box of any kind that reaches into the swept corridor; None if it is clear.

    Boxes on a road above or below do not count.

    Args:
        view: the present.
        path_m: (P, 2) from the AV's front bumper on.
        margin_m: added to half the AV's width on both sides.
    """
    tracks = view.history
    me = tracks.row(view.av_id)
    half = float(tracks.size_m[me, 1]) / 2 + margin_m
    position, z_m = tracks.position_m[:, -1], tracks.z_m[:, -1]
    gap, heading = entries(path_m, half, position, tracks.heading_rad[:, -1], tracks.size_m[:, :2])
    gap[off_level(view.road, position[me], float(z_m[me]), position, z_m)] = np.inf
    gap[me] = np.inf
    row = int(gap.argmin())
    if not np.isfinite(gap[row]):
        return None
    along = frames.unit(float(heading[row]))
    return Leader(
        agent_id=tracks.ids[row],
        gap_m=float(gap[row]),
        speed_mps=float(tracks.velocity_mps[row, -1] @ along),
    )


def entries(
    path_m: Floats, half_m: float, centre_m: Floats, heading_rad: Floats, size_m: Floats
) -> tuple[Floats, Floats]:
    """Points where N boxes reach into a corridor.

    Args:
        path_m: (P, 2) middle of the corridor.
        half_m: half its width.
        centre_m: (N, 2) of the boxes.
        heading_rad: (N).
        size_m: (N, 2) length and width.

    Returns:
        (N) distance along the path to the first point of each box inside, inf for boxes outside,
        and (N) direction of the path there.
    """
    gap, direction = np.full(len(centre_m), np.inf), np.zeros(len(centre_m))
    near = np.flatnonzero(
        _within(centre_m, path_m, half_m + np.hypot(size_m[:, 0], size_m[:, 1]) / 2)
    )
    if not len(near):
        return gap, direction
    outline = _outline(centre_m[near], heading_rad[near], size_m[near])
    foot = polylines.project(path_m, outline)
    # points beyond the ends of the path have their foot at the end, farther away than sideways
    inside = (np.abs(foot.left_m) < half_m) & (foot.distance_m < np.abs(foot.left_m) + 1e-6)
    along = np.where(inside, foot.along_m, np.inf)
    first = along.argmin(axis=1)
    pick = np.arange(len(near)), first
    gap[near], direction[near] = along[pick], foot.heading_rad[pick]
    return gap, direction


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
    """(N, K, 2) points around boxes: corners, and points between them at most a metre apart."""
    share = np.linspace(0.0, 1.0, 1 + int(np.ceil(size.max() / _SPACING_M)))[:-1, None]
    corner = boxes.corners(centre, heading, size)
    following = np.roll(corner, -1, axis=-2)
    sides = corner[:, :, None] + share * (following - corner)[:, :, None]
    return sides.reshape(len(centre), -1, 2)
