"""What a spec may hold, key by key."""

import math
import stat
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationInfo,
    WithJsonSchema,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from deepmf_sumo.errors import nearest
from deepmf_sumo.scene import PersonPlace
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.spec import profiles
from deepmf_sumo.spec.profiles import DEFAULT_RULES, ProfileName
from deepmf_sumo.spec.profiles import wrong as _wrong


def unknown_key(key: str, model: type[BaseModel]) -> str:
    """The rule that an unknown key breaks, with the nearest name."""
    known = ", ".join(model.model_fields) or "none"
    return f"unknown key.{nearest(key, model.model_fields)} Known: {known}"


def _a_version(value: Any) -> Any:
    if type(value) is not int or value not in DEFAULT_RULES:
        raise _wrong(
            "must be 1, 2 or 3, a number without quotes; a later version needs a newer deepmf-sumo"
        )
    return value


Version = Annotated[
    Literal[1, 2, 3],
    BeforeValidator(_a_version),
    Field(description="3; 1 and 2 keep their meaning, see versions"),
]
"""Of specs and plans."""


SEEDS: Final = 2**32
"""Seeds are below: what libraries for learning draw fits."""
Seed = Annotated[int, Field(ge=0, lt=SEEDS)]


class Strict(BaseModel):
    """No unknown keys, no silent conversion of types, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, values: Any) -> Any:
        unknown = (
            [key for key in values if key not in cls.model_fields]
            if isinstance(values, dict)
            else []
        )
        if unknown:
            rule = unknown_key(str(unknown[0]), cls)
            raise PydanticCustomError("unknown", "{rule}", {"rule": rule, "key": unknown[0]})
        return values


def _existing(value: Any, info: ValidationInfo) -> Path:
    """An absolute path; relative ones start at the spec's folder."""
    if not isinstance(value, str):
        raise _wrong("must be a path in text")
    path = placed(Path((info.context or {}).get("folder", ".")), value)
    try:
        kind = path.stat().st_mode
    except (OSError, ValueError):  # not there, too long, or holding a null character
        raise _wrong(f"no such file or folder: {path}") from None
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise _wrong(f"a device, a pipe or a socket, not a file or folder: {path}")
    return path


def placed(folder: Path, name: str) -> Path:
    """The absolute path of a file that a spec in ``folder`` names, with its links followed.

    As it is written where it cannot be: what opens it says so.
    """
    try:
        return (folder / Path(name).expanduser()).resolve()
    except (OSError, ValueError, RuntimeError):  # no such user, a loop of links, a null character
        return folder / name


ExistingPath = Annotated[Path, BeforeValidator(_existing), WithJsonSchema({"type": "string"})]


def _anywhere(value: Any, info: ValidationInfo) -> Path:
    """An absolute path, as `_existing`; what opens it says where it does not exist."""
    if not isinstance(value, str):
        raise _wrong("must be a path in text")
    return placed(Path((info.context or {}).get("folder", ".")), value)


class Av(Strict):
    """The automated vehicle: an id in SUMO's demand."""

    vehicle: str = Field(min_length=1)


Only = Annotated[
    Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(strict=False)] | None,
    Field(description="keep only these road users beside the AV"),
]


class _Source(Strict):
    """What all sources have; written without keys that leave everything as it is.

    So equal specs are written as by earlier versions, which do not know these keys.
    """

    only: Only = None

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = write(self)
        if self.only is None:
            values.pop("only", None)
        return values


PERSON_PLACES: Final[tuple[PersonPlace, ...]] = get_args(PersonPlace)
_Point = Annotated[tuple[float, float], Field(strict=False)]


Who = Literal["existing", "made", "both"]
_FASTEST_MPS: Final = ROAD_USERS["bicycle"].motion.fastest_mps


class GivenPerson(Strict):
    """Somebody whom the spec puts beside the road."""

    road_user: Literal["pedestrian", "bicycle"] = Field(
        default="pedestrian", description="bicycle: a cyclist"
    )
    position_m: _Point = Field(description="x and y in the network, at the start of the episode")
    heading_rad: float = Field(description="counter-clockwise from east")
    speed_mps: float = Field(
        default=0.0, ge=0, le=_FASTEST_MPS, description="along way_m; 0: it stands"
    )
    way_m: Annotated[tuple[_Point, ...], Field(strict=False)] = Field(
        default=(), description="line through the position, from a second before it on to where"
        " it stops; empty: straight on"
    )  # fmt: skip
    place: PersonPlace | Literal["given"] = Field(
        default="given", description="what results call the place"
    )


