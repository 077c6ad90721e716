"""The AV in SUMO: carries out a planner's commands, one a step."""

from deepmf_sumo.datatypes import DT_S, AgentId, Command, Floats
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry import sumo_frame
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.lane_change import LaneChangeEnd, ShownMotion
from deepmf_sumo.simulation.path import RouteAhead
from deepmf_sumo.simulation.sumo_api import SumoApi

# Bits of speedMode: 1 safe speed, 2 and 4 limits of acceleration and deceleration, 8 right of way,
# 16 red lights.
_OWN_DECISION = 31
# With bit 1 a commanded speed is cut without any limit to braking, with bit 4 SUMO's emergency
# braking is weakened to comfortable braking. So both are off, and the limits are kept here.
_COMMANDED = 24
_NO_CHECKS = 0
_RISE_HELD_MPS = 0.02
_RISE_FREE_MPS = 0.15
_EXACT = 2  # keepRoute: exactly where it is put, on or off the lanes
_MATCH_M = 5.0
_LOOK_M = 100.0
"""Distance within which SUMO's leader of the AV is recorded."""


class Av:
    """The AV.

    Args:
        api: a running SUMO.
        av_id: its id there.
        length_m: of its box.
        start: its pose at the current step.
    """

    def __init__(self, api: SumoApi, av_id: AgentId, length_m: float, start: Pose) -> None:
        self._api = api
        self.id = av_id
        self.length_m = length_m
        self.ahead = RouteAhead(api, av_id)
        self.placed: Pose | None = None
        self.leaders: tuple[AgentId, ...] | None = None
        self._pose = start
        self._motion = ShownMotion(api, av_id, length_m)
        self._lane_change = LaneChangeEnd(api)
        self._previous_mps: float | None = None
        self._commanded_mps: float | None = None
        self._path: Floats | None = None
        self._path_known = False

    @property
    def present(self) -> bool:
        """Whether SUMO still simulates the AV."""
        return self.id in self._api.vehicle.getIDList()

    @property
    def on_lane(self) -> bool:
        """Whether the AV is matched to a lane: off every lane SUMO cannot drive it."""
        return bool(self._api.vehicle.getLaneID(self.id))

    def path(self) -> Floats | None:
        """(P, 2) centre line from the front bumper on, or None off every lane."""
        if not self._path_known:
            self._path, self._path_known = self.ahead.centre_line(), True
        return self._path

    def drive(self, command: Command) -> None:
        """Ask for the command in the coming step."""
        driven, self.placed = self.placed is None, None
        self.leaders = self._followed(command)
        commanded = None
        vehicle = self._api.vehicle
        speed = float(vehicle.getSpeed(self.id))
        if command.kind == "pose":
            if driven:
                self._lane_change.end(self.id)
            self._place(command)
        elif command.kind == "sumo":
            vehicle.setSpeedMode(self.id, _OWN_DECISION)
            vehicle.setSpeed(self.id, -1.0)
        elif command.kind == "leader":
            vehicle.setSpeedMode(self.id, _COMMANDED)
            commanded = self._behind_leader(command, speed)
            vehicle.setSpeed(self.id, commanded)
        elif command.kind == "speed":
            vehicle.setSpeedMode(self.id, _NO_CHECKS)
            vehicle.setSpeed(self.id, max(0.0, command.speed_mps))
        else:
            raise SimulationError(f"The planner gave a command of unknown kind '{command.kind}'.")
        self._previous_mps, self._commanded_mps = speed, commanded

    def after_step(self) -> None:
        """What SUMO has to be told after the step, and where the AV is now."""
        self._path_known = False
        self._lane_change.after_step()
        if self.placed is not None:
            self._api.vehicle.setPreviousSpeed(self.id, max(0.0, self.placed.speed_mps))
            self._motion.restart()
            self._pose = self.placed
        else:
            self._pose = self._motion.advance(self.sumo_pose())

    @property
    def pose(self) -> Pose:
        """Where the AV is shown: where it was put, or as SUMO drives it (`ShownMotion`)."""
        return self._pose

    def sumo_pose(self) -> Pose:
        """Where SUMO has the AV."""
        return read_pose(self._api, self.id, self.length_m)

    def _followed(self, command: Command) -> tuple[AgentId, ...] | None:
        """Whom the planner names, and SUMO's leader on the AV's lanes; None if nobody looks."""
        named = () if command.leader_id is None else (command.leader_id,)
        if command.kind in ("pose", "speed"):
            return named or None
        found = self._api.vehicle.getLeader(self.id, _LOOK_M) if self.on_lane else None
        return named if not found or not found[0] else tuple(dict.fromkeys([*named, str(found[0])]))

    def _place(self, command: Command) -> None:
        self.placed = Pose(
            x_m=command.x_m,
            y_m=command.y_m,
            heading_rad=command.heading_rad,
            speed_mps=command.speed_mps,
        )
        move(self._api, self.id, self.placed, self.length_m, _MATCH_M)

    def _behind_leader(self, command: Command, speed: float) -> float:
        """SUMO's speed behind the leader, but no more than SUMO's own decision lets.

        A commanded speed overrules SUMO's lights, right of way, limits and lane leaders. What SUMO
        itself would have done in the last step is known, but only where that was less than what it
        was commanded: so the acceleration may rise, slowly where it is SUMO's own, and faster
        where SUMO had nothing against the last command.
        """
        vehicle = self._api.vehicle
        gap = command.gap_m - float(vehicle.getMinGap(self.id))  # negative: nearer than wanted
        decel = float(vehicle.getDecel(self.id))
        target = float(vehicle.getFollowSpeed(self.id, speed, gap, command.leader_mps, decel, ""))
        if self._previous_mps is not None:
            own = float(vehicle.getSpeedWithoutTraCI(self.id))
            held = self._commanded_mps is None or own < self._commanded_mps - 1e-6
            rise = _RISE_HELD_MPS if held else _RISE_FREE_MPS
            target = min(target, speed + own - self._previous_mps + rise)
        hardest = speed - float(vehicle.getEmergencyDecel(self.id)) * DT_S
        return max(0.0, hardest, target)


def move(api: SumoApi, vehicle_id: str, pose: Pose, length_m: float, match_m: float) -> None:
    """Put a vehicle exactly there at the end of the coming step.

    ``match_m``: SUMO takes the vehicle as one of a lane if its front is at most so far from it.
    """
    front, angle = sumo_frame.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
    api.vehicle.moveToXY(
        vehicle_id, "", -1, float(front[0]), float(front[1]), float(angle), _EXACT, match_m
    )


def read_pose(api: SumoApi, vehicle_id: str, length_m: float) -> Pose:
    """Box centre of a vehicle."""
    vehicle = api.vehicle
    x_m, y_m, z_m = vehicle.getPosition3D(vehicle_id)
    centre, heading = sumo_frame.from_sumo((x_m, y_m), vehicle.getAngle(vehicle_id), length_m)
    return Pose(
        x_m=float(centre[0]),
        y_m=float(centre[1]),
        heading_rad=float(heading),
        speed_mps=float(vehicle.getSpeed(vehicle_id)),
        z_m=float(z_m),
    )
