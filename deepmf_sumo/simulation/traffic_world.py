"""A user's SUMO scenario as a stage: SUMO's own traffic, up to the start and on from there."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from deepmf_sumo.datatypes import (
    DT_S,
    HISTORY_STEPS,
    AgentId,
    Command,
    Driver,
    Event,
    Floats,
    SignalState,
    TrafficCase,
    VehicleModel,
)
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry.ground import ground_of
from deepmf_sumo.network.sumo_road import signal_links
from deepmf_sumo.simulation.av import Av, read_pose
from deepmf_sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.simulation.observation import LiveSignals, TrafficReader
from deepmf_sumo.simulation.sumo_api import AV_TYPE, Backend, SumoApi
from deepmf_sumo.simulation.sumo_config import Configuration, Traffic, begun, read_configuration
from deepmf_sumo.simulation.vehicle_control import Crowd, Places, Takeover
from deepmf_sumo.simulation.world import Stage

_LOOK_FURTHER_S = 300.0
"""How far beyond the start a missing AV is looked for, for the message."""


@contextmanager
def opening(
    case: TrafficCase, model: VehicleModel | None, backend: Backend
) -> Iterator[tuple[SumoApi, Stage]]:
    """SUMO, and the stage of it."""
    configuration = read_configuration(case.config, case.sumo_options)
    traffic = Traffic(configuration=configuration, seed=case.seed, model=model)
    with begun(traffic, backend) as api:
        yield api, NetworkStage(api, case, configuration, model)


class NetworkStage:
    """SUMO drives everybody but the AV (as the planner says) and the opponent (where planned)."""

    def __init__(
        self,
        api: SumoApi,
        case: TrafficCase,
        configuration: Configuration,
        model: VehicleModel | None,
    ) -> None:
        self.events: list[Event] = []
        self._api = api
        self._reader = TrafficReader(api)
        self._step = HISTORY_STEPS - 1
        self._av_teleported = False
        self._ground = ground_of(case.road)
        self._note_step_length(configuration)
        _check_start(case, configuration)
        self._frames = self._run_to(case.start_s)
        self._frame = self._frames[-1]
        if case.av_id not in api.vehicle.getIDList():
            raise SimulationError(_absent(api, case))
        if model is not None:
            _set_model(api, case.av_id)
        length = self.body(case.av_id).size_m[0]
        self._av = Av(api, case.av_id, length, read_pose(api, case.av_id, length))
        self._opponent = Takeover(api, self.events, Places(api, case.road))
        self._signals = LiveSignals(api, signal_links(configuration.net))

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

    def av_path(self) -> Floats | None:
        """Centre line ahead of the AV."""
        return self._av.path()

    def av_present(self) -> bool:
        """Whether SUMO still simulates the AV, and has not teleported it."""
        return self._av.present and not self._av_teleported

    def av_leaders(self) -> tuple[AgentId, ...] | None:
        """Whom the planner named or SUMO's model followed in the last step."""
        return self._av.leaders

    def advance(self, command: Command, opponent: AgentId | None, pose: Pose | None) -> Frame:
        """One step of SUMO; an opponent without a pose is SUMO's to drive."""
        self._step += 1
        self._av.drive(command)
        if opponent is not None and pose is not None:
            length = self.body(opponent).size_m[0]
            self._opponent.place(self._step, opponent, pose, length)
        elif opponent is not None and self._opponent.placed() is not None:
            self._opponent.hand_back(self._step, opponent, self._crowd())
        self._api.simulationStep()
        if self._av.present:
            self._av.after_step()
        self._opponent.after_step(self._step)
        poses = self._reader.read()
        av = self._av.id
        if self._av.teleported:
            self._av_teleported = True
            self.events.append(
                Event(step=self._step, agent_id=av, kind="av_teleported", detail="it was stuck")
            )
            poses.pop(av, None)  # what comes after is not the same motion
        if av in poses:
            put = self._av.placed is not None
            shown = self._raised(av, self._av.pose, poses[av][0].z_m, put=put)
            poses[av] = (shown, Driver.PLANNER)
        placed = self._opponent.placed()
        if placed is not None and placed[0] in poses:
            agent, pose = placed
            shown = self._raised(agent, pose, poses[agent][0].z_m, put=True)
            poses[agent] = (shown, Driver.POLICY)
        self._frame = Frame.of_poses(poses)
        return self._frame

    def _raised(self, agent: AgentId, pose: Pose, sumo_z_m: float, *, put: bool) -> Pose:
        """A pose with its height: SUMO's, but of what is put somewhere where roads cross.

        There SUMO takes the nearest lane by x and y alone.
        """
        if not (put and self._ground.has_levels and agent in self._frame.ids):
            return replace(pose, z_m=sumo_z_m)
        row = self._frame.ids.index(agent)
        way = np.array([[self._frame.position_m[row], (pose.x_m, pose.y_m)]])
        z_m = self._ground.follow(way, self._frame.z_m[row : row + 1])
        return replace(pose, z_m=float(z_m[0, 1]))

    def _crowd(self) -> Crowd:
        """Who was where at the end of the last step."""
        size_m = np.array([self.body(agent).size_m[:2] for agent in self._frame.ids])
        return Crowd(frame=self._frame, size_m=size_m, av_id=self._av.id)

    def _run_to(self, start_s: float) -> list[Frame]:
        """Run SUMO up to the start; the frames of the last second."""
        recorded_from = start_s - (HISTORY_STEPS - 1) * DT_S
        if self._api.simulation.getTime() < recorded_from - DT_S / 2:
            self._api.simulationStep(recorded_from)
        frames = [Frame.of_poses(self._reader.read())]
        while self._api.simulation.getTime() < start_s - DT_S / 2:
            self._api.simulationStep()
            frames.append(Frame.of_poses(self._reader.read()))
        return frames[-HISTORY_STEPS:]

    def _note_step_length(self, configuration: Configuration) -> None:
        if abs(configuration.step_s - DT_S) > 1e-9:
            detail = f"{configuration.file.name} asks for {configuration.step_s:g} s, run at 0.1 s"
            event = Event(step=self._step, agent_id="", kind="step_length_changed", detail=detail)
            self.events.append(event)


def _check_start(case: TrafficCase, configuration: Configuration) -> None:
    if case.start_s < configuration.begin_s:
        raise SimulationError(
            f"source.start_s is {case.start_s:g}, but '{case.config}' begins at "
            f"{configuration.begin_s:g} s; choose a later start, or let it begin earlier."
        )


def _set_model(api: SumoApi, av: AgentId) -> None:
    """Give the AV our car-following model, and leave its size and permissions as they were."""
    vehicle = api.vehicle
    size = (vehicle.getLength(av), vehicle.getWidth(av), vehicle.getHeight(av))
    permitted = vehicle.getVehicleClass(av)
    vehicle.setType(av, AV_TYPE)
    vehicle.setVehicleClass(av, permitted)  # a bus may be where a car may not
    vehicle.setLength(av, size[0])
    vehicle.setWidth(av, size[1])
    vehicle.setHeight(av, size[2])


def _absent(api: SumoApi, case: TrafficCase) -> str:
    """Why the AV is not there: the message of the error."""
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
        f"Vehicle '{case.av_id}' is not there at {case.start_s:g} s in '{case.config}' and {when}; "
        f"choose another start{others}."
    )
