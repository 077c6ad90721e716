"""What a figure's module gives back: a sheet with its caption, or why there is none."""

from dataclasses import dataclass

from matplotlib.figure import Figure


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
