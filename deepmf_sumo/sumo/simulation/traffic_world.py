"""The world of a SUMO configuration: SUMO's own traffic, up to the start and from there on."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import (
    DT_S,
    HISTORY_STEPS,
    AgentId,
    Command,
    Driver,
    Event,
    RoadMap,
    SignalState,
    TrafficCase,
    VehicleModel,
    agent_ids,
)
from deepmf_sumo.scene.geometry.ground import ground_of
from deepmf_sumo.scene.road_users import PEOPLE
from deepmf_sumo.sumo.network.carriageway import carriageway_of
from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.network.sumo_road import signal_links
from deepmf_sumo.sumo.simulation.av import LANE_LOST, SumoAv, WayBack
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose, raised
from deepmf_sumo.sumo.simulation.made_people import MadePeople
from deepmf_sumo.sumo.simulation.observation import LiveSignals
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.ownership import NextOwner
from deepmf_sumo.sumo.simulation.road_users import TrafficReader, kind_of, on_foot
from deepmf_sumo.sumo.simulation.shown_motion import read_pose
from deepmf_sumo.sumo.simulation.sumo_api import AV_TYPE, Backend, SumoApi
from deepmf_sumo.sumo.simulation.sumo_config import (
    Configuration,
    Traffic,
    begun,
    read_configuration,
)
from deepmf_sumo.sumo.simulation.sumo_jumps import SumoJumps
from deepmf_sumo.sumo.simulation.vehicle_control import CREEP_MPS, OwnStop, SumoOwner, Takeover
from deepmf_sumo.sumo.simulation.way_on import WayOn
from deepmf_sumo.sumo.simulation.world import World

_LOOK_FURTHER_S = 300.0
"""Time after the start in which the message looks for a missing AV."""


@contextmanager
def opened(
    case: TrafficCase, model: VehicleModel | None, backend: Backend
) -> Iterator[tuple[SumoApi, World]]:
    """SUMO, and the world of the case at its current step; SUMO ends with the context."""
    configuration = read_configuration(case.config, case.sumo_options)
    traffic = Traffic(configuration=configuration, seed=case.seed, model=model)
    with begun(traffic, backend) as api:
        yield api, TrafficWorld(api, case, configuration, model)


@contextmanager
def opened_plain(case: TrafficCase) -> Iterator[World]:
    """The world of the case, in which SUMO drives the AV as all others, whatever SUMO is held."""
    configuration = read_configuration(case.config, case.sumo_options)
    traffic = Traffic(configuration=configuration, seed=case.seed)
    with begun(traffic, any_model=True) as api:
        yield TrafficWorld(api, case, configuration, None)


class TrafficWorld:
    """The planner drives the AV, the policy the opponent while it has a plan, SUMO the rest.

    Between plan and SUMO an opponent may have no driver: see `ownership`.
    """

    def __init__(
        self,
        api: SumoApi,
        case: TrafficCase,
        configuration: Configuration,
        model: VehicleModel | None,
    ) -> None:
        self.events: list[Event] = []
        self._av_id = case.av_id
        self._api = api
        self._reader = TrafficReader(api, case.av_id)
        self._step = HISTORY_STEPS - 1
        self._driven: set[AgentId] = set()
        self._road, self._ground = case.road, ground_of(case.road)
        self._note_step_length(configuration)
        _check_start(case, configuration)
        footways = partial(footways_of, configuration.net)
        self._takeover = Takeover(api, self.events, leaves=True, footways=footways)
        self._made = self._made_of(case)
        self._frames = self._run_to(case)
        if case.av_id not in api.vehicle.getIDList():
            raise SimulationError(_absent(api, case))
        self._only = None if case.only is None else _named(api, {case.av_id, *case.only})
        if self._only is not None:
            self._leave_out_others(self._only)
            self._frames = [_of_bodies(frame, self._only) for frame in self._frames]
        self._own_people = case.own_people
        if not self._own_people:
            self._leave_out_people(api.vehicle.getIDList())
            self._frames = [self._without_people(frame) for frame in self._frames]
        self._frame = self._frames[-1]
        self._jumps = SumoJumps(api, case.av_id, self.events)
        if detail := self._reader.bodies.stiffened():
            event = Event(step=self._step, agent_id=case.av_id, kind="av_is_stiff", detail=detail)
            self.events.append(event)
        if model is not None:
            _set_model(api, case.av_id)
        length = self.body(case.av_id).size_m[0]
        start = read_pose(api, case.av_id, length)
        self.av = SumoAv(api, case.av_id, length, start, self._way_back(case.road), footways)
        self._own_stop = OwnStop(api, case.av_id, self.events)
        self._own_stop.note(self._step)
        self.next_owner: NextOwner = SumoOwner(self._takeover, self._occupancy, self._made.ids)
        self._signals = LiveSignals(api, signal_links(configuration.net))

    def _way_back(self, road: RoadMap) -> WayBack:
        """Of an AV that its planner leaves where SUMO drives nothing."""

        def begin(pose: Pose) -> WayOn:
            z_m = float(self._frame.z_m[self._frame.ids.index(self.av.id)])
            return WayOn(road, pose, z_m, CREEP_MPS, self.av.lane_cost)

        def clear(poses: Sequence[Pose]) -> bool:
            return self._occupancy(self.av.id).clear(self.av.id, poses)

        def lost() -> None:
            event = Event(step=self._step, agent_id=self.av.id, kind="lane_lost", detail=LANE_LOST)
            self.events.append(event)

        return WayBack(begin, clear, lost)

    def history(self) -> list[Frame]:
        """The last second before the start; frames before the configuration's begin are empty."""
        missing = HISTORY_STEPS - len(self._frames)
        return [Frame.of_poses({})] * missing + self._frames

    def body(self, agent: AgentId) -> Body:
        """Kind and size as SUMO has them."""
        return self._reader.body(agent)

    def signals(self) -> dict[str, SignalState]:
        """States of SUMO's lights now."""
        return self._signals.states()

    def step(self, command: Command, poses: Mapping[AgentId, Pose | None]) -> Frame:
        """One step of SUMO, which drives an opponent without a pose."""
        self._step += 1
        av = self.av
        av.drive(command, av.blocked_by(self._takeover.placed(), self._occupancy, self._road))
        self._driven = {agent for agent, pose in poses.items() if pose is not None}
        made = self._made.poses(self._since_start_s(), poses, self.next_owner.clear)
        for agent, pose in {**poses, **made}.items():
            if pose is not None:
                self._place(agent, pose)
            else:
                self._takeover.hand_back(self._step, agent)
        self._api.simulationStep()
        if self._only is not None:
            self._leave_out_others(self._only)
        if not self._own_people:
            self._leave_out_people(self._api.simulation.getDepartedIDList())
        if self.av.present:
            self.av.after_step()
            self._own_stop.note(self._step)
        self._takeover.after_step()
        found = self._reader.read()
        put = self._takeover.placed().keys() | ({self.av.id} if self.av.placed else set())
        self._jumps.note(self._step, found, put)
        self._frame = self._shown(found)
        return self._frame

    def _shown(self, frame: Frame) -> Frame:
        """What SUMO has after a step, with AV and opponent where they are shown and were put."""
        av = self.av
        if av.teleported:
            av.lost = True  # what comes after is not the same motion
            detail = "it was stuck"
            self.events.append(
                Event(step=self._step, agent_id=av.id, kind="av_teleported", detail=detail)
            )
            frame = frame.without(av.id)
        shown = {}
        if av.id in frame.ids:
            put = av.placed is not None
            shown[av.id] = self._raised(av.id, av.pose, frame, put=put), Driver.PLANNER
        for agent, pose in self._takeover.placed().items():
            if agent in frame.ids:
                driver = Driver.POLICY if agent in self._driven else Driver.SUMO
                shown[agent] = self._raised(agent, pose, frame, put=True), driver
        return frame.with_poses(shown)

    def _raised(self, agent: AgentId, pose: Pose, frame: Frame, *, put: bool) -> Pose:
        """A pose with its height."""
        z_m = float(frame.z_m[frame.ids.index(agent)])
        if not put:
            return replace(pose, z_m=z_m)
        return raised(agent, pose, z_m, self._frame, self._ground)

    def _occupancy(self, agent: AgentId) -> Occupancy:  # noqa: ARG002
        """All agents at the end of the last step."""
        size_m = np.array([self.body(agent).size_m[:2] for agent in self._frame.ids])
        return Occupancy(frame=self._frame, size_m=size_m, av_id=self.av.id)

    def _run_to(self, case: TrafficCase) -> list[Frame]:
        """Run SUMO up to the start; the frames of the last second, with the made people."""
        now, start_s = self._api.simulation.getTime, case.start_s
        recorded_from = start_s - (HISTORY_STEPS - 1) * DT_S
        enters_s = recorded_from - DT_S if case.made else recorded_from
        if now() < enters_s - DT_S / 2:
            self._api.simulationStep(enters_s)
        frames = []
        if case.made:
            self._made.enter(now() + DT_S - start_s)
        else:
            frames.append(self._reader.read())
        while now() < start_s - DT_S / 2:
            if frames:
                self._place_made(now() + DT_S - start_s)
            self._api.simulationStep()
            self._takeover.after_step()
            frames.append(self._with_made(self._reader.read(), now() - start_s))
        return frames[-HISTORY_STEPS:]

    def _made_of(self, case: TrafficCase) -> MadePeople:
        """The made people of a case, known to all who ask what an agent is."""
        only = None if case.only is None else set(case.only)
        made = [one for one in case.made if only is None or one.id in only]
        found = MadePeople(self._api, made, partial(carriageway_of, case.net_file), case.road)
        for agent, body in found.bodies().items():
            self._reader.bodies.declare(agent, body)
        return found

    def _place_made(self, time_s: float) -> None:
        """Where they are at the end of the coming step, before the case has begun."""
        for agent, pose in self._made.poses(time_s, {}, lambda *_: True).items():
            self._place(agent, pose)

    def _place(self, agent: AgentId, pose: Pose) -> None:
        """Put an opponent or a made person somewhere at the end of the coming step."""
        self._made.fit(agent, pose)
        self._takeover.place(self._step, agent, pose, self.body(agent).size_m[0])

    def _with_made(self, frame: Frame, time_s: float) -> Frame:
        """A frame of the history with the made people exactly where they are."""
        made = self._made.poses(time_s, {}, lambda *_: True)
        there = {name: (pose, Driver.SUMO) for name, pose in made.items() if name in frame.ids}
        return frame.with_poses(there)

    def _since_start_s(self) -> float:
        """Time of the end of the coming step."""
        return (self._step - (HISTORY_STEPS - 1)) * DT_S

    def _leave_out_others(self, only: Collection[AgentId]) -> None:
        """Take everybody else off the road, before any of them has moved."""
        vehicle, person = self._api.vehicle, self._api.person
        for name in vehicle.getIDList():
            if name not in only:
                vehicle.remove(name)
        for name in person.getIDList():  # who is in a vehicle stays or goes with it
            if agent_ids.of_person(name) not in only and on_foot(person.getVehicle(name)):
                person.remove(name)

    def _leave_out_people(self, vehicles: Sequence[str]) -> None:
        """Take persons on foot and those of the vehicles that are cyclists off the road."""
        vehicle, person = self._api.vehicle, self._api.person
        for name in vehicles:
            if name != self._av_id and kind_of(vehicle.getVehicleClass(name)) in PEOPLE:
                vehicle.remove(name)
        for name in person.getIDList():
            if on_foot(person.getVehicle(name)):
                person.remove(name)

    def _without_people(self, frame: Frame) -> Frame:
        """The frame without the people of the demand."""
        kept = {self._av_id, *self._made.ids}
        return frame.of_agents(
            {one for one in frame.ids if one in kept or self.body(one).kind not in PEOPLE}
        )

    def _note_step_length(self, configuration: Configuration) -> None:
        if abs(configuration.step_s - DT_S) > 1e-9:
            detail = f"{configuration.file.name} asks for {configuration.step_s:g} s, run at 0.1 s"
            event = Event(step=self._step, agent_id="", kind="step_length_changed", detail=detail)
            self.events.append(event)


