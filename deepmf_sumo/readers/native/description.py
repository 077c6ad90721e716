"""The JSON part of a native file, checked key by key."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from deepmf_sumo.datatypes import Boundary, Neighbour, Source
from deepmf_sumo.datatypes.road import LaneKind, PolygonKind
from deepmf_sumo.datatypes.scene import AgentKind
from deepmf_sumo.errors import ReaderError

Index = Annotated[int, Field(ge=-1, lt=2**31)]  # -1: WOMD's neighbours may end before they begin
Count = Annotated[int, Field(ge=0, lt=2**31)]
Number = Annotated[int, Field(ge=0, lt=256)]
Positive = Annotated[float, Field(gt=0, lt=1000)]
Ids = list[str]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class Feature(_Strict):
    """What all features of the road have."""

    id: str
    points: Count


class Line(Feature):
    """A painted line or a road edge."""

    kind: Number


class Area(Feature):
    """A polygon."""

    kind: PolygonKind


class Sign(Feature):
    """A stop sign."""

    lane_ids: Ids
    points: Annotated[int, Field(ge=1, le=1)]


class Beside(_Strict):
    """A lane's neighbour."""

    lane_id: str
    self_start: Index
    self_end: Index
    other_start: Index
    other_end: Index

    def made(self) -> Neighbour:
        """As scenes have it."""
        return Neighbour(**dict(self))


class Bound(_Strict):
    """What bounds a lane."""

    start: Index
    end: Index
    feature_id: str
    kind: Number

    def made(self) -> Boundary:
        """As scenes have it."""
        return Boundary(**dict(self))


class LaneDescription(Feature):
    """A lane."""

    kind: LaneKind
    interpolating: bool
    width_m: Positive | None
    speed_limit_mps: Positive | None
    next: Ids
    previous: Ids
    left: list[Beside]
    right: list[Beside]
    left_boundaries: list[Bound]
    right_boundaries: list[Bound]
    gives_way_to: Ids = []


class Road(_Strict):
    """All features, in the order in which their points stand in the arrays."""

    lanes: list[LaneDescription]
    lines: list[Line]
    edges: list[Line]
    polygons: list[Area]
    stop_signs: list[Sign]


class SourceDescription(_Strict):
    """Where the scene came from."""

    dataset: str
    file: str
    record: Count
    sha256: str

    def made(self) -> Source:
        """As scenes have it."""
        return Source(**dict(self))


class Description(_Strict):
    """All of it."""

    name: str
    source: SourceDescription
    dt_s: Positive
    now: Count
    av_id: str
    interest: Ids
    to_predict: Ids
    repairs: Ids
    ids: Ids
    kinds: list[AgentKind]
    signal_lane_ids: Ids
    road: Road


def described(text: bytes) -> Description:
    """The description. Raises ReaderError, naming the key, where it is not one."""
    try:
        return Description.model_validate_json(text)
    except ValidationError as error:
        first: Any = error.errors(include_url=False, include_context=False)[0]
    key = ".".join(str(part) for part in first["loc"])
    where = f"key '{key[:100]}' of its description" if key else "its description"
    raise ReaderError(f"{where}: {first['msg'][:200]}")
