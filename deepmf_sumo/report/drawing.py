"""Lanes, lines, edges and crosswalks of a road map."""

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
from deepmf_sumo.scene import Floats, RoadMap, Tracks
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.lane_map import per_road

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


UNKNOWN_WIDTH_M = 3.5
"""Width at which lanes are drawn that do not say theirs."""
_FILLED_M: Final = 5.0
"""Between lanes of one junction gaps up to twice this wide are part of it."""


@per_road
def junctions(road: RoadMap) -> list[list[Floats]]:
    """The places where lanes cross: lanes of a junction, and what is between.

    Each an outline (P, 2), and those of its islands.
    """
    lanes = [
        shapely.LineString(lane.centre_m).buffer(
            (lane.width_m or UNKNOWN_WIDTH_M) / 2, cap_style="flat"
        )
        for lane in road.lanes.values()
        if lane.interpolating and len(lane.centre_m) > 1
    ]
    if not lanes:
        return []
    joined = shapely.union_all(lanes).buffer(_FILLED_M).buffer(-_FILLED_M)
    parts = shapely.get_parts(joined)
    return [
        [shapely.get_coordinates(ring) for ring in (one.exterior, *one.interiors)]
        for one in parts
        if isinstance(one, shapely.Polygon)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadStyle:
    """Colours, and widths of lines in points."""

    surface: str = "#eef0f2"
    centre: str = "#d5dae0"
    line: str = "#c4cbd3"
    edge: str = "#6f7884"
    crosswalk: str = "#e3e7ef"
    line_pt: float = 0.9
    crosswalk_pt: float = 1.0


PICTURE = RoadStyle()


def draw_road(
    axes: Axes, road: RoadMap, window: ViewWindow, inches: float, style: RoadStyle = PICTURE
) -> None:
    """Draw what the window shows of a road.

    ``inches`` is the width of the axes on paper: lanes are as wide as they are in the world.
    """
    areas = [[window.place(ring) for ring in area] for area in junctions(road)]
    shapes = [
        Path.make_compound_path(*(Path(ring, closed=True) for ring in area))
        for area in areas
        if window.shows(area[0])
    ]
    axes.add_collection(PathCollection(shapes, facecolors=style.surface, linewidths=0, zorder=0))
    centres = [
        (placed, lane.width_m)
        for lane in road.lanes.values()
        if len(lane.centre_m) > 1 and window.shows(placed := window.place(lane.centre_m))
    ]
    for placed, width_m in centres:
        width = 72 * inches * (width_m or UNKNOWN_WIDTH_M) / window.side_m
        line = axes.plot(*placed.T, color=style.surface, lw=width, zorder=0)[0]
        line.set_solid_capstyle("butt")
    lines = {
        style.centre: [placed for placed, _ in centres],
        style.line: [window.place(line.points_m) for line in road.lines if len(line.points_m)],
        style.edge: [window.place(edge.points_m) for edge in road.edges if len(edge.points_m)],
    }
    for color, polylines in lines.items():
        shown = [points for points in polylines if window.shows(points)]
        axes.add_collection(LineCollection(shown, colors=color, linewidths=style.line_pt, zorder=1))
    crosswalks = [window.place(one.points_m) for one in road.polygons if one.kind == "crosswalk"]
    axes.add_collection(
        PolyCollection(
            [points for points in crosswalks if window.shows(points)],
            facecolors=style.crosswalk,
            edgecolors=style.line,
            linewidths=style.crosswalk_pt,
            hatch="//",
            zorder=1,
        )
    )


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
    corners = window.place(boxes.corners(centre, heading, tracks.size_m[rows, :2]))
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
