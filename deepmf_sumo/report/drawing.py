"""Road maps and boxes of road users, drawn in matplotlib's axes."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.path import Path

from deepmf_sumo.report import palette
from deepmf_sumo.report.map_layers import LAYERS, MapLayer, features
from deepmf_sumo.scene import Contact, Floats, RoadMap, Tracks
from deepmf_sumo.scene.geometry import boxes

SCORES: Final = LinearSegmentedColormap.from_list(
    "scores", [palette.hexadecimal(colour) for colour in palette.SCORES]
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewWindow:
    """A rectangle, x0..x1 and y0..y1 in metres, of the scene turned about the rectangle's centre.

    Attributes:
        turn_rad: by how much what is shown is turned counter-clockwise.
    """

    x0: float
    x1: float
    y0: float
    y1: float
    turn_rad: float = 0.0

    @property
    def side_m(self) -> float:
        """Width of what is seen."""
        return self.x1 - self.x0

    @property
    def centre_m(self) -> Floats:
        """(2,) centre of what is seen."""
        return np.array([(self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2])

    def place(self, points_m: Floats) -> Floats:
        """(..., 2) points of the scene -> where they are drawn."""
        if self.turn_rad == 0.0:
            return points_m
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        turned: Floats = (points_m - self.centre_m) @ np.array([[cos, sin], [-sin, cos]])
        return turned + self.centre_m

    def shows(self, placed_m: Floats) -> bool:
        """Whether the bounding box of drawn points (P, 2) reaches into what is seen."""
        low, high = placed_m.min(axis=0), placed_m.max(axis=0)
        across = bool(low[0] < self.x1 and high[0] > self.x0)
        return across and bool(low[1] < self.y1 and high[1] > self.y0)


def square(centre_m: Floats, side_m: float, turn_rad: float = 0.0) -> ViewWindow:
    """A square around a point."""
    x, y, half = float(centre_m[0]), float(centre_m[1]), side_m / 2
    return ViewWindow(x0=x - half, x1=x + half, y0=y - half, y1=y + half, turn_rad=turn_rad)


def draw_road(
    axes: Axes, road: RoadMap, window: ViewWindow, inches: float, fine: float = 1.0
) -> None:
    """Draw what the window shows of a road, see `map_layers`.

    ``inches`` is the width of the axes on paper: lanes are as wide as they are in the world.
    ``fine``: widths of lines, as a share of the usual ones.
    """
    point = 72 * inches / window.side_m
    shown: dict[str, list[tuple[list[Floats], float]]] = defaultdict(list)
    for one in features(road):
        placed = [window.place(part) for part in one.parts_m]
        if window.shows(placed[0]):
            shown[one.kind].append((placed, point * one.width_m))
    for layer in LAYERS:
        lines = [parts[0] for parts, _ in shown[layer.of]]
        if layer.name == "lane" and layer.fill:
            widths = [width for _, width in shown[layer.of]]
            axes.add_collection(
                LineCollection(
                    lines, colors=layer.fill.light, linewidths=widths, capstyle="butt",
                    joinstyle="round", zorder=0,
                )
            )  # fmt: skip
        elif layer.fill:
            _areas(axes, layer, [parts for parts, _ in shown[layer.of]], fine)
        elif layer.edge:
            width = fine * layer.edge_pt
            axes.add_collection(
                LineCollection(lines, colors=layer.edge.light, linewidths=width, zorder=1)
            )


def _areas(axes: Axes, layer: MapLayer, areas: list[list[Floats]], fine: float) -> None:
    assert layer.fill
    shapes = [
        Path.make_compound_path(*(Path(np.vstack([ring, ring[:1]]), closed=True) for ring in area))
        for area in areas
    ]
    axes.add_collection(
        PathCollection(
            shapes,
            facecolors=layer.fill.light,
            edgecolors=layer.edge.light if layer.edge else "none",
            linewidths=fine * layer.edge_pt if layer.edge else 0,
            hatch=layer.hatch or None,
            zorder=0,
        )
    )


_SEEN: Final = 1 / 110
"""Least length of a box in widths of the window: people would be too small to be seen."""


class Outline(NamedTuple):
    """How boxes look, beside their colours: their edges, in points, and how they cover others."""

    edge: Any
    zorder: float
    alpha: float = 1.0
    edge_pt: float = 0.8


def draw_boxes(
    axes: Axes,
    tracks: Tracks,
    places: Sequence[tuple[int, int]],
    colors: Sequence[Any],
    window: ViewWindow,
    outline: Outline,
) -> None:
    """Draw boxes of (row, step) pairs of the tracks."""
    if not places:
        return
    rows, steps = np.array(places).T
    centre, heading = tracks.position_m[rows, steps], tracks.heading_rad[rows, steps]
    size = tracks.size_m[rows, :2]
    size = size * np.maximum(1.0, _SEEN * window.side_m / size[:, :1])
    corners = window.place(boxes.corners(centre, heading, size))
    axes.add_collection(
        PolyCollection(
            list(corners),
            facecolors=colors,
            edgecolors=outline.edge,
            linewidths=outline.edge_pt,
            alpha=outline.alpha,
            zorder=outline.zorder,
        )
    )
    left, front, right = (corners[:, pair].mean(axis=1) for pair in ([0, 1], [0, 3], [2, 3]))
    noses = np.stack([left, front, right], axis=1)
    axes.add_collection(
        LineCollection(
            list(noses),
            colors=outline.edge,
            linewidths=0.75 * outline.edge_pt,
            zorder=outline.zorder,
        )
    )


def met_at(tracks: Tracks, contact: Contact) -> Floats:
    """(2,) middle of the overlap of the two boxes; between their centres where there is none."""
    poses = contact.pose_first, contact.pose_second
    agents = contact.first_id, contact.second_id
    sizes = [tracks.size_m[tracks.row(agent), :2] for agent in agents]
    first, second = (
        shapely.Polygon(boxes.corners(pose[:2], pose[2], size))
        for pose, size in zip(poses, sizes, strict=True)
    )
    common = first.intersection(second)
    if common.is_empty:
        return (poses[0][:2] + poses[1][:2]) / 2
    return np.array([common.centroid.x, common.centroid.y])
