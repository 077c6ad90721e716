"""Hand-over of vehicles between the policy and SUMO, and free positions on lanes."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Event, Floats, Lane, RoadMap
from deepmf_sumo.geometry import boxes, frames, polylines
from deepmf_sumo.geometry.ground import clear, off_level
from deepmf_sumo.simulation.av import HandOver, move
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
        self, agent: AgentId, frame: Frame, size_m: Floats, route: Collection[str]
    ) -> FreePosition | None:
        """The best free position within 50 m for an agent, preferably on its route; else None.

        Args:
            agent: a vehicle, one of the N agents of the frame.
            frame: all agents now.
            size_m: (N, 2) lengths and widths.
            route: edges.
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
                if _permitted(self._api, agent, lane.id):
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
            off_route = lane.id.rpartition("_")[0] not in route
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


def _permitted(api: SumoApi, agent: AgentId, lane_id: str) -> bool:
    """Whether a vehicle of this class may use the lane."""
    permission, allowed = api.vehicle.getVehicleClass(agent), api.lane.getAllowed(lane_id)
    return (not allowed or permission in allowed) and (
        permission not in api.lane.getDisallowed(lane_id)
    )


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


_MATCH_M = 5.0
_EXACT = 2  # keepRoute: exactly where it is put
_SNAP_TO_LANE = 0  # keepRoute: the nearest lane
_SNAP_M = 100.0
_BESIDE_M: Final = 0.1
_ASKEW_RAD: Final = np.radians(60.0)


@dataclass(slots=True, kw_only=True)
class _Taken:
    agent: AgentId
    length_m: float
    route: tuple[str, ...]
    pose: Pose


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


