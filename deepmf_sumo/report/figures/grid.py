"""Square panels of known size on a sheet, so that lanes are as wide as they should be."""

from dataclasses import dataclass
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepmf_sumo.report.drawing.window import Window
from deepmf_sumo.report.figures import style

MOST_COLUMNS: Final = 4
GAP_IN: Final = 0.08
BORDER_IN: Final = 0.03
LINE_IN: Final = 0.135
"""Height of a line of the smallest print."""


def shape(count: int) -> tuple[int, int]:
    """Rows and columns for so many panels: at most four in a row, rows of about equal length."""
    rows = -(-count // MOST_COLUMNS)
    return rows, -(-count // rows)


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A sheet of square panels in rows, with titles above each and a strip below all.

    Attributes:
        title_lines: above each panel.
        strip_in: height of the strip at the foot, for colour bars and legends.
    """

    width_in: float
    rows: int
    columns: int
    title_lines: int = 1
    strip_in: float = 0.0

    @property
    def panel_in(self) -> float:
        """Side of a panel."""
        free = self.width_in - 2 * BORDER_IN - (self.columns - 1) * GAP_IN
        return free / self.columns

    @property
    def height_in(self) -> float:
        """Height of the sheet."""
        return self.rows * self._row_in + self.strip_in + BORDER_IN

    @property
    def _row_in(self) -> float:
        return self.panel_in + self.title_lines * LINE_IN + GAP_IN

    def sheet(self) -> Figure:
        """The empty sheet."""
        return style.sheet(self.width_in, self.height_in)

    def panel(self, figure: Figure, row: int, column: int) -> Axes:
        """The axes of a panel; row 0 is at the top."""
        left = BORDER_IN + column * (self.panel_in + GAP_IN)
        bottom = self.height_in - (row + 1) * self._row_in + GAP_IN - BORDER_IN
        return self.axes(figure, left, bottom, self.panel_in, self.panel_in)

    def axes(self, figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
        """Axes at a place in inches from the lower left corner."""
        across, up = self.width_in, self.height_in
        return figure.add_axes((left / across, bottom / up, width / across, height / up))


def frame(axes: Axes, window: Window, title: str) -> None:
    """Limits, title and a bar that tells the scale."""
    axes.set(xlim=(window.x0, window.x1), ylim=(window.y0, window.y1), xticks=[], yticks=[])
    axes.set_aspect("equal")
    axes.set_title(title, pad=2.0, fontsize=style.SMALLEST_PT, parse_math=False)
    side = window.side_m
    bar = next(length for length in (50.0, 20.0, 10.0, 5.0, 2.0) if length < side / 3)
    left, bottom = window.x0 + 0.04 * side, window.y0 + 0.05 * side
    plate = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    axes.text(
        left + bar / 2, bottom + 0.02 * side, f"{bar:g} m", ha="center", va="bottom",
        fontsize=style.SMALLEST_PT, zorder=20, bbox=plate,
    )  # fmt: skip
    axes.plot([left, left + bar], [bottom, bottom], color="black", lw=1.2, zorder=21)
