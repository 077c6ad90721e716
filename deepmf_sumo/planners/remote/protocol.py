"""Messages between the simulation and a planner outside it: one JSON object each.

::

    simulation                            planner
    {"type": "reset", "protocol": 1, ...} ->
                                          <- {"type": "ready", "protocol": 1}
    {"type": "view", "step": 10, ...}     ->
                                          <- {"type": "command", "step": 10, "kind": "speed", ...}
    {"type": "view", "step": 11, ...}     ->  ...

Metres, seconds, radians counter-clockwise from +x, box centres. Numbers are finite; floats are
written so that they are read back bit for bit. `client` is the simulation's side, `serve` that of a
Python planner.
"""

from typing import Annotated, Any, Final, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator
from pydantic.json_schema import models_json_schema

from deepmf_sumo.scene.scene import AgentKind, LaneKind, PolygonKind

PROTOCOL: Final = 1
FASTEST_MPS: Final = 150.0
"""Faster than any road vehicle: a command above it is an error of the planner."""

LONGEST_BYTES: Final = 65_536
"""Limit of an answer; a command takes a few hundred bytes."""


class Message(BaseModel):
    """Base of all messages: no unknown keys, strict types, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Model(Message):
    """Parameters of SUMO's IDM for the AV, for planners that leave the AV to SUMO.

    Attributes:
        accel_mps2: largest acceleration. decel_mps2: usual braking.
        emergency_mps2: hardest braking.
        headway_s: time gap to the vehicle ahead. gap_m: least gap to it.
        exponent: of the speed over the desired speed.
        desired_mps: null: the larger of the speed limit and the recorded maximum.
    """

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


class CommandAnswer(Message):
    """Answer to `ViewMessage`; its kind says which numbers it has.

    ``step``: of the view that it answers. ``leader_id``: the vehicle that
    the planner reacts to, if any.
    """

    type: Literal["command"]
    step: int
    leader_id: str | None = None


class SumoAnswer(CommandAnswer):
    """SUMO's own model drives this step."""

    kind: Literal["sumo"]


class SpeedAnswer(CommandAnswer):
    """Drive along the route at this speed after the step."""

    kind: Literal["speed"]
    speed_mps: float = Field(ge=0, le=FASTEST_MPS)


class LeaderAnswer(CommandAnswer):
    """SUMO's model drives behind this leader: gap from bumper to box, its speed along the path."""

    kind: Literal["leader"]
    gap_m: float
    leader_mps: float = Field(ge=-FASTEST_MPS, le=FASTEST_MPS)


class PoseAnswer(CommandAnswer):
    """The AV's box centre, heading and speed (signed) after the step."""

    kind: Literal["pose"]
    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float = Field(ge=-FASTEST_MPS, le=FASTEST_MPS)


AnyCommand = SumoAnswer | SpeedAnswer | LeaderAnswer | PoseAnswer
COMMANDS: Final[dict[str, type[AnyCommand]]] = {
    get_args(model.model_fields["kind"].annotation)[0]: model for model in get_args(AnyCommand)
}
"""The message of each kind of command."""
COMMAND: Final[TypeAdapter[AnyCommand]] = TypeAdapter(
    Annotated[AnyCommand, Field(discriminator="kind")]
)
NUMBERS: Final[dict[str, tuple[str, ...]]] = {
    kind: tuple(name for name, field in model.model_fields.items() if field.annotation is float)
    for kind, model in COMMANDS.items()
}
"""Names of the numbers of each kind of command."""

Points = list[list[float]]


class BesideMessage(Message):
    """Where a lane runs beside another: first and last row of both centre lines."""

    lane_id: str
    self_start: int
    self_end: int
    other_start: int
    other_end: int


class BoundaryMessage(Message):
    """The line that bounds a lane between two rows of its centre line, and its kind."""

    start: int
    end: int
    feature_id: str
    kind: int


