"""Messages between this program and a remote planner, and what they must contain.

The protocol between a simulation and a planner outside it: one JSON object a message.

::

    simulation                            planner
    {"type": "reset", "protocol": 1, ...} ->
                                          <- {"type": "ready", "protocol": 1}
    {"type": "view", "step": 10, ...}     ->
                                          <- {"type": "command", "step": 10, "kind": "speed", ...}
    {"type": "view", "step": 11, ...}     ->  ...

Metres, seconds, radians counter-clockwise from +x, box centres. Numbers are finite; floats are
written so that they are read back bit for bit.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, TypeAdapter, ValidationError
from pydantic.json_schema import models_json_schema

from deepmf_sumo.datatypes import (
    Case,
    Command,
    Floats,
    Lane,
    Polygon,
    Polyline,
    RecordedCase,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    StopSign,
    SumoNet,
    Tracks,
    TrafficCase,
    VehicleModel,
    View,
)
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.plugins import explain

PROTOCOL: Final = 1
FASTEST_MPS: Final = 150.0
"""Beyond any road vehicle: a command above it is an error of the planner, not a wish."""


class Message(BaseModel):
    """Base of all messages: no unknown keys, strict types, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Model(Message):
    """Parameters of SUMO's IDM for the AV, for planners that leave the AV to SUMO."""

    accel_mps2: float = Field(gt=0)
    decel_mps2: float = Field(gt=0)
    emergency_mps2: float = Field(gt=0)
    headway_s: float = Field(gt=0)
    gap_m: float = Field(ge=0)
    exponent: float = Field(gt=0)
    desired_mps: float | None = Field(default=None, gt=0, le=FASTEST_MPS)


class Ready(Message):
    """Answer to `Reset`. Without a model the vehicle type of the network stays."""

    type: Literal["ready"]
    protocol: Literal[1]
    model: Model | None = None


class _Answer(Message):
    """``step``: of the view that it answers. ``leader_id``: whom the planner reacts to, if any."""

    type: Literal["command"]
    step: int
    leader_id: str | None = None


class SumoAnswer(_Answer):
    """SUMO's own model drives this step."""

    kind: Literal["sumo"]


class SpeedAnswer(_Answer):
    """Drive along the route at this speed after the step."""

    kind: Literal["speed"]
    speed_mps: float = Field(ge=0, le=FASTEST_MPS)


class LeaderAnswer(_Answer):
    """SUMO's model drives behind this leader: gap from bumper to box, its speed along the path."""

    kind: Literal["leader"]
    gap_m: float
    leader_mps: float = Field(ge=-FASTEST_MPS, le=FASTEST_MPS)


class PoseAnswer(_Answer):
    """The AV's box centre, heading and speed (signed) after the step."""

    kind: Literal["pose"]
    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float = Field(ge=-FASTEST_MPS, le=FASTEST_MPS)


CommandAnswer = SumoAnswer | SpeedAnswer | LeaderAnswer | PoseAnswer
ANSWERS: Final[dict[str, type[CommandAnswer]]] = {
    "sumo": SumoAnswer,
    "speed": SpeedAnswer,
    "leader": LeaderAnswer,
    "pose": PoseAnswer,
}

Points = list[list[float]]


class LaneMessage(Message):
    """A lane: (P, 2) centre line in driving direction, ids of lanes after, before and beside it."""

    id: str
    kind: Literal["unknown", "freeway", "street", "bike"]
    centre_m: Points
    width_m: float | None
    speed_limit_mps: float | None
    next: list[str]
    previous: list[str]
    left: list[str]
    right: list[str]


class LineMessage(Message):
    """A painted line or road edge; ``kind`` numbered as in the Waymo Open Motion Dataset."""

    id: str
    kind: int
    points_m: Points


class AreaMessage(Message):
    """A crosswalk, speed bump or driveway."""

    id: str
    kind: Literal["crosswalk", "speed_bump", "driveway"]
    points_m: Points


class StopSignMessage(Message):
    """A stop sign and the lanes that it governs."""

    id: str
    position_m: list[float]
    lane_ids: list[str]


class RoadMessage(Message):
    """The map."""

    lanes: list[LaneMessage]
    lines: list[LineMessage]
    edges: list[LineMessage]
    areas: list[AreaMessage]
    stop_signs: list[StopSignMessage]


class Reset(Message):
    """Start of an episode, answered by `Ready`.

    Attributes:
        episode: which one; the same in all of its messages. A server may drive several at a time.
        first_step: step of the first view. steps: how many follow.
        own_lane: the AV drives on a lane of its own, from which SUMO's model sees nobody.
    """

    type: Literal["reset"]
    protocol: Literal[1]
    episode: str
    case: str
    seed: int
    av_id: str
    dt_s: float
    steps: int
    own_lane: bool
    road: RoadMessage | None


