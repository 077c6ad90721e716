"""The world of a recorded scene: the AV in SUMO, vehicles that follow the log or SUMO.

SUMO stops for each vehicle that is matched to the AV's lane, and for each foe inside a junction,
wherever it is there: foes in SUMO wait before the junction. Recorded ones wait a few metres inside,
and parked ones half on the lane. Stationary vehicles that do not reach into the AV's swept path are
therefore put on SUMO's ignore lists.
"""

import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepmf_sumo.planners.perception import entries
from deepmf_sumo.scene import (
    AgentId,
    Command,
    Driver,
    Event,
    Floats,
    RecordedCase,
    SignalState,
    Tracks,
    VehicleModel,
)
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.ground import ground_of
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.sumo.simulation.av import LANE_LOST, SumoAv, WayBack
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.sumo.simulation.log_plan import (
    Log,
    check_route,
    log_of,
    recorded_body,
    recorded_frame,
)
from deepmf_sumo.sumo.simulation.observation import ReplayedSignals
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.on_foot import Walk
from deepmf_sumo.sumo.simulation.ownership import LogOwner, NextOwner, logged
from deepmf_sumo.sumo.simulation.shown_motion import FARTHEST_JUMP_M, ShownMotion, read_pose
from deepmf_sumo.sumo.simulation.sumo_api import (
    ANY_ROUTE,
    AV_TYPE,
    PLACED_TYPE,
    STEP_OPTIONS,
    TRAFFIC_TYPE,
    Backend,
    SumoApi,
    running,
    sumo_seed,
    write_types,
)
from deepmf_sumo.sumo.simulation.vehicle_control import CREEP_MPS, SumoOwner, Takeover, move
from deepmf_sumo.sumo.simulation.way_on import WayOn
from deepmf_sumo.sumo.simulation.world import World

_EXACT = 2  # keepRoute: exactly there, on or off the lanes
_ON_ROUTE = 1  # keepRoute: the nearest point of its route
_NEAR_M = 60.0
_MOVED_M = 0.005
_MARGIN_M = 0.2
_IGNORED_BY = ("carFollowModel.ignoreIDs", "junctionModel.ignoreIDs")


class RecordedVehicles:
    """Agents of a recording as vehicles of SUMO, by row."""

    def __init__(self, api: SumoApi, log: Log, tracks: Tracks) -> None:
        self.api, self.log, self.tracks = api, log, tracks
        # plain numbers: these are read for each vehicle at each step
        self._x = log.front_m[..., 0].tolist()
        self._y = log.front_m[..., 1].tolist()
        self._angle = log.angle_deg.tolist()
        self._match = log.match_m.tolist()
        self.speed_mps = tracks.speed_mps.tolist()

    def add(self, row: int, type_id: str) -> None:
        """Add an agent with its size and route; a move says where it is inserted."""
        name, api = self.tracks.ids[row], self.api
        route = ANY_ROUTE
        if row in self.log.routes:
            route = f"route_{name}"
            if route not in api.route.getIDList():
                api.route.add(route, list(self.log.routes[row]))
        api.vehicle.add(name, route, typeID=type_id, departSpeed="0")
        length, width, height = recorded_body(self.tracks, row).size_m
        api.vehicle.setLength(name, length)
        api.vehicle.setWidth(name, width)
        api.vehicle.setHeight(name, max(height, 0.1))

    def insert(
        self,
        row: int,
        step: int,
        type_id: str,
        desired_mps: float | None = None,
        *,
        on_route: bool = False,
    ) -> None:
        """Add an agent where the log has it at a step, for SUMO to drive.

        ``desired_mps``: its own; None: the fastest recorded. ``on_route``: see `move`.
        """
        self.add(row, type_id)
        if desired_mps is None:
            desired_mps = float(self.tracks.speed_mps[row][self.tracks.valid[row]].max())
        limit = max(float(self.api.lane.getMaxSpeed(f"{edge}_0")) for edge in self.log.routes[row])
        factor = max(1.0, desired_mps / max(limit, 1.0))
        self.api.vehicle.setSpeedFactor(self.tracks.ids[row], factor)
        self.move(row, step, on_route=on_route)

    def move(self, row: int, step: int, *, on_route: bool = False) -> None:
        """Put an agent where the log has it at a step; ``on_route``: onto its route's lane there.

        Otherwise SUMO takes it as a vehicle of the nearest lane, whichever that is.
        """
        x, y, angle = self._x[row][step], self._y[row][step], self._angle[row][step]
        keep = _ON_ROUTE if on_route else _EXACT
        name = self.tracks.ids[row]
        self.api.vehicle.moveToXY(name, "", -1, x, y, angle, keep, self._match[row])

    def place(self, row: int, pose: Pose) -> None:
        """Put an agent at a pose."""
        length_m = float(self.tracks.size_m[row, 0])
        move(self.api, self.tracks.ids[row], pose, length_m, self._match[row])


