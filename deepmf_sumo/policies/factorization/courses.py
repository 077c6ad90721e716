"""Paths and timing of M references on one common arc-length grid, so that M are read at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.datatypes import DT_S, Floats, Ints

Complexes = NDArray[np.complex128]

_SPACING_M = 0.5
_BEYOND_M = 40.0  # every path goes on straight: nothing looks farther ahead than this
_DIRECTED_M = 0.3  # a shorter last metre gives no direction
_STANDING_M = 0.005  # shorter steps are noise of a standing vehicle
_SMOOTHING_STEPS = 2  # speeds of a reference are differences over 0.4 s
_BEND_POINTS = 4  # curvature is the turn over 4 m
_SHARE = 0.9  # of the limits, kept for curves, so that tracking errors can be corrected
_SLOWEST_MPS = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Courses:
    """M paths (M, G) sampled every 0.5 m, and where each reference is on its path (M, F + 1).

    Points are complex numbers, x + iy, and what is asked for at each step is prepared: the tracking
    loop runs 80 times, and this is a third of its cost.

    Attributes:
        path_m: (M, G) points. ahead_m: (M, G) from each point to the next, 0 at the end.
        fastest_mps: (M, G) from which the curves ahead can still be driven.
        due_m, speed_mps, accel_mps2: (M, F + 1) of the references. row: (M) flat index of points 0.
    """

    path_m: Complexes
    ahead_m: Complexes
    fastest_mps: Floats
    due_m: Floats
    speed_mps: Floats
    accel_mps2: Floats
    row: Ints

    @classmethod
    def along(
        cls, reference_m: Floats, start_m: Floats, course_rad: float, limits: Floats
    ) -> "Courses":
        """Courses of references (M, F, 2) from a start (2); limits (M, 3) bound speed in curves."""
        points = np.empty((len(reference_m), reference_m.shape[1] + 1), dtype=np.complex128)
        points[:, 0] = complex(*start_m)
        points[:, 1:] = reference_m[..., 0] + 1j * reference_m[..., 1]
        step = np.abs(np.diff(points, axis=1))
        step[step < _STANDING_M] = 0.0
        length = np.concatenate([np.zeros((len(step), 1)), np.cumsum(step, axis=1)], axis=1)
        path = _resampled(points, length, course_rad)
        ahead = np.diff(path, axis=1, append=path[:, -1:])
        speed = _smooth_speed(length)
        return cls(
            path_m=path,
            ahead_m=ahead,
            fastest_mps=np.sqrt(_curve_limit(path, limits)),
            due_m=length,
            speed_mps=speed,
            accel_mps2=np.gradient(speed, DT_S, axis=1),
            row=np.arange(len(path)) * path.shape[1],
        )

    def timing(self, step: int) -> tuple[Floats, Floats, Floats]:
        """Arc length, speed, acceleration of the references ``step`` steps from now, (M) each."""
        return self.due_m[:, step], self.speed_mps[:, step], self.accel_mps2[:, step]

    def point(self, along_m: Floats) -> Complexes:
        """Points at arc lengths (M), one a path."""
        cell, share = self._cell(along_m)
        where: Complexes = self.path_m.take(cell) + share * self.ahead_m.take(cell)
        return where

    def progress(self, guess_m: Floats, least_m: Floats, position_m: Complexes) -> Floats:
        """Arc lengths (M) of the feet of points near ``guess_m``; never behind ``least_m``."""
        cell, share = self._cell(guess_m)
        off, ahead = position_m - self.path_m.take(cell), self.ahead_m.take(cell)
        product = off * ahead.conj()
        foot = product.real / np.maximum(square(ahead), 1e-9)
        correction = np.minimum(np.maximum((foot - share) * _SPACING_M, -0.5), 0.5)
        place: Floats = np.maximum(guess_m + correction, least_m)
        return place

    def speed_limit(self, along_m: Floats) -> Floats:
        """Highest speed (M) from which the curves ahead can still be driven."""
        limit: Floats = self.fastest_mps.take(self._cell(along_m)[0])
        return limit

    def _cell(self, along_m: Floats) -> tuple[Ints, Floats]:
        """Places (M) in the flat arrays, and shares of the way to the next point."""
        place = np.minimum(along_m / _SPACING_M, self.path_m.shape[1] - 1.001)
        cell = place.astype(np.int64)
        return self.row + cell, place - cell


def square(number: Complexes) -> Floats:
    """Squares of the lengths of complex numbers."""
    squares: Floats = number.real**2 + number.imag**2
    return squares


def _resampled(points: Complexes, length: Floats, course_rad: float) -> Complexes:
    """(M, G) points every 0.5 m, continued straight in the direction of the last metre."""
    total = length[:, -1]
    grid = np.arange(0.0, total.max() + _BEYOND_M, _SPACING_M)
    path = np.empty((len(points), len(grid)), dtype=np.complex128)
    for row, (mode, along) in enumerate(zip(points, length, strict=True)):
        end = mode[-1] - np.interp(max(total[row] - 1.0, 0.0), along, mode)
        # A standing vehicle goes on the way that it points.
        ahead = end / np.abs(end) if np.abs(end) > _DIRECTED_M else np.exp(1j * course_rad)
        path[row] = np.interp(grid, along, mode) + np.maximum(grid - total[row], 0.0) * ahead
    return path


def _smooth_speed(length: Floats) -> Floats:
    """(M, F + 1) speeds as differences of arc length over 0.4 s, shorter at both ends."""
    last = length.shape[1] - 1
    steps = np.arange(last + 1)
    low = np.maximum(steps - _SMOOTHING_STEPS, 0)
    high = np.minimum(steps + _SMOOTHING_STEPS, last)
    speed: Floats = (length[:, high] - length[:, low]) / ((high - low) * DT_S)
    return speed


def _curve_limit(path: Complexes, limits: Floats) -> Floats:
    """(M, G) squares of the highest speeds: v^2 <= lateral / curvature, and braking in time."""
    ahead = np.diff(path, axis=1)
    turn = np.zeros(path.shape)
    bend = np.abs(np.angle(ahead[:, 2 * _BEND_POINTS :] * ahead[:, : -2 * _BEND_POINTS].conj()))
    turn[:, _BEND_POINTS + 1 : _BEND_POINTS + 1 + bend.shape[1]] = bend
    curvature = turn / (2 * _BEND_POINTS * _SPACING_M)
    square = _SHARE * limits[:, 2:3] / np.maximum(curvature, 1e-6)
    square = np.maximum(square, _SLOWEST_MPS**2)
    # v(s)^2 <= v(s')^2 + 2 b (s' - s) for every s' ahead: a running minimum from the far end.
    slope = 2 * _SHARE * limits[:, 1:2] * _SPACING_M * np.arange(path.shape[1])
    fastest: Floats = np.minimum.accumulate((square + slope)[:, ::-1], axis=1)[:, ::-1] - slope
    return fastest
