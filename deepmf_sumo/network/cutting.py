"""Parts of polylines, and polylines made longer."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.geometry import polylines

LATERAL_MPS2: Final = 5.5
"""Sideways acceleration in turns, netconvert's default."""
BEND_M: Final = 5
"""Over so many metres a turn is measured; the corners of a simplified line say nothing."""


def part(points_m: Floats, start_m: float, end_m: float) -> Floats:
    """The polyline (P, 2) between two arc lengths, with all vertices between them."""
    along = polylines.arc_lengths(points_m)
    between = (along > start_m + 1e-6) & (along < end_m - 1e-6)
    first, last = polylines.points_at(points_m, np.array([start_m, end_m]))[0]
    return np.vstack([first, points_m[between], last])


def tail(points_m: Floats, length_m: float) -> Floats:
    """The last part of a polyline (P, 2), or all of a shorter one."""
    length = float(polylines.arc_lengths(points_m)[-1])
    return part(points_m, max(0.0, length - length_m), length)


def end_direction(points_m: Floats, over_m: float = 3.0) -> Floats:
    """(2) unit vector in which a polyline ends, taken over its last metres."""
    last = tail(points_m, over_m)
    direction = last[-1] - last[0]
    unit: Floats = direction / max(float(np.hypot(*direction)), 1e-9)
    return unit


def joined(parts: list[Floats]) -> Floats:
    """Polylines (P, 2) in a row, without repeated points."""
    points = np.vstack(parts)
    apart = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    chain: Floats = points[apart]
    return chain


def bridge(before_m: Floats, after_m: Floats) -> Floats:
    """A smooth line (P, 2) from the end of a polyline to the start of another (a cubic Bezier)."""
    start, end = before_m[-1], after_m[0]
    reach = 0.4 * float(np.hypot(*(end - start)))
    first = start + reach * end_direction(before_m)
    second = end + reach * end_direction(after_m[::-1])
    share = np.linspace(0.0, 1.0, 25)[:, None]
    rest = 1.0 - share
    curve: Floats = (
        rest**3 * start
        + 3 * rest**2 * share * first
        + 3 * rest * share**2 * second
        + share**3 * end
    )
    return curve


def bend_speed_mps(points_m: Floats) -> float:
    """Speed at which the sharpest bend of a polyline (P, 2) can be driven."""
    steps = np.diff(polylines.resample(points_m, 1.0), axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    over = min(BEND_M, len(heading) - 1)
    if over < 1:
        return float("inf")
    turn = float(np.abs(heading[over:] - heading[:-over]).max()) / over
    return float(np.sqrt(LATERAL_MPS2 / max(turn, 1e-6)))