class LaneMessage(Message):
    """A lane, as `scene.Lane` has it.

    Attributes:
        centre_m: (P, 2) centre line in driving direction. z_m: (P) its heights.
        interpolating: it connects two other lanes, typically inside a junction.
        next: ids of the lanes after it. previous: ids of the lanes before it.
        left, right: ids of the lanes beside it in the same direction.
        left_beside, right_beside: the same, with where they are beside it.
        left_boundaries, right_boundaries: lines that bound it, with where they do.
        gives_way_to: ids of lanes inside the junction that have priority, and of tracks of trams.
    """

    id: str
    kind: LaneKind
    centre_m: Points
    z_m: list[float]
    interpolating: bool
    width_m: float | None
    speed_limit_mps: float | None
    next: list[str]
    previous: list[str]
    left: list[str]
    right: list[str]
    left_beside: list[BesideMessage]
    right_beside: list[BesideMessage]
    left_boundaries: list[BoundaryMessage]
    right_boundaries: list[BoundaryMessage]
    gives_way_to: list[str]


class LineMessage(Message):
    """A painted line or road edge; ``kind`` numbered as in the Waymo Open Motion Dataset."""

    id: str
    kind: int
    points_m: Points
    z_m: list[float]


class AreaMessage(Message):
    """An area on the road or beside it."""

    id: str
    kind: PolygonKind
    points_m: Points
    z_m: list[float]


class StopSignMessage(Message):
    """A stop sign and the lanes that it governs."""

    id: str
    position_m: list[float]
    z_m: float
    lane_ids: list[str]


class RoadMessage(Message):
    """The map, as `scene.RoadMap` has it.

    Attributes:
        lines: painted on the road. edges: of the road.
        areas: crosswalks, speed bumps and driveways.
        buildings, water: beside the road.
        footways: areas for people, and tracks of trams; null where the source maps none.
    """

    lanes: list[LaneMessage]
    lines: list[LineMessage]
    edges: list[LineMessage]
    areas: list[AreaMessage]
    stop_signs: list[StopSignMessage]
    buildings: list[AreaMessage] = []
    footways: list[AreaMessage] | None = None
    water: list[AreaMessage] = []


class Reset(Message):
    """Start of an episode, answered by `Ready`.

    Attributes:
        episode: its id, in all of its messages: a server may drive several at a time.
        case: name of the scene. seed: of the planner's random numbers.
        dt_s: duration of a step.
        first_step: step of the first view. steps: how many follow.
        own_lane: the AV drives on a separate lane, from which SUMO's model sees no other vehicle.
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

    @model_validator(mode="after")
    def _seeds_a_generator(self) -> Self:
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; it must be 0 or more")
        return self


class AgentMessage(Message):
    """An agent that is there now: H steps of history, the last of them is now.

    Where ``valid`` is false the other numbers of a step mean nothing.
    """

    id: str
    kind: AgentKind
    size_m: list[float] = Field(description="length, width, height")
    x_m: list[float]
    y_m: list[float]
    z_m: list[float]
    heading_rad: list[float]
    vx_mps: list[float]
    vy_mps: list[float]
    valid: list[bool]

    @model_validator(mode="after")
    def _of_equal_lengths(self) -> Self:
        if len(self.size_m) != 3:
            raise ValueError(f"size_m of '{self.id}' has {len(self.size_m)} numbers, not 3")
        for name in ("x_m", "y_m", "z_m", "heading_rad", "vx_mps", "vy_mps"):
            if (count := len(getattr(self, name))) != len(self.valid):
                raise ValueError(
                    f"{name} of '{self.id}' has {count} numbers, and valid has {len(self.valid)}"
                )
        return self


class ViewMessage(Message):
    """What the planner sees at a step, answered by a command.

    Attributes:
        episode: as in the reset. step: answers repeat it.
        steps_left: of the episode.
        agents: all road users that the planner sees, with the AV.
        signals: lane id -> name of its light's state.
        av_path_m: (P, 2) centre line ahead of the AV's front bumper; null off every lane.
        av_recorded_steps: number of the last 10 steps in which the AV moved as recorded.
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
    av_recorded_steps: int = 0

    @model_validator(mode="after")
    def _of_one_time(self) -> Self:
        if len(steps := {len(one.valid) for one in self.agents}) > 1:
            raise ValueError(f"agents have different numbers of steps: {sorted(steps)}")
        return self


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of all messages, under ``$defs``."""
    models: list[type[BaseModel]] = [Reset, Ready, ViewMessage, *COMMANDS.values()]
    _, document = models_json_schema([(model, "validation") for model in models])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Planner doors of deepmf-sumo, protocol {PROTOCOL}",
        **document,
    }


QUESTION: Final[TypeAdapter[Reset | ViewMessage]] = TypeAdapter(
    Annotated[Reset | ViewMessage, Field(discriminator="type")]
)
"""Reads what a planner is asked."""