class AgentMessage(Message):
    """An agent that is there now: H steps of history, the last of them is now.

    Where ``valid`` is false the other numbers of a step mean nothing.
    """

    id: str
    kind: Literal["vehicle", "pedestrian", "cyclist", "other"]
    size_m: list[float] = Field(description="length, width, height")
    x_m: list[float]
    y_m: list[float]
    z_m: list[float]
    heading_rad: list[float]
    vx_mps: list[float]
    vy_mps: list[float]
    valid: list[bool]


class ViewMessage(Message):
    """What the planner sees at a step, answered by a command.

    Attributes:
        signals: lane id -> name of its light's state.
        av_path_m: (P, 2) centre line ahead of the AV's front bumper; null off every lane.
    """

    type: Literal["view"]
    episode: str
    step: int
    dt_s: float
    steps_left: int
    av_id: str
    agents: list[AgentMessage]
    signals: dict[str, str]
    av_path_m: Points | None


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of all messages, under ``$defs``."""
    models: list[type[BaseModel]] = [Reset, Ready, ViewMessage, *ANSWERS.values()]
    _, document = models_json_schema([(model, "validation") for model in models])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Planner doors of deepmf-sumo, protocol {PROTOCOL}",
        **document,
    }


ASKED: Final[TypeAdapter[Reset | ViewMessage]] = TypeAdapter(
    Annotated[Reset | ViewMessage, Discriminator("type")]
)
"""Reads what a planner is asked."""


_NOWHERE: Final = Path("told-to-a-planner")


def read(text: bytes) -> Reset | ViewMessage:
    """What is asked. Raises PlannerError where it is none of the protocol's questions."""
    try:
        return ASKED.validate_json(text)
    except ValidationError as error:
        raise PlannerError(f"not a question of protocol {PROTOCOL}: {error}") from None


def case_of(told: Reset) -> Case:
    """The case, without what planners are not told: recordings, networks, who drives the others."""
    known: dict[str, Any] = {
        "name": told.case,
        "road": _road(told.road),
        "av_id": told.av_id,
        "duration_steps": told.steps,
        "seed": told.seed,
    }
    if told.own_lane:
        net = SumoNet(file=_NOWHERE, ghost_edge="told")
        return RecordedCase(**known, traffic="sumo", scene=_nobody(told), net=net)
    return TrafficCase(**known, config=_NOWHERE, start_s=0.0, net_file=_NOWHERE)


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


LONGEST_BYTES: Final = 65_536
"""Of an answer; a command has some hundred."""

M = TypeVar("M", bound=BaseModel)


def read_ready(who: str, text: bytes) -> VehicleModel | None:
    """The vehicle model that a planner asks for. Raises PlannerError naming ``who``."""
    values = _object(who, text)
    if values.get("protocol") != PROTOCOL:
        raise PlannerError(
            f"{who} speaks protocol {_short(values.get('protocol'))}, this is {PROTOCOL}: answer"
            f' the reset with {{"type": "ready", "protocol": {PROTOCOL}}}.'
        )
    model = _checked(who, Ready, values).model
    return None if model is None else VehicleModel(**model.model_dump())


def read_command(who: str, text: bytes, step: int) -> Command:
    """The command for a step. Raises PlannerError naming ``who``, key, value and rule."""
    values = _object(who, text)
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in ANSWERS:
        raise PlannerError(
            f"{who} answered kind {_short(kind)} at step {step}; known: {', '.join(ANSWERS)}."
        )
    answer = _checked(f"{who} at step {step}", ANSWERS[kind], values)
    if answer.step != step:
        raise PlannerError(f"{who} answered for step {answer.step} when asked for step {step}.")
    return Command(**answer.model_dump(exclude={"type", "step"}))


def _object(who: str, text: bytes) -> dict[str, Any]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        raise PlannerError(
            f"{who} answered {_short(text.decode(errors='replace'))}, which is not JSON; what is"
            " not an answer belongs on stderr."
        ) from None
    if not isinstance(values, dict):
        raise PlannerError(f"{who} answered {_short(values)}, which is not a JSON object.")
    return values


def _checked(who: str, model: type[M], values: dict[str, Any]) -> M:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise PlannerError(f"{who} answered wrongly: {_cut(explain(error, model), 300)}") from None


def _short(value: object) -> str:
    return _cut(repr(value), 80)


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