class WantedPeople(Strict):
    """People in the traffic: those of the demand, or made ones where people could be."""

    who: Who = Field(
        default="made", description="existing: of the demand; made: put there; or both"
    )
    count: int = Field(default=3, ge=1, le=12, description="most people made around each AV")
    places: Annotated[tuple[PersonPlace, ...], Field(strict=False, min_length=1)] = Field(
        default=PERSON_PLACES, description="places to use; each once before a second person"
    )
    given: Annotated[tuple[GivenPerson, ...], Field(strict=False)] = Field(
        default=(), description="these, and nobody else is made"
    )

    @model_validator(mode="after")
    def _made_by_somebody(self) -> "WantedPeople":
        if self.who == "existing" and self.model_fields_set - {"who"}:
            rule = "is for made people: give 'who: made' or 'who: both', or leave it out"
            raise _wrong(rule, min(self.model_fields_set - {"who"}))
        return self

    @property
    def made(self) -> bool:
        """Whether somebody is put there."""
        return self.who != "existing"

    @property
    def own(self) -> bool:
        """Whether the people of the demand are there."""
        return self.who != "made"

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> Any:
        values: dict[str, Any] = write(self)
        if not self.given:
            values.pop("given")
        return self.who if self == WantedPeople(who=self.who) else values


def _one_word(value: Any) -> Any:
    """``people: made`` is short for ``people: {who: made}``."""
    return {"who": value} if isinstance(value, str) else value


_EXISTING: Final = WantedPeople(who="existing")


class FromNetwork(_Source):
    """A SUMO configuration with demand, run by SUMO until ``start_s``."""

    network: ExistingPath = Field(description="a .sumocfg")
    start_s: float = Field(default=0.0, ge=0, description="seconds that SUMO drives alone")
    av: Av = Field(description="id of the vehicle under test")
    sumo_options: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="beside the .sumocfg, as on SUMO's command line"
    )
    people: Annotated[
        WantedPeople, BeforeValidator(_one_word, json_schema_input_type=Who | WantedPeople)
    ] = Field(default=_EXISTING, description="existing, made, both, or a mapping, see people")

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values = super()._written(write)
        if self.people == _EXISTING:
            values.pop("people", None)
        return values


class Moments(Strict):
    """Which vehicles of a network are attacked when; what is not given is chosen."""

    count: int | None = Field(
        default=None, ge=1, le=100_000, description="attacks; 10 by default, or one for each time"
    )
    prefer: Literal["both", "spread", "encounters"] = Field(
        default="spread",
        description="both (in version 3 the default): spread over places and time, at each place"
        " encounters first",
    )
    draw: Literal["spread", "promising"] = Field(
        default="spread",
        description="promising: two of three are drawn where conflicts came near before",
    )
    av: str | None = Field(default=None, min_length=1, description="only this vehicle")
    av_type: str | None = Field(default=None, min_length=1, description="only this type")
    at_s: Annotated[tuple[Annotated[float, Field(ge=0)], ...], Field(strict=False)] = Field(
        default=(), description="only at these times of the simulation"
    )
    junctions: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="only at these junctions, or before them"
    )
    edges: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="only on these edges; the name of a street means all of its edges"
    )
    polygon: ExistingPath | None = Field(
        default=None, description="only within the polygons of this GeoJSON or SUMO file"
    )
    from_s: Annotated[float, Field(ge=0)] | Literal["settled"] | None = Field(
        default=None,
        description="attack from then on; settled (in version 3 the default): once the traffic has"
        " built up",
    )
    until_s: float | None = Field(default=None, ge=0, description="look for moments up to then")
    of: Annotated[Path, BeforeValidator(_anywhere), WithJsonSchema({"type": "string"})] | None = (
        Field(
            default=None,
            description="a result folder of attack, or its moments.csv: the same moments",
        )
    )

    @model_validator(mode="after")
    def _of_says_all(self) -> "Moments":
        for key in ("count", "av", "av_type", "at_s", "junctions", "edges", "polygon"):
            if self.of is not None and getattr(self, key):
                raise _wrong("cannot be given with 'of' (--moments-of): leave one of them out", key)
        if self.of is not None and self.prefer != "spread":
            rule = f"{self.prefer} cannot be given with 'of' (--moments-of): leave one of them out"
            raise _wrong(rule, "prefer")
        if self.of is not None and self.draw != "spread":
            rule = f"{self.draw} cannot be given with 'of' (--moments-of): leave one of them out"
            raise _wrong(rule, "draw")
        return self

    @model_validator(mode="after")
    def _from_goes_with(self) -> "Moments":
        if self.from_s is None:
            return self
        if self.of is not None or self.at_s:
            other = "'of' (--moments-of)" if self.of is not None else "'at_s' (--at)"
            raise _wrong(f"cannot be given with {other}: leave one of them out", "from_s")
        if isinstance(self.from_s, float) and self.from_s >= (self.until_s or math.inf):
            raise _wrong(f"must be earlier than until_s, which is {self.until_s:.12g}", "from_s")
        return self


