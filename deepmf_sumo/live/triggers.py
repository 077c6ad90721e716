"""When an attack begins."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.errors import UsageError
from deepmf_sumo.judge.metrics.conflict import MovingBox, time_to_collision
from deepmf_sumo.live.observer import LiveObserver, Sighting
from deepmf_sumo.scene import AgentId, Floats
from deepmf_sumo.sumo.simulation.frame import Frame
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_FORMS: Final = "time=SECONDS, edge=ID or ttc=SECONDS"


@dataclass(frozen=True, slots=True)
class TriggerView:
    """What a trigger may look at: the simulation at ``time_s``, and the agents near the AV."""

    api: SumoApi
    av_id: AgentId
    time_s: float
    observer: LiveObserver
    sighting: Sighting


class Trigger:
    """Lets an attack begin whenever a vehicle can attack; others add a condition.

    Attributes:
        not_before_s: time of the simulation before which it does not fire.
    """

    not_before_s: float = -np.inf

    def fires(self, moment: TriggerView) -> bool:  # noqa: ARG002 - the condition of others
        """Whether an attack is due. Called every 0.1 s between attacks, after the pause."""
        return True

    def used(self) -> None:
        """An attack has begun because of it."""


@dataclass(slots=True)
class AtTime(Trigger):
    """One attack, as soon as one can begin from a time of the simulation on."""

    not_before_s: float

    def fires(self, moment: TriggerView) -> bool:
        """Whether it is time; never again after an attack."""
        return moment.time_s >= self.not_before_s - 1e-6

    def used(self) -> None:
        """Never fire again."""
        self.not_before_s = np.inf


@dataclass(frozen=True, slots=True)
class AtEdge(Trigger):
    """Whenever the AV is on an edge."""

    edge: str

    def fires(self, moment: TriggerView) -> bool:
        """Whether the AV is on the edge."""
        return bool(moment.api.vehicle.getRoadID(moment.av_id) == self.edge)


@dataclass(frozen=True, slots=True)
class AtTtc(Trigger):
    """Whenever the AV and another agent would touch within a time at constant velocities."""

    below_s: float

    def fires(self, moment: TriggerView) -> bool:
        """Whether the least time to collision is below the limit."""
        observer, sighting = moment.observer, moment.sighting
        if not observer.may_touch(sighting, self.below_s):
            return False
        frame = observer.frame(sighting, {})
        return least_ttc_s(frame, observer.bodies.sizes_m(frame.ids), moment.av_id) < self.below_s


def parse(texts: Sequence[str]) -> tuple[Trigger, ...]:
    """Triggers as on the command line, ``time=120``, ``edge=A1B1``, ``ttc=2.5``.

    Raises UsageError for anything else.
    """
    return tuple(_parsed(text) for text in texts)


def _parsed(text: str) -> Trigger:
    kind, _, value = (part.strip() for part in text.partition("="))
    if kind == "edge" and value:
        return AtEdge(value)
    try:
        seconds = float(value)
    except ValueError:
        seconds = np.nan
    if kind not in {"time", "ttc"} or not 0 <= seconds < np.inf:
        raise UsageError(f"trigger '{text}': must be {_FORMS}.")
    return AtTime(seconds) if kind == "time" else AtTtc(seconds)


def least_ttc_s(frame: Frame, size_m: Floats, av_id: AgentId) -> float:
    """Least time until the AV touches another agent at constant velocity; inf if it never does."""
    me = [frame.ids.index(av_id)]
    others = np.delete(np.arange(len(frame.ids)), me)
    if not len(others):
        return float("inf")
    av, rest = (
        MovingBox(
            frame.position_m[rows],
            frame.heading_rad[rows],
            frame.velocity_mps[rows],
            size_m[rows],
            frame.z_m[rows],
        )
        for rows in (me, others)
    )
    return float(time_to_collision(av, rest).min())
