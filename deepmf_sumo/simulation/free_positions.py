"""Free positions on lanes, for a vehicle that SUMO cannot drive from its pose."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Floats, Lane, RoadMap
from deepmf_sumo.geometry import boxes, frames, polylines
from deepmf_sumo.geometry.ground import clear, off_level
from deepmf_sumo.simulation.contacts import overlapping
from deepmf_sumo.simulation.frame import Frame, Pose
from deepmf_sumo.simulation.sumo_api import SumoApi

_REACH_M: Final = 50.0
_EVERY_M: Final = 2.0
_LARGEST_TURN_RAD: Final = np.radians(100.0)
_TURN_COSTS_M: Final = 5.0
"""A radian of turning is as bad as a move of this length."""
_OFF_ROUTE_COSTS_M: Final = 10.0
_SECONDS: Final = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
"""At which the position must be free, if all keep their speed: SUMO does the rest."""
_MARGIN_M: Final = np.array([3.0, 0.4])
"""Added to length and width."""
_AT_ONCE: Final = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class FreePosition:
    """On the middle of a lane: the front bumper, the heading there, an allowed speed."""

    lane_id: str
    front_m: tuple[float, float]
    heading_rad: float
    speed_mps: float
    moved_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """(N) positions in order of cost, and their lanes."""

    front_m: Floats
    z_m: Floats
    heading_rad: Floats
    moved_m: Floats
    lanes: list[Lane]


class FreePositions:
    """Free positions on the lanes of a running simulation, but not inside junctions.

    Args:
        api: knows which vehicle classes may use a lane.
        road: the network; its lanes have SUMO's names.
    """

    def __init__(self, api: SumoApi, road: RoadMap) -> None:
        self._api, self._road = api, road
        self._lanes = [
            lane
            for lane in road.lanes.values()
            if not lane.interpolating and len(lane.centre_m) > 1
        ]
        self._by_id = {lane.id: lane for lane in self._lanes}
        self._low = np.array([lane.centre_m.min(axis=0) for lane in self._lanes]).reshape(-1, 2)
        self._high = np.array([lane.centre_m.max(axis=0) for lane in self._lanes]).reshape(-1, 2)

    def nearest(
        self,
        agent: AgentId,
        frame: Frame,
        size_m: Floats,
        route: Collection[str],
        *,
        on_route: bool = False,
    ) -> FreePosition | None:
        """The best free position within 50 m for an agent, preferably on its route; else None.

        Args:
            agent: a vehicle, one of the N agents of the frame.
            frame: all agents now.
            size_m: (N, 2) lengths and widths.
            route: edges.
            on_route: on no other edges.
        """
        me = frame.ids.index(agent)
        found = self._candidates(frame, me, float(size_m[me, 0]), route)
        speed_mps = float(np.hypot(*frame.velocity_mps[me]))
        for begin in range(0, len(found.lanes), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            limit = [lane.speed_limit_mps or speed_mps for lane in found.lanes[part]]
            speed = np.minimum(speed_mps, limit)
            poses = found.front_m[part], found.heading_rad[part], speed, found.z_m[part]
            for row in np.flatnonzero(_free(poses, me, frame, size_m)):
                lane = found.lanes[begin + row]
                if on_route and _edge(lane) not in route:
                    continue
                if permitted(self._api, agent, lane.id):
                    x, y = found.front_m[begin + row]
                    return FreePosition(
                        lane_id=lane.id,
                        front_m=(float(x), float(y)),
                        heading_rad=float(found.heading_rad[begin + row]),
                        speed_mps=float(speed[row]),
                        moved_m=float(found.moved_m[begin + row]),
                    )
        return None

    def askew_rad(self, lane_id: str, pose: Pose) -> float:
        """Angle between a pose's heading and a lane's direction; 0 inside junctions."""
        lane = self._by_id.get(lane_id)
        if lane is None:
            return 0.0
        along = polylines.project(lane.centre_m, np.array([pose.x_m, pose.y_m])).heading_rad
        return abs(float(frames.difference(along, pose.heading_rad)))

    def _candidates(
        self, frame: Frame, me: int, length_m: float, route: Collection[str]
    ) -> _Candidates:
        heading = float(frame.heading_rad[me])
        front = frame.position_m[me] + length_m / 2 * frames.unit(np.array(heading))
        near = ((self._low <= front + _REACH_M) & (self._high >= front - _REACH_M)).all(axis=1)
        points, headings, costs, lanes = [np.zeros((0, 2))], [np.zeros(0)], [np.zeros(0)], []
        heights = [np.zeros(0)]
        for index in np.flatnonzero(near):
            lane = self._lanes[index]
            length = polylines.arc_lengths(lane.centre_m)
            along = np.arange(length_m, length[-1], _EVERY_M)
            if not len(along):
                continue
            point, direction = polylines.points_at(lane.centre_m, along)
            off_route = _edge(lane) not in route
            costs.append(np.full(len(along), off_route * _OFF_ROUTE_COSTS_M))
            points.append(point)
            headings.append(direction)
            heights.append(np.interp(along, length, lane.z_m))
            lanes += [lane] * len(along)
        point, direction, z = (np.concatenate(one) for one in (points, headings, heights))
        moved = np.hypot(*(point - front).T)
        turned = np.abs(frames.difference(direction, heading))
        cost = np.concatenate(costs) + moved + _TURN_COSTS_M * turned
        cost[(moved > _REACH_M) | (turned > _LARGEST_TURN_RAD)] = np.inf
        cost[off_level(self._road, front, float(frame.z_m[me]), point, z)] = np.inf
        order = [row for row in np.argsort(cost, kind="stable") if np.isfinite(cost[row])]
        return _Candidates(
            point[order], z[order], direction[order], moved[order], [lanes[row] for row in order]
        )


def permitted(api: SumoApi, agent: AgentId, lane_id: str) -> bool:
    """Whether a vehicle may use a lane, by its class."""
    permission, allowed = api.vehicle.getVehicleClass(agent), api.lane.getAllowed(lane_id)
    return (not allowed or permission in allowed) and (
        permission not in api.lane.getDisallowed(lane_id)
    )


def _edge(lane: Lane) -> str:
    return lane.id.rpartition("_")[0]


def _free(
    poses: tuple[Floats, Floats, Floats, Floats], me: int, frame: Frame, size_m: Floats
) -> Bools:
    """(K) whether no agent is in the way at fronts (K, 2), headings, speeds and heights (K)."""
    front, heading, speed, z_m = poses
    others = np.arange(len(frame.ids)) != me
    ahead = speed[:, None] * _SECONDS - size_m[me, 0] / 2
    mine = front[:, None] + ahead[..., None] * frames.unit(heading)[:, None]
    theirs = frame.position_m[others, None] + _SECONDS[:, None] * frame.velocity_mps[others, None]
    hit = boxes.overlap(
        mine[:, None],
        heading[:, None, None],
        size_m[me] + _MARGIN_M,
        theirs[None],
        frame.heading_rad[others, None],
        size_m[others][:, None],
    )
    hit &= ~clear(z_m[:, None], frame.z_m[others])[..., None]
    return np.asarray(~hit.any(axis=(1, 2)), bool)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Occupancy:
    """All N agents around a vehicle, the AV among them; ``size_m`` (N, 2) lengths and widths."""

    frame: Frame
    size_m: Floats
    av_id: AgentId

    def touched(self, agent: AgentId) -> bool:
        """Whether the box of an agent other than the AV overlaps that of ``agent``."""
        frame, me = self.frame, self.frame.ids.index(agent)
        rows = overlapping(me, frame.position_m, frame.heading_rad, self.size_m, frame.z_m)
        return any(frame.ids[row] != self.av_id for row in rows)
