"""The screen that tables are shown on."""

from rich.console import Console


def wide(width: int = 160) -> Console:
    """The terminal as wide as it is; pipes and logs, which have no width of their own, so wide."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = width
    return console
