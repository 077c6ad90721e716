"""Made people in SUMO: how they get there, how they move, and how they leave the road.

In SUMO a made road user is a vehicle: SUMO's own persons would end the simulation on a network
without footways. It is placed at every step: beside the lanes SUMO's vehicles do not see it; on a
lane they brake for it as for a vehicle (measured with SUMO 1.28: from where its box reaches into
the lane on). Its class is one that may use the nearest lane that is driven on. With the class
``ignoring``, which may be everywhere, SUMO puts it onto walking areas, and dies with the next step.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import AgentId, Floats, MadeRoadUser, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.walkable import Walkable, walkable
from deepmf_sumo.scene.road_users import ROAD_USERS, RoadUser
from deepmf_sumo.sumo.network.carriageway import Carriageway, driver_of
from deepmf_sumo.sumo.simulation.frame import Body, Pose
from deepmf_sumo.sumo.simulation.on_foot import Walk
from deepmf_sumo.sumo.simulation.sumo_api import MADE_TYPE, SumoApi
from deepmf_sumo.sumo.simulation.vehicle_control import move

_AHEAD_M: Final = 0.5
"""The heading on a way is that of the chord from so far behind to so far ahead."""
BESIDE_M: Final = 0.5
"""Between the road and the box of a person who has left it."""
_REACH_M: Final = 25.0
_SPACING_M: Final = 0.5
"""Of the places beside the road that are looked at."""
_ANYWHERE_M: Final = 1000.0
"""SUMO inserts a vehicle near a lane alone; it is put exactly where it belongs all the same."""


def body_of(made: MadeRoadUser) -> Body:
    """Kind and size."""
    one = ROAD_USERS[made.road_user]
    return Body(kind=one.kind, size_m=one.size_m)


def without_attack(made: MadeRoadUser, time_s: float) -> Pose:
    """Where it is at a time, in s after the start, if nobody takes it over.

    It keeps its speed along its way, and brakes as it is planned for its class, to stop at the end
    of the way.
    """
    at, way = np.asarray(made.position_m, float), made.way_m
    if way is None or made.speed_mps <= 0 or len(way) < 2:
        return Pose(
            x_m=float(at[0]),
            y_m=float(at[1]),
            heading_rad=made.heading_rad,
            speed_mps=0.0,
            z_m=made.z_m,
        )
    length_m = float(polylines.arc_lengths(way)[-1])
    begin_m = float(polylines.project(way, at).along_m)
    brake = ROAD_USERS[made.road_user].motion.planned.brake
    gone_m, speed = _braked(made.speed_mps, brake, length_m - begin_m, time_s)
    here_m = begin_m + gone_m
    measured = polylines.Measured(way)
    ends = np.array([max(here_m - _AHEAD_M, 0.0), min(here_m + _AHEAD_M, length_m)])
    (behind, ahead), _ = measured.at(ends)
    place, _ = measured.at(np.array(here_m))
    return Pose(
        x_m=float(place[0]),
        y_m=float(place[1]),
        heading_rad=float(np.arctan2(*(ahead - behind)[::-1])),
        speed_mps=speed,
        z_m=made.z_m,
    )


def _braked(speed: float, brake: float, left_m: float, time_s: float) -> tuple[float, float]:
    """Way gone and speed after a time, of one that comes to rest after ``left_m``."""
    stops_m = min(speed**2 / (2 * brake), left_m)
    if stops_m <= 0:
        return min(speed * time_s, left_m), 0.0 if time_s >= 0 else speed
    brake = speed**2 / (2 * stops_m)
    steady_s = (left_m - stops_m) / speed
    if time_s <= steady_s:
        return speed * time_s, speed
    braking_s = min(time_s - steady_s, speed / brake)
    gone_m = speed * steady_s + speed * braking_s - brake * braking_s**2 / 2
    return gone_m, max(speed - brake * braking_s, 0.0)


class WayOff(Walk):
    """The way of a person off the road: to the nearest place beside the carriageway, to stay.

    Args:
        pose: the last one of the policy.
        user: its class.
        roads: where vehicles drive.
        road: says where people can be.
    """

    def __init__(self, pose: Pose, user: RoadUser, roads: Carriageway, road: RoadMap) -> None:
        limits = user.motion.planned
        here = np.array([pose.x_m, pose.y_m])
        stop_m = pose.speed_mps**2 / (2 * limits.brake)
        comes_to = here + stop_m * frames.unit(np.array(pose.heading_rad))
        away_m = BESIDE_M + max(user.size_m[:2]) / 2
        kept = shapely.buffer(roads.near(here[None], _REACH_M, np.array([pose.z_m])), away_m)
        super().__init__(pose, limits, _beside(comes_to, kept, pose.z_m, walkable(road)))


def _beside(place_m: Floats, kept: BaseGeometry, z_m: float, ground: Walkable) -> Floats | None:
    """The nearest place (2,) that is not in an area, and where people can be; None without any."""
    place = shapely.Point(*place_m)
    if not kept.contains(place):
        return place_m
    border = shapely.boundary(kept)
    nearest = shapely.get_coordinates(shapely.shortest_line(border, place))[:1]
    others = shapely.get_coordinates(shapely.segmentize(border, _SPACING_M))
    order = np.argsort(np.hypot(*(others - place_m).T), kind="stable")
    places = np.concatenate([nearest, others[order]])
    free = np.flatnonzero(ground.holds(places, np.full(len(places), z_m)))
    return places[free[0]] if len(free) else None


class MadePeople:
    """The made people of a running SUMO.

    Args:
        api: a running SUMO.
        made: who is there.
        roads: where vehicles drive.
        road: the map, which says where people can be.

    Attributes:
        ids: of all of them.
    """

    def __init__(
        self,
        api: SumoApi,
        made: Sequence[MadeRoadUser],
        roads: Callable[[], Carriageway],
        road: RoadMap,
    ) -> None:
        self._api, self._roads, self._road = api, roads, road
        self._made = {one.id: one for one in made}
        self.ids = frozenset(self._made)
        self._taken: dict[AgentId, Pose] = {}
        self._leaving: dict[AgentId, WayOff] = {}

    def bodies(self) -> dict[AgentId, Body]:
        """What each is, by id."""
        return {name: body_of(one) for name, one in self._made.items()}

    def enter(self, time_s: float) -> None:
        """Put all of them where they are at a time, in s after the start, with the next step."""
        if not self._made:
            return
        api, routes = self._api, set[str]()
        for name, one in self._made.items():
            pose = without_attack(one, time_s)
            lane = self._roads().lane_at(_place(pose), pose.z_m, road=True)
            if lane is None:
                raise SimulationError("Nobody can be made on a network without a road.")
            route = f"{MADE_TYPE}{lane.edge}"
            if route not in routes:
                routes.add(route)
                api.route.add(route, [lane.edge])
            type_id, permission = MADE_TYPE + one.road_user, driver_of(lane)
            api.vehicletype.setVehicleClass(type_id, permission)  # SUMO asks the type at the start
            api.vehicle.add(name, route, typeID=type_id, departSpeed="0")
            api.vehicle.setVehicleClass(name, permission)
            move(api, name, pose, body_of(one).size_m[0], _ANYWHERE_M)

    def fit(self, agent: AgentId, pose: Pose) -> None:
        """Before it is placed: let it use the nearest lane."""
        vehicle = self._api.vehicle
        if agent not in self._made or agent not in vehicle.getIDList():
            return
        lane = self._roads().lane_at(_place(pose), pose.z_m)
        if lane is not None:
            permission = driver_of(lane)
            if vehicle.getVehicleClass(agent) != permission:
                vehicle.setVehicleClass(agent, permission)

    def poses(
        self,
        time_s: float,
        driven: Mapping[AgentId, Pose | None],
        clear: Callable[[AgentId, Sequence[Pose]], bool],
    ) -> dict[AgentId, Pose]:
        """Where those whom no policy drives are at a time, in s after the start.

        ``driven``: the poses of a policy; who had one before leaves the road.
        """
        found: dict[AgentId, Pose] = {}
        for name, one in self._made.items():
            given = driven.get(name)
            if given is not None:
                self._taken[name] = given
                self._leaving.pop(name, None)
                continue
            if name in self._taken:
                user = ROAD_USERS[one.road_user]
                pose = self._taken.pop(name)
                self._leaving[name] = WayOff(pose, user, self._roads(), self._road)
            if name in self._leaving:
                found[name] = self._leaving[name].next(partial(clear, name))
            else:
                found[name] = without_attack(one, time_s)
        return found


def _place(pose: Pose) -> Floats:
    return np.array([pose.x_m, pose.y_m])
