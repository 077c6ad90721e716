"""Parameters of a search: how much the controls change at knots in time."""

import numpy as np

from deepmf_sumo.datatypes import Floats


class Knots:
    """Changes of acceleration and steering at equal intervals of time, smooth in between.

    Between two knots a change follows a half cosine, so that it never exceeds them.

    Args:
        count: knots of each control, at 0 s, ..., at the last step.
        steps: K, of the trajectory.
    """

    def __init__(self, count: int, steps: int) -> None:
        self.names = tuple(
            f"{control}_{knot}" for control in ("accel", "steer") for knot in range(count)
        )
        place = np.linspace(0.0, count - 1.0, steps)
        knot = np.minimum(place.astype(int), count - 2)
        share = (1 - np.cos(np.pi * (place - knot))) / 2
        self._weight = np.zeros((count, steps))
        self._weight[knot, np.arange(steps)] = 1 - share
        self._weight[knot + 1, np.arange(steps)] = share

    @property
    def dimensions(self) -> int:
        """D: two controls at each knot."""
        return len(self.names)

    def controls(self, points: Floats) -> tuple[Floats, Floats]:
        """Changes of acceleration and steering, (B, K) each, of points (B, D) in [-1, 1]."""
        halves = np.asarray(points, float).reshape(len(points), 2, -1) @ self._weight
        return halves[:, 0], halves[:, 1]