class PlacedVehicles:
    """The agents that are put somewhere at each step. One that is not put is removed."""

    def __init__(self, recorded: RecordedVehicles) -> None:
        self._recorded = recorded
        self._inside: set[int] = set()
        self._put: dict[int, float] = {}

    def put(self, row: int, at: int | Pose) -> None:
        """Put an agent at a pose, or where the log has it at a step."""
        if row not in self._inside:
            self._recorded.add(row, PLACED_TYPE)
            self._inside.add(row)
        if isinstance(at, Pose):
            self._recorded.place(row, at)
            self._put[row] = at.speed_mps
        else:
            self._recorded.move(row, at)
            self._put[row] = self._recorded.speed_mps[row][at]

    def before_step(self) -> None:
        """Remove the agents that were not put."""
        for row in sorted(self._inside - self._put.keys()):
            self._recorded.api.vehicle.remove(self._recorded.tracks.ids[row])
        self._inside = set(self._put)

    def after_step(self) -> None:
        """Tell SUMO the speeds that followers react to: else they would be those of the jumps."""
        ids, tell = self._recorded.tracks.ids, self._recorded.api.vehicle.setPreviousSpeed
        for row, speed in self._put.items():
            tell(ids[row], speed)
        self._put.clear()


class FreeTraffic:
    """Rows of the recording that SUMO drives.

    ``entered``: SUMO has driven them; ``lost``: the log has to drive them.
    """

    def __init__(self, recorded: RecordedVehicles, events: list[Event]) -> None:
        self._recorded = recorded
        self._api, self._tracks = recorded.api, recorded.tracks
        self._events = events
        self._inside: set[int] = set()
        self._motions: dict[int, ShownMotion] = {}
        self._fresh: list[tuple[int, int]] = []
        log = recorded.log
        self.lost: set[int] = {row for row in log.rows if row not in log.routes}
        self.entered: set[int] = set()

    def drives(self, row: int) -> bool:
        """Whether SUMO drives the agent now."""
        return row in self._inside

    def may_enter(self, row: int) -> bool:
        """Whether SUMO can drive the agent and never has; one that has left does not return."""
        return row not in self.lost and row not in self.entered

    def enter(self, row: int, step: int) -> None:
        """Insert the agent with its recorded state at a step."""
        try:
            self._recorded.insert(row, step, TRAFFIC_TYPE)
        except self._api.TraCIException as error:
            self._lose(row, step, f"{str(error).strip()} Replayed from the log.")
            return
        self._inside.add(row)
        self.entered.add(row)
        name, length_m = self._tracks.ids[row], float(self._tracks.size_m[row, 0])
        self._motions[row] = motion = ShownMotion(self._api, name, length_m)
        motion.restart(logged(self._tracks, row, step))
        self._fresh.append((row, step))

    def after_step(self, step: int) -> None:
        """Set the speed of new agents; those that started off their lane are lost."""
        vehicle = self._api.vehicle
        there = set(vehicle.getIDList())
        for row, at in self._fresh:
            name = self._tracks.ids[row]
            if name in there and self._starts_on_lane(row, at):
                vehicle.setPreviousSpeed(name, float(self._tracks.speed_mps[row, at]))
                continue
            if name in there:
                vehicle.remove(name)
            self._lose(row, step, "starts on no lane; replayed from the log")
        self._fresh.clear()
        present = {row for row in self._inside if self._tracks.ids[row] in there}
        self._inside = present - self.lost

    def _starts_on_lane(self, row: int, step: int) -> bool:
        """Whether SUMO has it on a lane, onto which its shown motion comes without a jump.

        SUMO takes the nearest lane, whatever its direction, and turns the vehicle within a step.
        """
        name, vehicle = self._tracks.ids[row], self._api.vehicle
        lane_id = vehicle.getLaneID(name)
        if not lane_id:
            return False
        lane = np.array(self._api.lane.getShape(lane_id), float)[:, :2]
        foot = polylines.project(lane, np.array(vehicle.getPosition(name), float))
        turn = float(frames.difference(foot.heading_rad, self._tracks.heading_rad[row, step]))
        swing_m = float(self._tracks.size_m[row, 0]) * abs(np.sin(turn))
        return bool(np.cos(turn) > 0 and foot.distance_m + swing_m <= FARTHEST_JUMP_M)

    def _lose(self, row: int, step: int, detail: str) -> None:
        self.lost.add(row)
        name = self._tracks.ids[row]
        self._events.append(Event(step=step, agent_id=name, kind="off_network", detail=detail))

    def advance(self) -> dict[AgentId, tuple[Pose, Driver]]:
        """Their poses after a step, from which their shown motion goes on."""
        poses = {}
        for row in sorted(self._inside):
            name = self._tracks.ids[row]
            pose = read_pose(self._api, name, float(self._tracks.size_m[row, 0]))
            poses[name] = (self._motions[row].advance(pose), Driver.SUMO)
        return poses


