"""How figures look in print: widths, fonts, colours that survive grey and colour blindness."""

import contextlib
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deepmf_sumo import files
from deepmf_sumo.report.drawing import ViewWindow
from deepmf_sumo.report.palette import STAR

SINGLE_IN: Final = 3.4
"""Width of one column of a paper in two."""
DOUBLE_IN: Final = 7.0
SMALLEST_PT: Final = 7.0
DPI: Final = 300

AV: Final = "#0b3c8c"
OPPONENT: Final = "#d9480f"
OTHER: Final = "#c3c9d0"
OTHER_EDGE: Final = "#6b747e"
FINE: Final = 0.55
"""Widths of lines of the road: panels are small."""
AV_TIME: Final[Colormap] = LinearSegmentedColormap.from_list(
    "av", ["#7fb3e0", "#2b6fb5", "#06204f"]
)
OPPONENT_TIME: Final[Colormap] = LinearSegmentedColormap.from_list(
    "opponent", ["#fdcf9f", "#fb9a4f", "#dd520c"]
)
"""At equal times lighter than the AV, so that grey print tells them apart."""

COLOURS: Final = (
    "#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c564b",
    "#7f7f7f", "#b2b200", "#5e3c99", "#1b7837",
)  # fmt: skip
"""Okabe and Ito's, and five more; a marker tells methods apart as well."""
MARKERS: Final = "osD^v<>PXph*"

CHART_IN: Final = 1.5
"""Height of a chart with its labels."""

_SETTINGS: Final[Any] = {
    "font.family": "DejaVu Sans",
    "font.size": SMALLEST_PT,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": SMALLEST_PT,
    "ytick.labelsize": SMALLEST_PT,
    "legend.fontsize": SMALLEST_PT,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "hatch.linewidth": 0.3,
    "svg.hashsalt": "deepmf-sumo",
    "svg.fonttype": "path",
    "axes.unicode_minus": True,
}


@contextlib.contextmanager
def printed() -> Iterator[None]:
    """Settings under which figures are made; those of the user's matplotlib do not count."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


def sheet(width_in: float, height_in: float) -> Figure:
    """An empty figure."""
    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write ``stem.png`` and ``stem.svg``; the same figure gives the same bytes."""
    written = []
    for suffix, nothing in ((".png", {"Software": None}), (".svg", {"Date": None})):
        content = io.BytesIO()
        figure.savefig(content, format=suffix[1:], dpi=DPI, metadata=nothing)
        path = stem.with_suffix(suffix)
        files.write(path, content.getvalue())
        written.append(path)
    return written


def charts(rows: int, columns: int, methods: int) -> tuple[Figure, Any]:
    """A sheet of charts, (rows, columns) axes, with room for a legend of the methods."""
    legend_in = 0.17 * -(-methods // legend_columns(columns))
    width = DOUBLE_IN if columns > 1 else SINGLE_IN
    figure = sheet(width, rows * CHART_IN + legend_in + 0.1)
    figure.set_layout_engine("constrained")
    return figure, figure.subplots(rows, columns, sharey=True, sharex="row", squeeze=False)


def legend_columns(columns: int) -> int:
    """Of a legend below this number of columns of charts."""
    return 3 if columns == 1 else 6


def rate_axis(axes: Axes) -> None:
    """A vertical axis of rates, and faint lines to read them by."""
    axes.set(ylim=(-0.05, 1.05), yticks=[0, 0.25, 0.5, 0.75, 1])
    axes.grid(lw=0.3, color="#dddddd")
    axes.set_axisbelow(True)


def method_look(number: int) -> dict[str, Any]:
    """Colour and marker of the plan's method of this number."""
    return {
        "color": COLOURS[number % len(COLOURS)],
        "marker": MARKERS[(number + number // len(COLOURS)) % len(MARKERS)],
        "ms": 4.5,
        "mec": "black",
        "mew": 0.4,
    }


def method_legend(figure: Figure, methods: Mapping[int, str], columns: int) -> None:
    """Names of the methods, by number, below all charts."""
    figure.legend(
        [Line2D([], [], ls="", **method_look(number)) for number in methods],
        [name.replace("$", r"\$") for name in methods.values()],
        loc="outside lower center",
        ncols=legend_columns(columns),
        frameon=False,
        handletextpad=0.2,
        columnspacing=1.0,
    )


def letters(count: int) -> list[str]:
    """(a), (b), ..."""
    return [f"({chr(ord('a') + number)})" for number in range(count)]


def star_mark() -> Line2D:
    """What marks the opponent, for a legend."""
    return Line2D([], [], ls="", marker="*", color=STAR, mec="black", mew=0.5, ms=7)


def contact_mark() -> Line2D:
    """What marks a contact, for a legend."""
    return Line2D([], [], ls="", marker="x", color="black", ms=5, mew=1.2)


MOST_COLUMNS: Final = 4
GAP_IN: Final = 0.08
BORDER_IN: Final = 0.03
LINE_IN: Final = 0.135
"""Height of a line of the smallest print."""


def shape(count: int) -> tuple[int, int]:
    """Rows and columns for a number of panels: at most four in a row, rows of similar length."""
    rows = -(-count // MOST_COLUMNS)
    return rows, -(-count // rows)


@dataclass(frozen=True, kw_only=True)
class PanelGrid:
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
        return sheet(self.width_in, self.height_in)

    def panel(self, figure: Figure, row: int, column: int) -> Axes:
        """The axes of a panel; row 0 is at the top."""
        left = BORDER_IN + column * (self.panel_in + GAP_IN)
        bottom = self.height_in - (row + 1) * self._row_in + GAP_IN - BORDER_IN
        return self.axes(figure, left, bottom, self.panel_in, self.panel_in)

    def axes(self, figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
        """Axes at a place in inches from the lower left corner."""
        across, up = self.width_in, self.height_in
        return figure.add_axes((left / across, bottom / up, width / across, height / up))


def frame(axes: Axes, window: ViewWindow, title: str) -> None:
    """Limits, title and a bar that tells the scale."""
    axes.set(xlim=(window.x0, window.x1), ylim=(window.y0, window.y1), xticks=[], yticks=[])
    axes.set_aspect("equal")
    axes.set_title(title, pad=2.0, fontsize=SMALLEST_PT, parse_math=False)
    side = window.side_m
    bar = next(length for length in (50.0, 20.0, 10.0, 5.0, 2.0) if length < side / 3)
    left, bottom = window.x0 + 0.04 * side, window.y0 + 0.05 * side
    plate = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    axes.text(
        left + bar / 2, bottom + 0.02 * side, f"{bar:g} m", ha="center", va="bottom",
        fontsize=SMALLEST_PT, zorder=20, bbox=plate,
    )  # fmt: skip
    axes.plot([left, left + bar], [bottom, bottom], color="black", lw=1.2, zorder=21)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A figure that was drawn.

    Attributes:
        caption: what is shown, and how it was chosen.
        runs: ids of the runs that are shown.
        notes: what differs from what one would expect, a sentence each.
    """

    figure: Figure
    caption: str
    runs: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Skipped:
    """A figure that lacks data."""

    reason: str
