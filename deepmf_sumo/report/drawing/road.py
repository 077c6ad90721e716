"""Lanes, lines, edges and crosswalks of a road map."""

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from deepmf_sumo.datatypes import RoadMap
from deepmf_sumo.report.drawing.window import Window

UNKNOWN_WIDTH_M = 3.5
"""Width at which lanes are drawn that do not say theirs."""


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
    axes: Axes, road: RoadMap, window: Window, inches: float, style: RoadStyle = PICTURE
) -> None:
    """Draw what the window shows of a road.

    ``inches`` is the width of the axes on paper: lanes are as wide as they are in the world.
    """
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