class Takeover:
    """The one vehicle that a policy drives in SUMO's traffic.

    Args:
        api: a running SUMO.
        events: notes are added to it.
        positions: for a vehicle that SUMO cannot drive from its pose; None: the nearest lane, free
            or not.
        may_remove: whether a vehicle without a free position is removed from the simulation; else
            it is put on the nearest lane.
    """

    def __init__(
        self,
        api: SumoApi,
        events: list[Event],
        positions: FreePositions | None = None,
        *,
        may_remove: bool = True,
    ) -> None:
        self._api = api
        self._events = events
        self._positions = positions
        self._may_remove = may_remove
        self._hand_over = HandOver(api)
        self._taken: _Taken | None = None
        self._moved: tuple[_Taken, float] | None = None
        self._gone: set[AgentId] = set()

    def placed(self) -> tuple[AgentId, Pose] | None:
        """The vehicle and the pose it was put at in the last step; None while SUMO drives."""
        taken = self._taken
        return None if taken is None else (taken.agent, taken.pose)

    def place(self, step: int, agent: AgentId, pose: Pose, length_m: float) -> None:
        """Put the vehicle at the pose at the end of the coming step."""
        if not self._present(step, agent):
            return
        if self._taken is None or self._taken.agent != agent:  # the last one may have left
            route = tuple(self._api.vehicle.getRoute(agent))
            self._taken = _Taken(agent=agent, length_m=length_m, route=route, pose=pose)
            self._hand_over.take(agent)
        self._taken.pose = pose
        move(self._api, agent, pose, length_m, _MATCH_M)

    def after_step(self, step: int) -> None:
        """Tell SUMO the speed: else it would be that of the jump, cut to the vehicle's limits."""
        self._hand_over.after_step()
        there = self._api.vehicle.getIDList()
        if self._taken is not None and self._taken.agent in there:
            self._api.vehicle.setPreviousSpeed(self._taken.agent, self._taken.pose.speed_mps)
        elif self._taken is not None:
            self._hand_over.lose(self._taken.agent)
            self._taken = None  # if SUMO brings it back, it is somewhere else
        if self._moved is not None and self._moved[0].agent in there:
            taken, speed_mps = self._moved
            self._api.vehicle.setPreviousSpeed(taken.agent, speed_mps)
            self._restore_route(step, taken)
        self._moved = None

    def hand_back(self, step: int, agent: AgentId, around: Occupancy | None = None) -> None:
        """Let SUMO drive the vehicle from the coming step on.

        A vehicle that SUMO could not drive on from its pose (off-centre, against the direction of
        the lane, or overlapping others) is put on the nearest free position of a lane, or removed
        if there is none and that is allowed. It may overlap the AV: SUMO separates the two.

        Args:
            step: now.
            agent: the vehicle.
            around: the agents around it, needed with `FreePositions`; without the vehicle if it is
                on no road, because SUMO teleports it.
        """
        taken = self._taken
        if taken is None or not self._present(step, agent):
            return
        self._taken = None
        self._hand_over.give_back(agent)
        if self._positions is None:
            self._hand_to_nearest_lane(step, taken)
        elif around is None or agent not in around.frame.ids:
            self._note(step, agent, "opponent_gone", "SUMO has taken it off the road")
        elif self._drivable(taken, self._positions, around):
            self._go_on(step, taken)
        else:
            free = self._positions.nearest(agent, around.frame, around.size_m, taken.route)
            if free is not None:
                self._put(step, taken, free)
            elif self._may_remove:
                self._api.vehicle.remove(agent)
                self._note(step, agent, "removed", "no free place on a lane within 50 m")
            else:
                self._hand_to_nearest_lane(step, taken)

    def _go_on(self, step: int, taken: _Taken) -> None:
        self._note(step, taken.agent, "handed_back", "SUMO drives on along the route")
        self._restore_route(step, taken)

    def _hand_to_nearest_lane(self, step: int, taken: _Taken) -> None:
        vehicle, agent = self._api.vehicle, taken.agent
        lane_id = vehicle.getLaneID(agent)
        if lane_id and _permitted(self._api, agent, lane_id):
            self._go_on(step, taken)
            return
        x, y = vehicle.getPosition(agent)
        vehicle.moveToXY(agent, "", -1, x, y, vehicle.getAngle(agent), _SNAP_TO_LANE, _SNAP_M)
        self._note(step, agent, "handed_back", "put on the nearest lane, where SUMO drives on")

    def _drivable(self, taken: _Taken, positions: FreePositions, around: Occupancy) -> bool:
        """Whether SUMO can drive on from the pose of the vehicle.

        Without its sublane model SUMO keeps a vehicle off-centre for ever, where it reaches into
        the next lane unseen, and stops it for good inside a junction under `lanechange.duration`.
        """
        vehicle, agent = self._api.vehicle, taken.agent
        lane_id = vehicle.getLaneID(agent)
        if not lane_id or not _permitted(self._api, agent, lane_id):
            return False
        if around.touched(agent):
            return False
        if positions.askew_rad(lane_id, taken.pose) > _ASKEW_RAD:
            return False
        sublane = float(self._api.simulation.getOption("lateral-resolution")) > 0
        return sublane or abs(vehicle.getLateralLanePosition(agent)) <= _BESIDE_M

    def _put(self, step: int, taken: _Taken, free: FreePosition) -> None:
        edge, _, lane = free.lane_id.rpartition("_")
        angle = float(frames.sumo_angle(free.heading_rad))
        x, y = free.front_m
        self._api.vehicle.moveToXY(taken.agent, edge, int(lane), x, y, angle, _EXACT, _MATCH_M)
        self._moved = taken, free.speed_mps
        detail = f"put on lane {free.lane_id}, {free.moved_m:.1f} m away, where SUMO drives on"
        self._note(step, taken.agent, "handed_back", detail)

    def _restore_route(self, step: int, taken: _Taken) -> None:
        """Send a vehicle that has left its route to its destination."""
        if tuple(self._api.vehicle.getRoute(taken.agent)) == taken.route:
            return
        try:
            self._api.vehicle.changeTarget(taken.agent, taken.route[-1])
        except self._api.TraCIException:
            detail = f"no way back to its destination {taken.route[-1]}"
            self._note(step, taken.agent, "route_lost", detail)

    def _note(self, step: int, agent: AgentId, kind: str, detail: str) -> None:
        self._events.append(Event(step=step, agent_id=agent, kind=kind, detail=detail))

    def _present(self, step: int, agent: AgentId) -> bool:
        present = agent in self._api.vehicle.getIDList()
        if not present and agent not in self._gone:
            self._gone.add(agent)
            self._note(step, agent, "opponent_gone", "left the traffic")
        return present
