"""The part of the world that a picture shows."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
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


def square(centre_m: Floats, side_m: float, turn_rad: float = 0.0) -> Window:
    """A square around a point."""
    x, y, half = float(centre_m[0]), float(centre_m[1]), side_m / 2
    return Window(x0=x - half, x1=x + half, y0=y - half, y1=y + half, turn_rad=turn_rad)