class FromMoments(FromNetwork):
    """A SUMO configuration of which vehicles and moments to attack are chosen.

    Its runs have a `FromNetwork` each; it has no keys ``start_s``, ``av`` and ``only``.
    """

    start_s: float = Field(default=0.0, exclude=True)
    av: Av = Field(default=Av(vehicle="chosen"), exclude=True)
    only: Only = Field(default=None, exclude=True)
    moments: Moments

    @model_validator(mode="before")
    @classmethod
    def _chosen(cls, values: Any) -> Any:
        for key in ("av", "start_s", "only") if isinstance(values, dict) else ():
            if key in values:
                raise _wrong(f"'{key}' does not go with 'moments'; leave one of them out", key)
        return values

    @model_validator(mode="after")
    def _drawn(self) -> "FromMoments":
        if self.people.given:
            rule = "is for one moment: people are drawn around each AV where moments are chosen"
            raise _wrong(rule, "people.given")
        return self

    def at(self, start_s: float, vehicle: str) -> FromNetwork:
        """The source of one run."""
        return FromNetwork.model_construct(
            network=self.network,
            start_s=start_s,
            av=Av(vehicle=vehicle),
            sumo_options=self.sumo_options,
            people=self.people,
        )


class First(Strict):
    """The first scenes of a recording, in the recording's order."""

    first: int = Field(ge=1)


