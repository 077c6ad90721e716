"""The distinct ways that an opponent's predicted modes take, to be driven at other speeds."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import Floats, Forecast
from deepmf_sumo.geometry import angles, polylines
from deepmf_sumo.policies.factorization.tracking import Start, joined

_PATHS = 12
_SAME_PATH_M = 0.7  # a mode that ends this near another's path drives on it
_BEYOND_M = 60.0
_COARSE = 8  # every eighth point (0.8 s) is enough to find the nearest place on a path


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnPath:
    """One of the opponent's own ways, continued straight for 60 m.

    Attributes:
        points_m: (P, 2). predicted_m: length without the continuation.
        coarse_m: (Q, 2) every eighth of the points; coarse_along_m: (Q) where they are on the path.
        sharpest: (Q) largest curvature on the way to them.
    """

    points_m: Floats
    predicted_m: float
    coarse_m: Floats
    coarse_along_m: Floats
    sharpest: Floats

    @classmethod
    def of(cls, points_m: Floats, heading_rad: float) -> "OwnPath":
        """A path from points (P, 2), P >= 1, that goes on in a direction."""
        predicted = float(polylines.arc_lengths(points_m)[-1])
        points = np.concatenate([points_m, [points_m[-1] + _BEYOND_M * angles.unit(heading_rad)]])
        rows = np.unique([*range(0, len(points), _COARSE), len(points) - 2, len(points) - 1])
        coarse, along = points[rows], polylines.arc_lengths(points)[rows]
        ahead = np.diff(coarse, axis=0)
        turn = np.abs(np.diff(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))))
        # Between short steps a turn is noise of a nearly standing vehicle: spread it over 4 m.
        curvature = turn / np.maximum((along[2:] - along[:-2]) / 2, 4.0)
        return cls(
            points_m=points,
            predicted_m=predicted,
            coarse_m=coarse,
            coarse_along_m=along,
            sharpest=np.maximum.accumulate(np.concatenate([[0.0], curvature, [0.0]])),
        )

    def project(self, query_m: Floats) -> tuple[Floats, polylines.Projection]:
        """Arc lengths (G) of the points nearest to queries (G, 2), and their projection."""
        foot = polylines.project(self.coarse_m, query_m)
        coarse_length = polylines.arc_lengths(self.coarse_m)
        return np.interp(foot.along_m, coarse_length, self.coarse_along_m), foot

    def curvature(self, along_m: Floats) -> Floats:
        """Sharpest curvature on the way to arc lengths (...)."""
        vertex = np.searchsorted(self.coarse_along_m, along_m, side="right") - 1
        worst: Floats = self.sharpest[np.maximum(vertex, 0)]
        return worst


def own_paths(own: Forecast, start: Start) -> list[OwnPath]:
    """The modes' distinct paths, likeliest first; modes on the same path give its longest."""
    points = [
        _moving(np.concatenate([start.position_m[None], mode]))
        for mode in joined(own.futures.position_m, start)
    ]
    lengths = np.array([polylines.arc_lengths(path)[-1] for path in points])
    ends = np.stack([path[-1] for path in points])
    kept: list[int] = []
    covered = np.zeros(len(points), dtype=bool)
    for mode in np.argsort(-lengths, kind="stable"):
        if covered[mode] or (len(points[mode]) < 2 and kept):
            continue
        kept.append(int(mode))
        if len(points[mode]) > 1:
            covered |= polylines.project(_thinned(points[mode]), ends).distance_m < _SAME_PATH_M
    paths = []
    for mode in sorted(kept)[:_PATHS]:
        heading = own.futures.heading_rad[mode, -1] if lengths[mode] > 1.0 else start.heading_rad
        paths.append(OwnPath.of(points[mode], float(heading)))
    return paths


def _thinned(points: Floats) -> Floats:
    """Every fourth point and the last."""
    some: Floats = points[np.unique([*range(0, len(points), _COARSE // 2), len(points) - 1])]
    return some


def _moving(points: Floats) -> Floats:
    """Points without those that repeat their predecessor."""
    moved = np.hypot(*np.diff(points, axis=0).T) > 0.2
    kept: Floats = points[np.concatenate([[True], moved])]
    return kept
