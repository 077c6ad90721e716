"""Colours that mean the same in every picture, figure and page."""

from bisect import bisect_right
from typing import Final

Rgb = tuple[int, int, int]

AV: Final = "#1f5fbf"
OPPONENT: Final = "#c1121f"
STAR: Final = "#ffd43b"
"""Of the star on the opponent."""
CANDIDATE: Final = "#e0785a"
HEAT: Final = "#7b4fa3"
"""Where the opponent may be."""
REACTION: Final = "#5b8fd9"
UNSCORED: Final = "#ccd2d9"
"""Of vehicles without a score."""

SCORES: Final[tuple[Rgb, ...]] = ((255, 243, 176), (244, 163, 43), (193, 18, 31))
"""Opponent scores from 0 to 1, mixed in between: pale yellow, orange, red."""

RISK_CLASSES: Final[tuple[tuple[float, Rgb], ...]] = (
    (0.0, (255, 237, 160)), (0.05, (254, 217, 118)), (0.1, (254, 178, 76)),
    (0.25, (253, 141, 60)), (0.5, (227, 26, 28)), (0.75, (128, 0, 38)),
)  # fmt: skip
"""Colours by the risk from which on they are used: the same risk has the same colour in every map.

Places of attacks without any such event have none: only a grey outline.
"""


def hexadecimal(colour: Rgb) -> str:
    """``#c1121f``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def risk_colour(risk: float) -> Rgb:
    """Of a risk (0 to 1) of an event that has happened."""
    return RISK_CLASSES[bisect_right([bound for bound, _ in RISK_CLASSES], risk) - 1][1]
