"""The screen that tables are shown on."""

from rich import markup
from rich.console import Console

from deepmf_sumo.texts import shown


def escape(text: str) -> str:
    """Text of others, e.g. an id, as rich prints it: no markup, nothing that acts on a terminal."""
    return markup.escape(shown(text))


def wide(width: int = 160) -> Console:
    """The terminal as wide as it is; pipes and logs, which have no width of their own, so wide."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = width
    return console
