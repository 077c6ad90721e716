"""Vehicles of the recording that are put where they belong at every step."""

from deepmf_sumo.datatypes import AgentId, Tracks
from deepmf_sumo.simulation.av import move
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.log import Log
from deepmf_sumo.simulation.sumo_api import SumoApi
from deepmf_sumo.simulation.vehicle_types import ANY_ROUTE, PLACED_TYPE

_EXACT = 2  # keepRoute: exactly there, on or off the lanes
_ON_ROUTE = 1  # keepRoute: the nearest point of its route


class PlacedVehicles:
    """Agents of a recording in SUMO, by row. An agent that is not put in a step is removed."""

    def __init__(self, api: SumoApi, log: Log, tracks: Tracks) -> None:
        self._api = api
        self._log = log
        self._tracks = tracks
        # plain numbers: these are read for every vehicle at every step
        self._x = log.front_m[..., 0].tolist()
        self._y = log.front_m[..., 1].tolist()
        self._angle = log.angle_deg.tolist()
        self._speed = tracks.speed_mps.tolist()
        self._match = log.match_m.tolist()
        self._inside: set[int] = set()
        self._put: dict[int, float] = {}

    def put_logged(self, row: int, step: int) -> None:
        """Put an agent where the log has it at a step (for the end of the coming step)."""
        name = self._enter(row)
        x, y, angle = self._x[row][step], self._y[row][step], self._angle[row][step]
        self._api.vehicle.moveToXY(name, "", -1, x, y, angle, _EXACT, self._match[row])
        self._put[row] = self._speed[row][step]

    def put(self, row: int, pose: Pose) -> None:
        """Put an agent at a pose."""
        name = self._enter(row)
        move(self._api, name, pose, float(self._tracks.size_m[row, 0]), self._match[row])
        self._put[row] = pose.speed_mps

    def before_step(self) -> None:
        """Remove whoever was not put."""
        for row in sorted(self._inside - self._put.keys()):
            self._api.vehicle.remove(self._tracks.ids[row])
        self._inside = set(self._put)

    def after_step(self) -> None:
        """Tell SUMO the speeds, which followers go by: else they are those of the jumps."""
        ids, tell = self._tracks.ids, self._api.vehicle.setPreviousSpeed
        for row, speed in self._put.items():
            tell(ids[row], speed)
        self._put.clear()

    def _enter(self, row: int) -> str:
        name = self._tracks.ids[row]
        if row not in self._inside:
            add_vehicle(self._api, self._log, self._tracks, row, PLACED_TYPE)
            self._inside.add(row)
        return name


def add_vehicle(api: SumoApi, log: Log, tracks: Tracks, row: int, type_id: str) -> None:
    """Add an agent to SUMO with its size and route; where it is inserted is said by a move."""
    name, vehicle = tracks.ids[row], api.vehicle
    route = ANY_ROUTE
    if row in log.routes:
        route = f"route_{name}"
        if route not in api.route.getIDList():
            api.route.add(route, list(log.routes[row]))
    vehicle.add(name, route, typeID=type_id, departSpeed="0")
    length, width, height = (float(value) for value in tracks.size_m[row])
    vehicle.setLength(name, length)
    vehicle.setWidth(name, width)
    vehicle.setHeight(name, max(height, 0.1))


def move_logged(
    api: SumoApi, log: Log, name: AgentId, row: int, step: int, *, on_route: bool = False
) -> None:
    """Put a vehicle where the log has it at a step; ``on_route`` onto the lane of its route there.

    Otherwise SUMO takes it as one of the nearest lane, whichever that is.
    """
    x, y = log.front_m[row, step]
    angle, match = float(log.angle_deg[row, step]), float(log.match_m[row])
    keep = _ON_ROUTE if on_route else _EXACT
    api.vehicle.moveToXY(name, "", -1, float(x), float(y), angle, keep, match)


def speed_factor(api: SumoApi, route: tuple[str, ...], fastest_mps: float) -> float:
    """With which a vehicle goes as fast as it did, where it did so above the route's limits."""
    limit = max(float(api.lane.getMaxSpeed(f"{edge}_0")) for edge in route)
    return max(1.0, fastest_mps / max(limit, 1.0))


def logged_pose(tracks: Tracks, row: int, step: int) -> Pose:
    """Pose of an agent in the log."""
    x, y = tracks.position_m[row, step]
    return Pose(
        x_m=float(x),
        y_m=float(y),
        heading_rad=float(tracks.heading_rad[row, step]),
        speed_mps=float(tracks.speed_mps[row, step]),
    )