def _named(api: SumoApi, only: set[AgentId]) -> set[AgentId]:
    """The named road users, and the vehicles of named parts.

    A person may be named as SUMO has it, unless a vehicle has the name.
    """
    vehicles = set(api.vehicle.getIDList())
    persons = {agent_ids.of_person(name) for name in only - vehicles}
    return only | persons | {agent_ids.whole_of(name) for name in only}


def _of_bodies(frame: Frame, only: Collection[AgentId]) -> Frame:
    """The frame with the named road users and their parts alone."""
    return frame.of_agents({one for one in frame.ids if agent_ids.whole_of(one) in only})


def _check_start(case: TrafficCase, configuration: Configuration) -> None:
    if case.start_s < configuration.begin_s:
        raise SimulationError(
            f"source.start_s is {case.start_s:.12g}, but '{case.config}' begins at "
            f"{configuration.begin_s:.12g} s; choose a later start, or let it begin earlier."
        )


def _set_model(api: SumoApi, av: AgentId) -> None:
    """Give the AV our car-following model; its size and permissions stay as they were."""
    vehicle = api.vehicle
    size = (vehicle.getLength(av), vehicle.getWidth(av), vehicle.getHeight(av))
    permitted = vehicle.getVehicleClass(av)
    vehicle.setType(av, AV_TYPE)
    vehicle.setVehicleClass(av, permitted)  # a bus may be where a car may not
    vehicle.setLength(av, size[0])
    vehicle.setWidth(av, size[1])
    vehicle.setHeight(av, size[2])


def _absent(api: SumoApi, case: TrafficCase) -> str:
    """The message of the error: when the AV is there, and which vehicles are at the start."""
    there = sorted(api.vehicle.getIDList())
    others = (
        f" or one of: {', '.join(there[:8])}{', ...' if len(there) > 8 else ''}" if there else ""
    )
    begin = api.simulation.getTime()
    while api.simulation.getTime() < begin + _LOOK_FURTHER_S:
        api.simulationStep()
        if case.av_id in api.simulation.getDepartedIDList():
            when = f"departs at {api.simulation.getTime():.1f} s"
            break
        if api.simulation.getMinExpectedNumber() == 0:
            when = "never departs after it"
            break
    else:
        when = f"does not depart within {_LOOK_FURTHER_S:g} s after it"
    return (
        f"Vehicle '{case.av_id}' is not there at {case.start_s:.12g} s in '{case.config}' and"
        f" {when}; choose another start{others}."
    )