class _LogOrSumo:
    """The next owner among recorded agents: SUMO of those that it drives, else the log."""

    def __init__(
        self, log: LogOwner, sumo: SumoOwner, sumo_drives: Callable[[AgentId], bool]
    ) -> None:
        self._log, self._sumo, self._sumo_drives = log, sumo, sumo_drives

    def _of(self, agent: AgentId) -> NextOwner:
        return self._sumo if self._sumo_drives(agent) else self._log

    def creep_mps(self, agent: AgentId) -> float:
        """Of its owner."""
        return self._of(agent).creep_mps(agent)

    def takes(self, agent: AgentId, step: int, pose: Pose) -> bool:
        """Of its owner."""
        return self._of(agent).takes(agent, step, pose)

    def clear(self, agent: AgentId, poses: Sequence[Pose]) -> bool:
        """Of its owner."""
        return self._of(agent).clear(agent, poses)

    def lane_cost(self, agent: AgentId, lane_id: str) -> float | None:
        """Of the log: lanes of recordings are not SUMO's, which does not know their names."""
        return self._log.lane_cost(agent, lane_id)

    def walk(self, agent: AgentId, pose: Pose) -> Walk | None:
        """Of the log, which has all pedestrians."""
        return self._log.walk(agent, pose)

    def refusals(self, agents: Collection[AgentId]) -> Mapping[AgentId, str]:
        """Nobody."""
        return self._log.refusals(agents)


_OPTIONS = (
    *("--step-method.ballistic", "true"),  # positions move at the mean speed of a step
    *("--time-to-teleport", "-1"),
    *("--default.speeddev", "0"),
)
_FOLLOW_ROUTE = 513
"""laneChangeMode: change lanes where the route needs it and others leave room, else never."""


@contextmanager
def opened(
    case: RecordedCase, model: VehicleModel | None, backend: Backend
) -> Iterator[tuple[SumoApi, World]]:
    """SUMO, and the world of the case at its current step; SUMO ends with the context."""
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        types = write_types(Path(folder) / "types.add.xml", model)
        arguments = [
            *("-n", str(case.net.file)),
            *("--additional-files", str(types)),
            *("--seed", str(sumo_seed(case.seed))),
            *STEP_OPTIONS,
            *_OPTIONS,
        ]
        with running(arguments, backend) as api:
            yield api, LogWorld(api, case, model)