def _scenes_kind(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "(ids)"
    return "(first)" if isinstance(value, dict | First) else "(all)"


Scenes = Annotated[
    Annotated[Literal["all"], Tag("(all)")]
    | Annotated[tuple[str, ...], Field(strict=False, min_length=1), Tag("(ids)")]
    | Annotated[First, Tag("(first)")],
    Discriminator(_scenes_kind),
]


class FromRecording(_Source):
    """A recorded file, or a folder of them; the format is found by the content."""

    recording: ExistingPath = Field(description="a file or a folder")
    scenes: Scenes = Field(default="all", description="all, a list of ids, or {first: N}")
    start_s: float = Field(
        default=0.0, ge=0, description="seconds of the recording's future that the log drives alone"
    )

    @model_validator(mode="before")
    @classmethod
    def _own_people(cls, values: Any) -> Any:
        if isinstance(values, dict) and "people" in values:
            rule = "is for networks: a recording has its own people, and nobody is made in it"
            raise _wrong(f"{rule}; leave it out", "people")
        return values

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values = super()._written(write)
        if not self.start_s:
            values.pop("start_s", None)
        return values


def _source_kind(value: Any) -> str | None:
    """The union's tag. In brackets: pydantic puts tags between keys when it says where."""
    if isinstance(value, FromMoments):
        return "(moments)"
    if isinstance(value, FromNetwork | FromRecording):
        return "(network)" if isinstance(value, FromNetwork) else "(recording)"
    kinds = ("moments", "network", "recording")
    known = (name for name in kinds if isinstance(value, dict) and name in value)
    return next((f"({name})" for name in known), None)


Source = Annotated[
    Annotated[FromNetwork, Tag("(network)")]
    | Annotated[FromMoments, Tag("(moments)")]
    | Annotated[FromRecording, Tag("(recording)")],
    Discriminator(
        _source_kind,
        custom_error_type="rule",
        custom_error_message="must hold 'network' or 'recording'",
    ),
]


class Plugin(BaseModel):
    """A plug-in by name; all other keys are its settings."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    name: str = Field(min_length=1)

    @property
    def settings(self) -> dict[str, Any]:
        """The settings as written, without the plug-in's defaults."""
        return dict(self.model_extra or {})


class SearchBudget(Strict):
    """What the adversary may spend on a run, whichever runs out first; else its own default."""

    simulations: int | None = Field(
        default=None, ge=1, description="most simulated episodes of a run"
    )
    seconds: float | None = Field(default=None, gt=0, description="most wall time of a run")


class Turns(Strict):
    """With ``opponents: in_turn``: when an opponent's turn ends, and which vehicle may be next."""

    longest_s: float = Field(default=15.0, ge=3.0, description="longest turn of an opponent")
    reach_m: float = Field(default=80.0, gt=0, description="farther from the AV is out of reach")
    harmless_s: float = Field(
        default=4.0,
        gt=0,
        description="a turn ends after this time without a plan that hits the predicted AV",
    )
    again_after_s: float = Field(
        default=30.0, ge=0, description="time before a vehicle attacks again, unless no other can"
    )
    clear_s: float = Field(
        default=10.0,
        ge=0,
        description="time for the AV to move away from all vehicles after a turn",
    )


class Bound(Strict):
    """A metric's value must lie in [min, max]; a metric without a value does not hold."""

    min: float | None = None
    max: float | None = None


class Expect(Strict):
    """What must hold in every run of the spec; makes the spec a test."""

    av_collision: bool | None = Field(default=None, description="the AV touches another vehicle")
    outcome: (
        Literal["av_opponent", "av_other", "opponent_other", "supporter_other", "none"] | None
    ) = Field(
        default=None,
        description="as in `runs.csv`: the road users of the decisive contact, or none",
    )
    max_contact_speed_mps: float | None = Field(
        default=None, ge=0, description="of every contact of the AV with any road user"
    )
    metrics: dict[str, Bound] = Field(
        default_factory=dict, description="least and largest value of metrics, by name"
    )


def _weights(value: str, info: ValidationInfo) -> str:
    """A name stays a name; a text with a slash is a folder, relative to the spec."""
    return str(_existing(value, info)) if "/" in value else value


class Spec(Strict):
    """One spec: a source of situations, the planner under test, and its adversary."""

    version: Version
    name: str = Field(min_length=1, max_length=200, description="as tables show it")
    source: Source = Field(description="a moment of a network, chosen moments, or recorded scenes")
    duration_s: float = Field(
        default=8.0, ge=0.1, le=3600, description="length of an episode, unless a hit ends it"
    )
    traffic: Literal["log", "sumo"] = Field(
        description="what drives the other vehicles; by default log for recordings, sumo for"
        " networks"
    )
    planner: Plugin = Field(default=Plugin(name="idm"), description="what drives the AV")
    av_sees: Literal["all", "in_sight"] = Field(
        default="all",
        description="whom the planner gets to see: all road users, or those that neither vehicles"
        " nor buildings hide",
    )
    profile: ProfileName = Field(
        default=profiles.DEFAULT, description="the kind of attack, see profiles; of version 3"
    )
    adversary: Plugin = Field(default=Plugin(name="deepmf"), description="the method that attacks")
    opponents: Literal["one", "in_turn"] = Field(
        default="one",
        description="one, whose hit ends the episode; or one after another until it is over, by"
        " default above 15 s",
    )
    turns: Turns = Field(default=Turns(), description="of opponents that attack in turn")
    budget: SearchBudget = Field(
        default=SearchBudget(), description="what the adversary may spend on a run"
    )
    weights: Annotated[str, AfterValidator(_weights)] = Field(
        default="open", description="name of a set of networks, or its folder"
    )
    seed: Seed = Field(default=0, description="of all random choices of the run")
    expect: Expect = Field(default=Expect(), description="what must hold in each run: a test")

    @model_validator(mode="before")
    @classmethod
    def _default_traffic(cls, values: Any) -> Any:
        if isinstance(values, dict) and "traffic" not in values:
            kind = _source_kind(values.get("source"))
            return {**values, "traffic": "log" if kind == "(recording)" else "sumo"}
        return values

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, values: Any) -> Any:
        """What is meant is part of the spec, so that every record of a run names it."""
        return profiles.completed(values) if isinstance(values, dict) else values

    @model_validator(mode="after")
    def _only_recordings_have_a_log(self) -> "Spec":
        if self.traffic == "log" and isinstance(self.source, FromNetwork):
            raise PydanticCustomError(
                "rule", "log is for recordings; a network has traffic: sumo", {"key": "traffic"}
            )
        return self

    @model_validator(mode="after")
    def _turns_need_time(self) -> "Spec":
        if self.opponents == "in_turn" and isinstance(self.source, FromRecording):
            rule = "in_turn is for networks; a recording is too short for several opponents"
            raise PydanticCustomError("rule", "{rule}", {"rule": rule, "key": "opponents"})
        return self

    def resolved(self) -> dict[str, Any]:
        """Plain values with absolute paths, as they are written to a result folder.

        Keys of turns are left out for one opponent, and what the AV sees where it sees all.
        Versions 1 and 2 have none of version 3: such specs equal those of earlier versions.
        """
        without = {"turns"} if self.opponents == "one" else set()
        without |= {"av_sees"} if self.av_sees == "all" else set()
        if self.version < 3:
            without |= {"profile"} | ({"opponents"} if self.opponents == "one" else set())
        return self.model_dump(mode="json", exclude=without)
