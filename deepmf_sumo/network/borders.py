"""Painted lines and road edges of a SUMO network, from the widths of its lanes."""

from collections.abc import Iterable
from typing import Final

import numpy as np
import shapely

from deepmf_sumo.datatypes import Floats, Polyline
from deepmf_sumo.network.net_file import NetEdge, NetFile

BROKEN_WHITE: Final = 1
SOLID_DOUBLE_YELLOW: Final = 7
BOUNDARY: Final = 1
MOUTH_M: Final = 1.0
"""A side of a junction's outline that passes a lane's end this closely is the lane's mouth."""


def borders(
    net: NetFile, lane_ids: Iterable[str]
) -> tuple[tuple[Polyline, ...], tuple[Polyline, ...]]:
    """Lines and road edges.

    Between the lanes of an edge a broken white line; to its left a double yellow one where the
    opposite direction adjoins, else a road edge; to its right a road edge (where traffic keeps
    left, the other way round); around junctions their outline without the mouths of the roads.
    """
    drivable = set(lane_ids)
    roads = [edge for edge in net.edges.values() if not edge.function]
    half = -0.5 if net.left_hand else 0.5  # of a lane's width, towards the opposite direction
    pairs = {(edge.start, edge.end) for edge in roads}
    lines: list[Polyline] = []
    edges: list[Polyline] = []
    for edge in roads:
        lanes = [lane for lane in edge.lanes if lane.id in drivable]
        lines += [
            _beside(lane.id, BROKEN_WHITE, lane.shape_m, half * lane.width_m) for lane in lanes[:-1]
        ]
        if lanes:
            sides = ("right", "left") if net.left_hand else ("left", "right")
            inner, outer = (f"{edge.id}:{side}" for side in sides)
            middle = _beside(inner, 0, lanes[-1].shape_m, half * lanes[-1].width_m)
            edges.append(_beside(outer, BOUNDARY, lanes[0].shape_m, -half * lanes[0].width_m))
            if (edge.end, edge.start) in pairs:
                lines.append(_of_kind(middle, SOLID_DOUBLE_YELLOW))
            else:
                edges.append(_of_kind(middle, BOUNDARY))
    edges += _junction_edges(net, roads)
    return tuple(lines), tuple(edges)


def _of_kind(line: Polyline, kind: int) -> Polyline:
    return Polyline(id=line.id, kind=kind, points_m=line.points_m, z_m=line.z_m)


def _beside(key: str, kind: int, shape_m: Floats, left_m: float) -> Polyline:
    """A line (P, 2) beside a polyline (P, 3): each point moved along the normal of its corner."""
    step = np.diff(shape_m[:, :2], axis=0)
    step /= np.maximum(np.hypot(*step.T), 1e-9)[:, None]
    normal = np.column_stack([-step[:, 1], step[:, 0]])
    ends = np.vstack([normal[:1], normal, normal[-1:]])
    mean = ends[:-1] + ends[1:]
    mean /= np.maximum((mean * ends[1:]).sum(axis=1, keepdims=True), 0.5)
    return Polyline(id=key, kind=kind, points_m=shape_m[:, :2] + left_m * mean, z_m=shape_m[:, 2])


def _junction_edges(net: NetFile, roads: list[NetEdge]) -> list[Polyline]:
    """Sides of junctions' outlines that no lane passes."""
    sides, names = [], []
    for junction in net.junctions:
        ring = junction.shape_m
        if len(ring) > 2:
            following = np.roll(ring, -1, axis=0)
            long = np.hypot(*(following - ring).T) > 0.1
            sides += list(np.stack([ring, following], axis=1)[long])
            names += [f"{junction.id}:{side}" for side in np.flatnonzero(long)]
    ends = [lane.shape_m[[0, -1], :2] for edge in roads for lane in edge.lanes if len(lane.shape_m)]
    if not sides or not ends:
        return []
    segments = shapely.linestrings(np.array(sides))
    tree = shapely.STRtree(np.asarray(shapely.points(np.concatenate(ends))))
    near, _ = tree.query(segments, predicate="dwithin", distance=MOUTH_M)
    mouths = set(near.tolist())
    return [
        Polyline(id=names[index], kind=BOUNDARY, points_m=side, z_m=np.zeros(2))
        for index, side in enumerate(sides)
        if index not in mouths
    ]
