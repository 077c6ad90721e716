"""The file of changes: strict YAML, like specs."""

from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from deepmf_sumo.spec.document import read
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import Strict

Control = Literal[
    "priority", "priority_stop", "allway_stop", "right_before_left", "left_before_right",
    "traffic_light",
]  # fmt: skip
"""Types of junctions of SUMO that a countermeasure may ask for."""
Seconds = Annotated[float, Field(gt=0, le=60)]
_OF: Final = {
    "signal": ("yellow_s", "all_red_s", "protected_left_s", "cycle"),
    "edge": ("limit_mps", "limit_kmh", "ending_lane_m"),
    "junction": ("control",),
}
"""What is changed -> keys that say how."""


class Change(Strict):
    """One change, of a signal, an edge or a junction.

    Attributes:
        signal: id of a ``tlLogic``; all its programs are changed.
        yellow_s: every green ends with a yellow of at least this time, in s.
        all_red_s: at least this time, in s, lies between a yellow and the next green.
        protected_left_s: left turns that have to find gaps in oncoming traffic get a green of
            their own, of at least this time in s, and are red while oncoming traffic has green.
        cycle: ``keep`` takes the added time from the green before; with ``longer`` the cycle grows.
        edge: id of an edge.
        limit_mps, limit_kmh: of all its lanes.
        ending_lane_m: the edge, on which a lane ends (e.g. the acceleration lane of a ramp),
            becomes this long, in m, at the expense of the edge behind it.
        junction: id of a junction.
        control: who gives way there.
    """

    signal: str | None = None
    yellow_s: Seconds | None = None
    all_red_s: Seconds | None = None
    protected_left_s: Annotated[float, Field(ge=5, le=60)] | None = None
    cycle: Literal["keep", "longer"] = "keep"
    edge: str | None = None
    limit_mps: Annotated[float, Field(gt=0, le=100)] | None = None
    limit_kmh: Annotated[float, Field(gt=0, le=360)] | None = None
    ending_lane_m: Annotated[float, Field(gt=0, le=5000)] | None = None
    junction: str | None = None
    control: Control | None = None

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        given = self.model_fields_set
        things = [name for name in _OF if name in given]
        if len(things) != 1:
            raise _rule("must name one of signal, edge and junction")
        keys = given - {*things, "cycle"}
        foreign = sorted(given - {*things, *_OF[things[0]]})
        if foreign:
            raise _rule(f"'{foreign[0]}' does not go with '{things[0]}'")
        if not keys:
            raise _rule(f"'{things[0]}' needs one of {', '.join(_OF[things[0]])}")
        if {"limit_mps", "limit_kmh"} <= keys:
            raise _rule("give the limit as limit_mps or as limit_kmh")
        return self

    @property
    def limit(self) -> float | None:
        """In m/s."""
        return self.limit_kmh / 3.6 if self.limit_kmh else self.limit_mps

    @property
    def what(self) -> str:
        """Kind and id, e.g. ``signal 'a'``."""
        kind = next(name for name in _OF if name in self.model_fields_set)
        return f"{kind} '{getattr(self, kind)}'"

    @property
    def rebuilds(self) -> bool:
        """Whether netconvert has to build the network again."""
        return self.ending_lane_m is not None or self.control is not None


class Changes(Strict):
    """A file of changes."""

    version: Literal[1]
    changes: Annotated[tuple[Change, ...], Field(strict=False, min_length=1)]


def _rule(text: str) -> PydanticCustomError:
    return PydanticCustomError("rule", "{rule}", {"rule": text})


def load(file: Path) -> tuple[Change, ...]:
    """The changes of a file. Raises SpecError with file, line and key."""
    document = read(file, "a file of changes begins with 'version: 1'")
    found: Changes = checked(Changes, document.values, (), document)
    return found.changes
