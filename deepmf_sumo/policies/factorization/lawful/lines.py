"""Where the opponent has to stop, and ways to do so."""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.datatypes import DT_S, Bools, Floats, Forecast, Lane, SignalState, View
from deepmf_sumo.geometry import angles, frames, polylines
from deepmf_sumo.policies.factorization.candidates import References
from deepmf_sumo.policies.factorization.lawful.driven import Driven
from deepmf_sumo.policies.factorization.lawful.road_ahead import Ways, width_m
from deepmf_sumo.policies.factorization.own_paths import own_paths
from deepmf_sumo.policies.factorization.tracking import Limits, Start

RED: Final = frozenset({SignalState.STOP, SignalState.ARROW_STOP})
HALT: Final = RED | {SignalState.CAUTION, SignalState.ARROW_CAUTION}
OVER_M: Final = 2.0
"""A front that is so far beyond a line has crossed it, and did not just stop late."""
YELLOW_MPS2: Final = 3.0
RED_MPS2: Final = 5.0
"""Somewhat more than SUMO's drivers brake with for a light that has long been red."""
_STOP_ZONE_M = 6.0
_STOP_MPS = 0.7
"""Slower before a stop sign counts as a stop: drivers roll."""
_STOPS_MPS2 = (1.0, 2.0, 3.0)


class Line(NamedTuple):
    """Where a lane's traffic stops.

    Attributes:
        lane: that it bounds. point_m: (2) on the lane. heading_rad: of the lane there.
        sign: of a stop sign, else of a light.
        brake_mps2: who can stop with so little braking has to.
    """

    lane: Lane
    point_m: Floats
    heading_rad: float
    sign: bool
    brake_mps2: float

    def crossed(self, driven: Driven) -> Bools:
        """(N) futures whose front comes over it; those that stand before a sign may."""
        front = driven.position_m + angles.unit(driven.heading_rad) * driven.size_m[0] / 2
        local = frames.to_local(front, self.point_m, self.heading_rad)
        ahead, left = local[..., 0], local[..., 1]
        over = (ahead > OVER_M) & (np.abs(left) <= width_m(self.lane))
        crossed: Bools = np.asarray(over.any(axis=1))
        if not self.sign:
            lanes = [lane.id for lane in driven.ways.lanes]
            return crossed & driven.ways.driven[:, lanes.index(self.lane.id)]
        waiting = (ahead <= OVER_M) & (ahead > -_STOP_ZONE_M)
        stands = np.asarray((waiting & (driven.speed_mps < _STOP_MPS)).any(axis=1))
        return crossed & ~stands

    def stood(self, driven: Driven, slowest_mps: float) -> bool:
        """Whether who was so slow just now stood before the sign; at lights that does not count."""
        return self.sign and self.before_m(driven) < _STOP_ZONE_M and slowest_mps < _STOP_MPS

    def before_m(self, driven: Driven) -> float:
        """How far the front is before the line now; negative beyond it."""
        start = driven.start
        front = start.position_m + angles.unit(start.heading_rad) * driven.size_m[0] / 2
        ahead, left = frames.to_local(front, self.point_m, self.heading_rad)
        return -float(ahead) if ahead > 0 else float(np.hypot(ahead, left))


def stop_lines(view: View, ways: Ways) -> list[Line]:
    """Lines where one has to stop now on the lanes ahead: at lights, and of stop signs.

    A light's line is where the lane behind it begins.
    """
    lines = []
    known = {lane.id: lane for lane in ways.lanes if len(lane.centre_m) > 1}
    for lane in known.values():
        if view.signals.get(lane.id) in HALT:
            dx, dy = lane.centre_m[1] - lane.centre_m[0]
            brake = RED_MPS2 if view.signals[lane.id] in RED else YELLOW_MPS2
            lines.append(Line(lane, lane.centre_m[0], float(np.arctan2(dy, dx)), False, brake))
    for sign in view.road.stop_signs:
        for lane in (known[name] for name in sign.lane_ids if name in known):
            foot = polylines.project(lane.centre_m, sign.position_m)
            point, _ = polylines.points_at(lane.centre_m, foot.along_m)
            lines.append(Line(lane, point, float(foot.heading_rad), True, RED_MPS2))
    return lines


def stops(modes: Forecast, start: Start, limits: Limits) -> References:
    """Ways to stop along each of the opponent's own paths, gently to firmly."""
    steps = modes.futures.position_m.shape[1]
    seconds = (np.arange(steps) + 1) * DT_S
    brakes = [one for one in _STOPS_MPS2 if one < limits.brake] + [limits.brake]
    found = []
    for path in own_paths(modes, start):
        for brake in brakes:
            busy = np.minimum(seconds, start.speed_mps / brake)
            driven = start.speed_mps * busy - brake * busy**2 / 2
            found.append(polylines.points_at(path.points_m, driven)[0])
    return References.of("stop", np.stack(found), limits.rows(len(found)))
