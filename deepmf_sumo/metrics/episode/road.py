"""Whether points are on the road: near the centre line of a lane for cars."""

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, RoadMap
from deepmf_sumo.geometry import polylines

_WIDTH_M = 3.7  # of a lane whose source says nothing
MARGIN_M = 0.5


def on_road(road: RoadMap, points_m: Floats) -> Bools:
    """(N) points (N, 2) within half a lane's width and 0.5 m of its centre line; no cycle lanes."""
    points = np.asarray(points_m, float)
    inside = np.zeros(len(points), dtype=bool)
    if len(points) == 0:
        return inside
    for lane in road.lanes.values():
        if lane.kind == "bike" or len(lane.centre_m) < 2:
            continue
        reach = (lane.width_m or _WIDTH_M) / 2 + MARGIN_M
        low, high = lane.centre_m.min(axis=0) - reach, lane.centre_m.max(axis=0) + reach
        near = ~inside & ((points >= low) & (points <= high)).all(axis=1)
        if near.any():
            inside[near] = polylines.project(lane.centre_m, points[near]).distance_m <= reach
    return inside
