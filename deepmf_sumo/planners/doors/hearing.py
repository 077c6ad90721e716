"""What a planner outside the simulation is told, made a case and views again."""

from pathlib import Path
from typing import Final

import numpy as np
from pydantic import ValidationError

from deepmf_sumo.datatypes import (
    Case,
    Command,
    Floats,
    Lane,
    NetworkSource,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    StopSign,
    SumoNet,
    Tracks,
    VehicleModel,
    View,
)
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.doors.messages import (
    ASKED,
    PROTOCOL,
    LaneMessage,
    LineMessage,
    Reset,
    RoadMessage,
    ViewMessage,
)

_NOWHERE: Final = Path("told-to-a-planner")


def read(text: bytes) -> Reset | ViewMessage:
    """What is asked. Raises PlannerError where it is none of the protocol's questions."""
    try:
        return ASKED.validate_json(text)
    except ValidationError as error:
        raise PlannerError(f"not a question of protocol {PROTOCOL}: {error}") from None


def case_of(told: Reset) -> Case:
    """The case, without what planners are not told: recordings, networks, who drives the others."""
    ghost = {"scene": _nobody(told), "net": SumoNet(file=_NOWHERE, ghost_edge="told")}
    open_road = {"network": NetworkSource(config=_NOWHERE, start_s=0.0)}
    return Case(
        name=told.case,
        road=_road(told.road),
        av_id=told.av_id,
        duration_steps=told.steps,
        traffic="sumo",
        seed=told.seed,
        **(ghost if told.own_lane else open_road),
    )


def view_of(told: ViewMessage, road: RoadMap) -> View:
    """The view, equal to the simulation's but for what the map leaves out, and who drove before."""
    agents = told.agents
    steps = len(agents[0].valid) if agents else 0
    shape = (len(agents), steps)
    columns = {
        name: np.array([getattr(one, name) for one in agents], float).reshape(shape)
        for name in ("x_m", "y_m", "z_m", "heading_rad", "vx_mps", "vy_mps")
    }
    return View(
        step=told.step,
        dt_s=told.dt_s,
        av_id=told.av_id,
        history=Tracks(
            ids=tuple(one.id for one in agents),
            kinds=tuple(one.kind for one in agents),
            size_m=np.array([one.size_m for one in agents], float).reshape(-1, 3),
            position_m=np.stack([columns["x_m"], columns["y_m"]], -1),
            z_m=columns["z_m"],
            heading_rad=columns["heading_rad"],
            velocity_mps=np.stack([columns["vx_mps"], columns["vy_mps"]], -1),
            valid=np.array([one.valid for one in agents], bool).reshape(shape),
        ),
        road=road,
        signals={lane: SignalState[name] for lane, name in told.signals.items()},
        steps_left=told.steps_left,
        av_path_m=None if told.av_path_m is None else np.array(told.av_path_m, float),
    )


def ready_answer(model: VehicleModel | None) -> dict[str, object]:
    """Answer to a reset."""
    names = VehicleModel.__dataclass_fields__
    told = None if model is None else {name: getattr(model, name) for name in names}
    return {"type": "ready", "protocol": PROTOCOL, "model": told}


def command_answer(command: Command, step: int) -> dict[str, object]:
    """Answer to a view."""
    used = {
        "sumo": (),
        "speed": ("speed_mps",),
        "leader": ("gap_m", "leader_mps"),
        "pose": ("x_m", "y_m", "heading_rad", "speed_mps"),
    }[command.kind]
    return {
        "type": "command",
        "step": step,
        "kind": command.kind,
        "leader_id": command.leader_id,
        **{name: float(getattr(command, name)) for name in used},
    }


def _road(told: RoadMessage | None) -> RoadMap:
    if told is None:
        return RoadMap(lanes={})
    return RoadMap(
        lanes={one.id: _lane(one) for one in told.lanes},
        lines=tuple(_line(one) for one in told.lines),
        edges=tuple(_line(one) for one in told.edges),
        polygons=tuple(
            Polygon(
                id=one.id, kind=one.kind, points_m=_points(one.points_m), z_m=_flat(one.points_m)
            )
            for one in told.areas
        ),
        stop_signs=tuple(
            StopSign(
                id=one.id,
                position_m=np.array(one.position_m),
                z_m=0.0,
                lane_ids=tuple(one.lane_ids),
            )
            for one in told.stop_signs
        ),
    )


def _lane(told: LaneMessage) -> Lane:
    return Lane(
        id=told.id,
        kind=told.kind,
        centre_m=_points(told.centre_m),
        z_m=_flat(told.centre_m),
        width_m=told.width_m,
        speed_limit_mps=told.speed_limit_mps,
        next=tuple(told.next),
        previous=tuple(told.previous),
    )


def _line(told: LineMessage) -> Polyline:
    return Polyline(
        id=told.id, kind=told.kind, points_m=_points(told.points_m), z_m=_flat(told.points_m)
    )


def _points(told: list[list[float]]) -> Floats:
    return np.array(told, float).reshape(-1, 2)


def _flat(told: list[list[float]]) -> Floats:
    return np.zeros(len(told))


def _nobody(told: Reset) -> Scene:
    """A recording in which the AV alone stands at the origin: nothing of the real one is told."""
    one = np.zeros((1, 1))
    return Scene(
        name=told.case,
        source=Source(dataset="", file="", record=0, sha256=""),
        dt_s=told.dt_s,
        now=0,
        timestamps_s=np.zeros(1),
        tracks=Tracks(
            ids=(told.av_id,),
            kinds=("vehicle",),
            size_m=np.zeros((1, 3)),
            position_m=np.zeros((1, 1, 2)),
            z_m=one,
            heading_rad=one,
            velocity_mps=np.zeros((1, 1, 2)),
            valid=np.ones((1, 1), bool),
        ),
        road=_road(told.road),
        signals=Signals(
            lane_ids=(),
            state=np.zeros((0, 1), np.uint8),
            seen=np.zeros((0, 1), bool),
            stop_m=np.zeros((0, 2)),
        ),
        av_id=told.av_id,
    )
