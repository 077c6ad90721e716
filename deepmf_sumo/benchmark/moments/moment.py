"""Where and when somebody is attacked, what was asked for, and what was found."""

from dataclasses import dataclass
from typing import Literal

from deepmf_sumo.datatypes import AgentId

VehicleTime = tuple[AgentId, float]
"""A vehicle at a time of the simulation, in seconds to a tenth."""

Preference = Literal["spread", "encounters"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What the moments shall be like.

    Attributes:
        count: how many, at most.
        av, av_type: only this vehicle, only vehicles of this type.
        at_s: only these moments of the simulation's time; empty leaves them open.
        again: only these vehicles at these times; empty leaves them open.
        duration_s: of each attack.
        seed: of the choice.
        prefer: ``encounters`` chooses first who meets somebody at a junction without any attack.
    """

    count: int
    av: AgentId | None = None
    av_type: str | None = None
    at_s: tuple[float, ...] = ()
    again: tuple[VehicleTime, ...] = ()
    duration_s: float = 8.0
    seed: int = 0
    prefer: Preference = "spread"


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A vehicle that can be attacked at a time.

    Attributes:
        edge: where it is, or, inside a junction, where it comes from.
        following: the next edge on its route; empty at its end.
        turn: what it does at the next junction, where it gets that far in the time of an attack:
            straight, left, right, turnaround; else ``along``.
        around: vehicles within reach of it.
        encounter_s: what time is between it and another vehicle on a way that meets its own, at a
            junction that it passes in the time of an attack, if nobody attacks: 0 where both are in
            the junction at once; None where there is no such vehicle.
        meets: that vehicle, if it is there and within 80 m when the attack begins.
        street: name of the edge in the network; empty where it has none.
    """

    av: AgentId
    av_type: str
    start_s: float
    edge: str
    following: str
    turn: str
    speed_mps: float
    around: int
    encounter_s: float | None = None
    meets: AgentId | None = None
    street: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Moments in the order of time, and where they come from.

    Attributes:
        suitable: sightings, a second apart, that the moments were drawn from.
        vehicles: in the traffic. begin_s, until_s: what was looked at.
        complete: nothing comes after it.
        reason: why there are fewer moments than asked for; empty if there are as many.
    """

    moments: tuple[Moment, ...]
    suitable: int
    vehicles: int
    begin_s: float
    until_s: float
    complete: bool
    reason: str = ""