class LogWorld:
    """The planner drives the AV, the policy the opponent while it has a plan, the log the rest.

    Between plan and log an opponent may have no driver: see `ownership`.
    With ``traffic: sumo`` SUMO drives the rest. Pedestrians, cyclists, and vehicles that stand
    beside the lanes are boxes outside SUMO: SUMO's own perception does not see them, views do. Who
    is driven by the policy is in SUMO as long as that lasts, and SUMO's vehicles brake for it.
    """

    def __init__(self, api: SumoApi, case: RecordedCase, model: VehicleModel | None) -> None:
        self.events: list[Event] = []
        self._api = api
        self._case = case
        self._tracks = case.scene.tracks
        self._log = log_of(case)
        self._ground = ground_of(case.road)
        self._now = self._step = case.scene.now
        self._row = {agent: row for row, agent in enumerate(self._tracks.ids)}
        self._av_row = self._row[case.av_id]
        self._recorded = RecordedVehicles(api, self._log, self._tracks)
        self._placed = PlacedVehicles(self._recorded)
        self._free = FreeTraffic(self._recorded, self.events)
        self._takeover = Takeover(api, self.events)
        self.next_owner: NextOwner = _LogOrSumo(
            LogOwner(self._tracks), SumoOwner(self._takeover, self._occupancy), self._sumo_drives
        )
        self._signals = ReplayedSignals(api, case.net.signals, case.scene.signals, self._log.passed)
        start = logged(self._tracks, self._av_row, self._now)
        length = float(self._tracks.size_m[self._av_row, 0])
        self.av = SumoAv(api, case.av_id, length, start, self._way_back())
        width = float(self._tracks.size_m[self._av_row, 1])
        self._ignored = IgnoredVehicles(api, case.av_id, width)
        self._log_drives = False
        self._opponents: dict[AgentId, Pose] = {}
        self._start(model)
        self._frame = self.history()[-1]

    def _way_back(self) -> WayBack:
        """Of an AV that its planner leaves where SUMO drives nothing."""

        def begin(pose: Pose) -> WayOn:
            z_m = float(self._frame.z_m[self._frame.ids.index(self.av.id)])
            return WayOn(self._case.road, pose, z_m, CREEP_MPS, lambda _: 0.0)

        def clear(poses: Sequence[Pose]) -> bool:
            return self._occupancy(self.av.id).clear(self.av.id, poses)

        return WayBack(begin, clear, lambda: self._note("lane_lost", LANE_LOST))

    def history(self) -> list[Frame]:
        """The recorded steps up to the current one."""
        everyone = np.ones(self._tracks.agents, bool)
        return [recorded_frame(self._tracks, step, everyone) for step in range(self._now + 1)]

    def body(self, agent: AgentId) -> Body:
        """Kind and size as recorded."""
        return recorded_body(self._tracks, self._row[agent])

    def signals(self) -> dict[str, SignalState]:
        """The recorded lights at this step."""
        return self._signals.states(self._step)

    def step(self, command: Command, poses: Mapping[AgentId, Pose | None]) -> Frame:
        """One step; an opponent without a pose is driven like all others."""
        self._step += 1
        step = self._step
        if command.kind != "pose":
            rows = [self._row[agent] for agent in self._frame.ids]
            size = self._tracks.size_m[rows, :2]
            self._ignored.update(self._frame, size, self.av.path())
        av_driver = self._drive_av(command)
        driven = self._drive_opponents(poses)
        self._place_others(step, {self._row[agent] for agent in driven})
        self._signals.show(step)
        self._placed.before_step()
        self._api.simulationStep()
        self._placed.after_step()
        self._free.after_step(step)
        self._takeover.after_step()
        extra: dict[AgentId, tuple[Pose, Driver]] = {}
        if self.av.present:
            self.av.after_step()
            extra[self.av.id] = (self.av.pose, av_driver)
            if step == self._now + 1 and av_driver is Driver.PLANNER and command.kind != "pose":
                self._note_alignment()
        extra |= self._free.advance()
        extra |= {agent: (pose, Driver.POLICY) for agent, pose in driven.items()}
        logged = np.ones(self._tracks.agents, bool)
        logged[[self._row[agent] for agent in extra] + [self._av_row]] = False
        logged[list(self._free.entered - self._free.lost)] = False
        self._frame = recorded_frame(self._tracks, step, logged).with_poses(self._raised(extra))
        return self._frame

    def _sumo_drives(self, agent: AgentId) -> bool:
        return self._free.drives(self._row[agent])

    def _occupancy(self, agent: AgentId) -> Occupancy:  # noqa: ARG002
        """All agents at the end of the last step."""
        rows = [self._row[one] for one in self._frame.ids]
        size_m = self._tracks.size_m[rows, :2]
        return Occupancy(frame=self._frame, size_m=size_m, av_id=self.av.id)

    def _raised(
        self, poses: dict[AgentId, tuple[Pose, Driver]]
    ) -> dict[AgentId, tuple[Pose, Driver]]:
        """Poses with heights, which follow the road from those of the step before.

        An agent that was absent then has the height of the recording.
        """
        before, tracks = self._frame, self._tracks
        last = min(self._step, tracks.steps - 1)
        heights = {agent: tracks.z_m[self._row[agent], last] for agent in poses}
        known = [row for row, agent in enumerate(before.ids) if agent in poses]
        shown = [poses[before.ids[row]][0] for row in known]
        ends = np.array([(pose.x_m, pose.y_m) for pose in shown]).reshape(-1, 2)
        ways = np.stack([before.position_m[known], ends], axis=1)
        climbed = self._ground.follow(ways, before.z_m[known])[:, 1]
        heights.update(zip([before.ids[row] for row in known], climbed, strict=True))
        return {
            agent: (replace(pose, z_m=float(heights[agent])), driver)
            for agent, (pose, driver) in poses.items()
        }

    def _start(self, model: VehicleModel | None) -> None:
        """Insert all agents where the recording has them now; the first step leaves them there."""
        tracks, row, name = self._tracks, self._av_row, self._case.av_id
        check_route(self._case)
        route = self._log.routes[row]
        self._api.route.add(ANY_ROUTE, [route[0]])
        self._insert_av(model, on_route=False)
        if not self.av.on_lane:
            self._log_drives = True
            self._note("off_network", "the log drives the AV until it reaches a lane")
        elif tuple(self._api.vehicle.getRoute(name)) != route:
            # SUMO took it as a vehicle of a lane off its route, and dropped the route for it
            self._api.vehicle.remove(name)
            self._settle()
            self._insert_av(model, on_route=True)
            pose = self.av.sumo_pose()
            x, y = tracks.position_m[row, self._now]
            moved = float(np.hypot(pose.x_m - x, pose.y_m - y))
            if moved >= _MOVED_M:
                self._note("moved_onto_route", f"by {moved:.2f} m: it starts between lanes")
        if self._case.net.ghost_edge is not None:
            detail = "the AV drives on a lane of its own, from which SUMO sees no other vehicle"
            self._note("ghost_edge", detail)
        for lane, phase in self._signals.passed_red.items():
            steps = f"steps {phase.start} to {phase.stop - 1}"
            self._note("red_passed", f"lane {lane} is red in {steps}, the recorded AV drives on")

    def _insert_av(self, model: VehicleModel | None, *, on_route: bool) -> None:
        tracks, row, name = self._tracks, self._av_row, self._case.av_id
        vehicle = self._api.vehicle
        kind, desired = (AV_TYPE, model.desired_mps) if model else (TRAFFIC_TYPE, None)
        self._recorded.insert(row, self._now, kind, desired, on_route=on_route)
        vehicle.setLaneChangeMode(name, _FOLLOW_ROUTE)
        self._settle()
        vehicle.setPreviousSpeed(name, float(tracks.speed_mps[row, self._now]))

    def _settle(self) -> None:
        """A step of SUMO that leaves the recorded agents where they are now."""
        self._place_others(self._now, ())
        self._signals.show(self._now)
        self._placed.before_step()
        self._api.simulationStep()
        self._placed.after_step()
        self._free.after_step(self._now)

    def _note_alignment(self) -> None:
        """Note how far SUMO, which drives along lanes, moves and turns the AV at its start."""
        jump = self.av.begun
        if jump is not None:
            aside = abs(jump.front_m + jump.rear_m) / 2
            turn = np.degrees(abs(jump.front_m - jump.rear_m) / self.av.length_m)
            self._note(
                "aligned", f"onto its lane by SUMO: {aside:.2f} m sideways, {turn:.0f} degrees"
            )

    def _note(self, kind: str, detail: str) -> None:
        self.events.append(Event(step=self._step, agent_id=self.av.id, kind=kind, detail=detail))

    def _drive_av(self, command: Command) -> Driver:
        """Where it starts off every lane, the log drives the AV until SUMO can."""
        tracks, row, step = self._tracks, self._av_row, self._step
        there = step < tracks.steps and bool(tracks.valid[row, step])
        self._log_drives &= there and command.kind != "pose" and not self.av.drivable
        if self._log_drives:
            self.av.place(logged(tracks, row, step))
            return Driver.LOG
        av = self.av
        av.drive(command, av.blocked_by(self._opponents, self._occupancy, self._case.road))
        return Driver.PLANNER

    def _drive_opponents(self, poses: Mapping[AgentId, Pose | None]) -> dict[AgentId, Pose]:
        """Place opponents at their poses, hand the others back; the poses of those placed."""
        for agent, pose in poses.items():
            row = self._row[agent]
            if not self._free.drives(row):
                if pose is not None and self._tracks.kinds[row] != "other":
                    self._placed.put(row, pose)
            elif pose is None:
                self._takeover.hand_back(self._step, agent)
            else:
                self._takeover.place(self._step, agent, pose, float(self._tracks.size_m[row, 0]))
        self._opponents = {agent: pose for agent, pose in poses.items() if pose is not None}
        return self._opponents

    def _place_others(self, step: int, taken: Collection[int]) -> None:
        if step >= self._tracks.steps:
            return
        valid = self._tracks.valid[:, step]
        free = self._case.traffic == "sumo"
        for row in self._log.rows:
            if row in taken or self._free.drives(row) or not valid[row]:
                continue
            if free and self._free.may_enter(row):
                self._free.enter(row, step)
            elif not free or row in self._free.lost:
                self._placed.put(row, step)


