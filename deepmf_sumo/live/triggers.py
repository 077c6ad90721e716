"""When an attack begins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from deepmf_sumo.datatypes import AgentId, Floats
from deepmf_sumo.errors import UsageError
from deepmf_sumo.metrics.conflict import Moving, time_to_collision
from deepmf_sumo.simulation.frame import Frame
from deepmf_sumo.simulation.sumo_api import SumoApi

_FORMS: Final = "time=SECONDS, edge=ID or ttc=SECONDS"


@dataclass(frozen=True, slots=True)
class Moment:
    """What a trigger may look at.

    Attributes:
        time_s: of the simulation.
        may_touch: whether the AV and anybody could touch within a time: a quick look, which is
            never wrong when it says no.
        frame: gives the agents near the AV and their (N, 2) lengths and widths.
    """

    api: SumoApi
    av_id: AgentId
    time_s: float
    may_touch: Callable[[float], bool]
    frame: Callable[[], tuple[Frame, Floats]]


class Trigger(Protocol):
    """Says when an attack is due."""

    @property
    def not_before_s(self) -> float:
        """Time of the simulation before which it does not fire."""
        ...

    def fires(self, moment: Moment) -> bool:
        """Whether one is due now. Asked every 0.1 s while none goes on and the pause is over."""
        ...

    def used(self) -> None:
        """An attack has begun because of it."""
        ...


@dataclass(slots=True)
class AtTime:
    """One attack, as soon as one can begin from a time of the simulation on."""

    time_s: float
    done: bool = False

    @property
    def not_before_s(self) -> float:
        """The time; never again afterwards."""
        return np.inf if self.done else self.time_s

    def fires(self, moment: Moment) -> bool:
        """From the time on, once."""
        return not self.done and moment.time_s >= self.time_s - 1e-6

    def used(self) -> None:
        """Once is enough."""
        self.done = True


@dataclass(frozen=True, slots=True)
class AtEdge:
    """Whenever the AV is on an edge."""

    edge: str

    @property
    def not_before_s(self) -> float:
        """It may at any time."""
        return -np.inf

    def fires(self, moment: Moment) -> bool:
        """Whether it is there."""
        return bool(moment.api.vehicle.getRoadID(moment.av_id) == self.edge)

    def used(self) -> None:
        """Every visit counts."""


@dataclass(frozen=True, slots=True)
class AtTtc:
    """Whenever the AV and anybody would touch within a time if both kept velocity and heading."""

    below_s: float

    @property
    def not_before_s(self) -> float:
        """It may at any time."""
        return -np.inf

    def fires(self, moment: Moment) -> bool:
        """Whether somebody is that near in time."""
        if not moment.may_touch(self.below_s):
            return False
        frame, size_m = moment.frame()
        return least_ttc_s(frame, size_m, moment.av_id) < self.below_s

    def used(self) -> None:
        """Every time counts."""


@dataclass(frozen=True, slots=True)
class Always:
    """Whenever somebody can attack."""

    @property
    def not_before_s(self) -> float:
        """It may at any time."""
        return -np.inf

    def fires(self, moment: Moment) -> bool:  # noqa: ARG002 - as the protocol wants it
        """Always."""
        return True

    def used(self) -> None:
        """Never enough."""


@dataclass(slots=True)
class ByCall:
    """When it is called."""

    called: bool = False

    @property
    def not_before_s(self) -> float:
        """When it is called."""
        return -np.inf if self.called else np.inf

    def fires(self, moment: Moment) -> bool:  # noqa: ARG002 - as the protocol wants it
        """Whether it was called."""
        return self.called

    def used(self) -> None:
        """The call is answered."""
        self.called = False


def parse(texts: Sequence[str]) -> tuple[Trigger, ...]:
    """Triggers as on the command line, ``time=120``, ``edge=A1B1``, ``ttc=2.5``.

    Raises UsageError for anything else.
    """
    return tuple(_parsed(text) for text in texts)


def _parsed(text: str) -> Trigger:
    kind, equals, value = (part.strip() for part in text.partition("="))
    if not (equals and value):
        raise UsageError(f"trigger '{text}': must be {_FORMS}.")
    if kind == "edge":
        return AtEdge(value)
    try:
        seconds = float(value)
    except ValueError:
        seconds = np.nan
    if kind not in {"time", "ttc"} or not 0 <= seconds < np.inf:
        raise UsageError(f"trigger '{text}': must be {_FORMS}.")
    return AtTime(seconds) if kind == "time" else AtTtc(seconds)


def least_ttc_s(frame: Frame, size_m: Floats, av_id: AgentId) -> float:
    """Least time until the AV touches anybody at constant velocity; inf where it never does."""
    me = frame.ids.index(av_id)
    others = np.arange(len(frame.ids)) != me
    count = int(others.sum())
    if count == 0:
        return float("inf")
    av = Moving(
        frame.position_m[[me]].repeat(count, 0),
        frame.heading_rad[[me]].repeat(count),
        frame.velocity_mps[[me]].repeat(count, 0),
        size_m[me],
        frame.z_m[[me]].repeat(count),
    )
    # one size each: length and width are read as rows
    rest = Moving(
        frame.position_m[others],
        frame.heading_rad[others],
        frame.velocity_mps[others],
        size_m[others].T,
        frame.z_m[others],
    )
    return float(time_to_collision(av, rest).min())
