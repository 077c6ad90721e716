"""Boxes of agents, with an arrowhead at the front."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from deepmf_sumo.datatypes import Tracks
from deepmf_sumo.geometry import boxes
from deepmf_sumo.report.drawing.window import Window


def draw_boxes(
    axes: Axes,
    tracks: Tracks,
    places: Sequence[tuple[int, int]],
    colors: Sequence[Any],
    window: Window,
    *,
    edge: Any,
    zorder: float,
    alpha: float = 1.0,
    edge_pt: float = 0.8,
) -> None:
    """Draw boxes of (row, step) pairs of the tracks."""
    if not places:
        return
    rows, steps = np.array(places).T
    centre, heading = tracks.position_m[rows, steps], tracks.heading_rad[rows, steps]
    corners = window.place(boxes.corners(centre, heading, tracks.size_m[rows, :2]))
    axes.add_collection(
        PolyCollection(
            list(corners),
            facecolors=colors,
            edgecolors=edge,
            linewidths=edge_pt,
            alpha=alpha,
            zorder=zorder,
        )
    )
    left, front, right = (corners[:, pair].mean(axis=1) for pair in ([0, 1], [0, 3], [2, 3]))
    noses = np.stack([left, front, right], axis=1)
    axes.add_collection(
        LineCollection(list(noses), colors=edge, linewidths=0.75 * edge_pt, zorder=zorder)
    )