class IgnoredVehicles:
    """Keeps SUMO's lists of vehicles that the AV ignores."""

    def __init__(self, api: SumoApi, av_id: AgentId, width_m: float) -> None:
        self._api = api
        self._id = av_id
        self._half_m = width_m / 2 + _MARGIN_M
        self._ignored = ""

    def update(self, frame: Frame, size_m: Floats, path_m: Floats | None) -> None:
        """Set the vehicles to ignore in the coming step.

        Args:
            frame: at the current step.
            size_m: (N, 2) length and width of its agents.
            path_m: centre line ahead of the AV; None off the lanes.
        """
        ids = "" if path_m is None else " ".join(self._beside(frame, size_m, path_m))
        if ids != self._ignored:
            self._ignored = ids
            for key in _IGNORED_BY:
                self._api.vehicle.setParameter(self._id, key, ids)

    def _beside(self, frame: Frame, size_m: Floats, path_m: Floats) -> list[AgentId]:
        near = np.hypot(*(frame.position_m - path_m[0]).T) < _NEAR_M
        slow = np.hypot(*frame.velocity_mps.T) < WAITING_MPS
        rows = [row for row in np.flatnonzero(near & slow) if frame.ids[row] != self._id]
        if not rows:
            return []
        gap, _ = entries(
            path_m, self._half_m, frame.position_m[rows], frame.heading_rad[rows], size_m[rows]
        )
        return [frame.ids[row] for row in np.array(rows)[~np.isfinite(gap)]]
