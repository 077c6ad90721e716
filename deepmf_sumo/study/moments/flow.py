"""How many vehicles pass each place of a network without an attack, as the survey saw it."""

import numpy as np

from deepmf_sumo.scene import Bools
from deepmf_sumo.study.moments.moment import REACH_M, Flow, off_level, opponents
from deepmf_sumo.sumo.simulation.traffic_survey import Sightings

_APART_M = 10.0 * REACH_M
"""Between sightings of one time and the next: farther than any vehicle looks."""
_MOST = 9
"""Vehicles that are looked at where the nearest may be on a bridge, with the own one."""


def flows(sightings: Sightings, from_s: float | None = None) -> tuple[Flow, ...]:
    """Of all edges and pairs of edges on which vehicles on roads were, by name."""
    able = opponents(sightings)
    rows = np.flatnonzero(able & (sightings.time_s >= (from_s or -np.inf)))
    if not len(rows):
        return ()
    near = accompanied(sightings)[rows]
    edge, following = sightings.edge[rows], sightings.following[rows]
    vehicle = sightings.vehicle[rows]
    found: list[Flow] = []
    goes_on = following >= 0
    for after, kept in ((np.full(len(rows), -1), np.ones(len(rows), bool)), (following, goes_on)):
        keys = np.column_stack([edge, after, vehicle])[kept]
        each, index = np.unique(keys, axis=0, return_inverse=True)
        met = np.zeros(len(each), bool)
        np.logical_or.at(met, index.ravel(), near[kept])
        places, group = np.unique(each[:, :2], axis=0, return_inverse=True)
        many = np.bincount(group.ravel(), minlength=len(places))
        many_met = np.bincount(group.ravel(), weights=met, minlength=len(places))
        found += [
            Flow(
                edge=sightings.edges[before],
                following=sightings.edges[then] if then >= 0 else "",
                vehicles=int(vehicles),
                near=int(those),
            )
            for (before, then), vehicles, those in zip(places, many, many_met, strict=True)
        ]
    return tuple(sorted(found, key=lambda one: (one.edge, one.following)))


def accompanied(sightings: Sightings) -> Bools:
    """(K) whether another vehicle that can attack it is within `REACH_M` at that time."""
    from scipy.spatial import cKDTree  # 0.3 s that only the choice of moments needs

    able = opponents(sightings)
    _, moment = np.unique(sightings.time_s, return_inverse=True)
    points = np.column_stack([sightings.position_m, _APART_M * moment.ravel()])
    found = np.zeros(len(points), bool)
    if able.sum() < 2:  # no other vehicle
        return found
    count = min(_MOST if sightings.ground else 2, int(able.sum()))
    tree = cKDTree(points[able])
    away, near = tree.query(points[able], k=count, distance_upper_bound=REACH_M)
    rows = np.flatnonzero(able)
    for rank in range(1, count):
        there = np.flatnonzero(np.isfinite(away[:, rank]))
        mine, others = rows[there], rows[near[there, rank]]
        found[mine] |= ~off_level(sightings, mine, others)
    return found
