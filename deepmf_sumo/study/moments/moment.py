"""Where and when a vehicle is attacked: what is asked for, and what is found.

Who walks into an AV that stands in a queue says nothing about the AV. Attacks by people begin where
it drives for most of the time that they have, and where a person can get onto its way in time.
"""

import difflib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from deepmf_sumo.errors import UsageError
from deepmf_sumo.scene import DT_S, AgentId, Bools, Floats
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.spec import Who
from deepmf_sumo.sumo.network.sumo_net import ROAD_VEHICLES
from deepmf_sumo.sumo.simulation.road_users import kind_of
from deepmf_sumo.sumo.simulation.traffic_survey import EVERY_S, DemandVehicle, Ints, Sightings

VehicleTime = tuple[AgentId, float]
"""A vehicle at a time of the simulation, in seconds to a tenth."""

Preference = Literal["both", "spread", "encounters"]
_DRIVES_MPS: Final = 3.0
_MOST: Final = 0.75
_FIRST_S: Final = 2
"""No person gets onto its way sooner."""
_SETS_OFF_S: Final = 1.0
_EITHER_S: Final = EVERY_S / 2
"""Moments between two seconds are sighted then, and the seconds later are not."""
_NEAR_M: Final = 1.0
"""Half of the AV and half of a person."""
_HURRIES_MPS: Final = {
    kind: ROAD_USERS[kind].motion.usual_mps[-1] for kind in ("pedestrian", "bicycle")
}


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedMoments:
    """The moments that are asked for.

    Attributes:
        count: number of moments, at most.
        pool: where moments are drawn by what others found: number of those that they are drawn
            from, see `promising`; 0 where all are spread.
        av, av_type: only this vehicle, only vehicles of this type.
        av_types: of the type, where it is a distribution; empty: it is one type.
        at_s: only these times of the simulation; empty leaves them open.
        again: only these vehicles at these times; empty leaves them open.
        duration_s: of each attack.
        seed: of the choice.
        prefer: ``encounters`` first chooses vehicles that meet another one at a junction without
            any attack; ``both`` spreads over places and time, and does so within each place.
        from_s: only from this time of the simulation on; ``settled``: see `choice`.
        where: the area that is attacked, in words; empty: the whole network.
        people: who attacks: people of the demand, made ones, or both; empty: vehicles.
        made_too: where no two vehicles are near each other, moments for attacks of made people.
        by_option: whether messages name the options of ``attack`` or the keys of a spec.
    """

    count: int
    pool: int = 0
    av: AgentId | None = None
    av_type: str | None = None
    av_types: tuple[str, ...] = ()
    at_s: tuple[float, ...] = ()
    again: tuple[VehicleTime, ...] = ()
    duration_s: float = 8.0
    seed: int = 0
    prefer: Preference = "spread"
    from_s: float | Literal["settled"] | None = None
    where: str = ""
    people: Who | Literal[""] = ""
    made_too: bool = False
    by_option: bool = True

    def named(self, key: str) -> str:
        """The option or the key of a spec behind a field."""
        in_spec = f"source.moments.{key}"
        return _OPTIONS.get(key, in_spec) if self.by_option else in_spec

    @property
    def found(self) -> int:
        """Number of moments that are looked for."""
        return self.pool or self.count

    @property
    def later(self) -> str:
        """How to look for moments in more of the simulation."""
        return f"{self.named('until_s')}{' S' * self.by_option} looks further"

    @property
    def earlier(self) -> str:
        """How to attack sooner."""
        return f"{self.named('from_s')}{' S' * self.by_option} begins earlier"


_OPTIONS: Final = {"av": "--av", "at_s": "--at", "until_s": "--until"} | {
    "from_s": "--from", "junctions": "--junction", "edges": "--edge",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A vehicle that can be attacked at a time.

    Attributes:
        edge: where it is, or, inside a junction, where it comes from.
        following: the next edge on its route; empty at its end.
        turn: what it does at the next junction, where it gets that far in the time of an attack:
            straight, left, right, turnaround; otherwise ``along``.
        around: vehicles within reach of it.
        encounter_s: time between it and another vehicle on a path that meets its own, at a
            junction that it passes within the time of an attack, without any attack: 0 where both
            are in the junction at the same time; None where there is no such vehicle.
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
class Flow:
    """Vehicles on an edge, or on it and going on to another.

    Attributes:
        following: the next edge; empty: all vehicles on the edge.
        vehicles: that were seen there, each once. near: those of them that had another vehicle
            within `REACH_M` meanwhile, which can attack them.
    """

    edge: str
    following: str
    vehicles: int
    near: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundMoments:
    """Moments in the order of time, and where they come from.

    Attributes:
        suitable: sightings, a second apart, that the moments were drawn from.
        vehicles: in the traffic. begin_s, until_s: what was looked at.
        complete: nothing comes after it.
        reason: why there are fewer moments than asked for; empty if there are as many.
        from_s, from_why: from when on they were chosen, and why; None: from the beginning.
        notes: further sentences for the user.
        flows: vehicles at each place from then on.
        order: of each moment, when it was spread; those of a pool begin with the first.
    """

    moments: tuple[Moment, ...]
    suitable: int
    vehicles: int
    begin_s: float
    until_s: float
    complete: bool
    reason: str = ""
    from_s: float | None = None
    from_why: str = ""
    notes: tuple[str, ...] = ()
    flows: tuple[Flow, ...] = ()
    order: tuple[int, ...] = ()

    @property
    def hours(self) -> float:
        """The time that flows are of."""
        begin = self.begin_s if self.from_s is None else max(self.from_s, self.begin_s)
        return max(self.until_s - begin, 0.0) / 3600


REACH_M: Final = 50.0
"""Between box centres; a vehicle farther away seldom gets there within an attack."""
SEEN_S: Final = 1.0
"""Length of the history in views."""
STAYS_S: Final = 3.0
_MOVES_M: Final = 3.0
_ROUNDING_S: Final = 0.05

_AV_CLASSES: Final = {*ROAD_VEHICLES, "ignoring"} - {"motorcycle", "moped"}


def suitable(
    sightings: Sightings,
    wish: WantedMoments,
    from_s: float | None = None,
    from_why: str = "",
    within: Bools | None = None,
) -> tuple[Ints, str]:
    """Rows that can be a moment, apart from the vehicles near; and why there is none, if so.

    ``from_s``: only from this time on, for a reason. ``within``: (K) only these.

    Raises UsageError where the wish names a vehicle, a type or a time that is not in the traffic.
    """
    if not sightings.bodies:
        check_times(wish, sightings.begin_s, math.inf)
        return np.zeros(0, np.int64), _no_vehicles(sightings, wish)
    _check(sightings, wish)
    kept = np.ones(len(sightings.time_s), bool)
    conditions = _conditions(sightings, wish)
    if from_s is not None:
        conditions.insert(1, _late(sightings, wish, from_s, from_why))
    if within is not None:
        who = f"vehicle '{wish.av}' never" if wish.av else f"no vehicle{_typed(wish)}"
        conditions.insert(1, (within, f"{who} comes to {wish.where}"))
    for mask, reason in conditions:
        kept &= mask
        if not kept.any():
            return np.zeros(0, np.int64), reason
    return np.flatnonzero(kept), ""


def opponents(sightings: Sightings) -> Bools:
    """(K) whether it can attack: vehicles on roads that do not bend, and are not parked."""
    others = np.array(
        [kind_of(body.permission) == "vehicle" and not body.bends for body in sightings.bodies],
        bool,
    )
    able: Bools = others[sightings.vehicle] & ~sightings.parked
    return able


def around(sightings: Sightings, able: Bools, row: int, reach_m: float = REACH_M) -> int:
    """Number of able vehicles within reach of the vehicle of a row, at that moment."""
    time_s = sightings.time_s
    begin, end = np.searchsorted(time_s, time_s[row]), np.searchsorted(time_s, time_s[row], "right")
    away = np.hypot(*(sightings.position_m[begin:end] - sightings.position_m[row]).T)
    near = (away < reach_m) & able[begin:end]
    near[row - begin] = False
    others = begin + np.flatnonzero(near)
    return int((~off_level(sightings, np.full(len(others), row), others)).sum())


def off_level(sightings: Sightings, rows: Ints, others: Ints) -> Bools:
    """(M) which of others pass above or below the vehicles of rows, as on a bridge."""
    off = np.zeros(len(rows), bool)
    if sightings.ground is None:
        return off
    place_m, z_m = sightings.position_m, sightings.z_m
    some = np.flatnonzero(clear(z_m[rows], z_m[others]))
    one, other = rows[some], others[some]
    off[some] = sightings.ground.apart(place_m[one], z_m[one], place_m[other], z_m[other])
    return off


def _no_vehicles(sightings: Sightings, wish: WantedMoments) -> str:
    span = f"{sightings.begin_s:.12g} to {sightings.until_s:.12g} s"
    if sightings.waiting:
        return f"{sightings.waiting} vehicles wait to be inserted, and none was, from {span}"
    others = ", only persons" if sightings.persons else ""
    if wish.again:
        return f"there is no vehicle from {span}{others}: the moments are of other traffic"
    later = "" if sightings.complete else f"; {wish.later}"
    if isinstance(wish.from_s, float) and wish.from_s > 0:
        return f"there is no vehicle from {wish.from_s:.12g} s on{others}{later}; {wish.earlier}"
    return f"there is no vehicle from {span}{others}{later}"


def _conditions(sightings: Sightings, wish: WantedMoments) -> list[tuple[Bools, str]]:
    """The conditions of a moment, in order, each with the reason if no row satisfies it."""
    bodies, time_s, vehicle = sightings.bodies, sightings.time_s, sightings.vehicle
    asked = np.array([_is_asked(body, wish) for body in bodies], bool)[vehicle]
    on_road = np.array([body.permission in _AV_CLASSES for body in bodies], bool)[vehicle]
    departed = np.array([body.departed_s for body in bodies])[vehicle]
    stays = min(STAYS_S, wish.duration_s)
    last = np.zeros(len(bodies))
    np.maximum.at(last, vehicle, time_s)
    remains = (last[vehicle] >= time_s + stays) | (last[vehicle] > sightings.until_s - EVERY_S / 2)
    at = np.ones(len(time_s), bool)
    if wish.at_s:
        moments = np.array(wish.at_s)
        at = (np.abs(time_s[:, None] - moments) < _ROUNDING_S).any(axis=1)
    named = f"vehicle '{wish.av}'" if wish.av else f"a vehicle{_typed(wish)}"
    asked_for = wish.at_s or wish.again
    classes = ", ".join(sorted({body.permission for body in bodies if _is_asked(body, wish)}))
    return [
        (asked, "no vehicle is asked for"),
        (on_road, f"no car, truck or bus is among the vehicles (their classes: {classes})"),
        (at, f"{named} is there{_when(sightings, wish)}, not at {_times(wish)}"),
        (
            (time_s >= departed + SEEN_S - _ROUNDING_S)
            & (time_s >= sightings.begin_s + SEEN_S - _ROUNDING_S),
            f"{named} must have been there for {SEEN_S:g} s, and none has",
        ),
        (remains, f"{named} must stay for {stays:g} s, and none does"),
        (~sightings.parked, f"{named} must not be parked, and all are"),
        (_moves(sightings, max(STAYS_S, wish.duration_s)), f"{named} must move, and none does"),
        *(_people_meet_it(sightings, wish, named) if wish.people and not asked_for else ()),
    ]


def _people_meet_it(
    sightings: Sightings, wish: WantedMoments, named: str
) -> Iterator[tuple[Bools, str]]:
    """Of attacks by people: an AV that drives, and, if nobody is made, somebody who gets to it."""
    drive = f"drive at {_DRIVES_MPS:g} m/s or more for most of an attack by people"
    yield drives(sightings, wish.duration_s), f"{named} must {drive}, and none does"
    if wish.people == "existing":
        nobody = f"no pedestrian and no cyclist could get onto the way of {named} in time"
        more = "source.people: made puts people there"
        yield reached(sightings, wish.duration_s), f"{nobody}; {more}"


def _late(sightings: Sightings, wish: WantedMoments, from_s: float, why: str) -> tuple[Bools, str]:
    """Whether (K) it is that late, and the reason if none is."""
    named = f"vehicle '{wish.av}'" if wish.av else f"a vehicle{_typed(wish)}"
    because = f", {why}" if why else ""
    reason = f"{named} is there{_when(sightings, wish)}, and none from {from_s:.12g} s on{because}"
    return sightings.time_s >= from_s - _ROUNDING_S, f"{reason}; {wish.earlier}"


def _moves(sightings: Sightings, duration_s: float) -> Bools:
    """(K) whether it moves within this time."""
    order = np.lexsort((sightings.time_s, sightings.vehicle))
    vehicle, time_s = sightings.vehicle[order], sightings.time_s[order]
    key = vehicle * (2.0 * sightings.until_s + duration_s + 1.0) + time_s
    later = np.searchsorted(key, key + duration_s, "right") - 1
    position = sightings.position_m[order]
    moves = np.zeros(len(order), bool)
    moves[order] = np.hypot(*(position[later] - position).T) > _MOVES_M
    return moves


def _is_asked(body: DemandVehicle, wish: WantedMoments) -> bool:
    return (wish.av is None or body.id == wish.av) and (
        wish.av_type is None or body.type in (wish.av_types or (wish.av_type,))
    )


def check_times(wish: WantedMoments, begin_s: float, until_s: float, later: str = "") -> None:
    """Raise UsageError for times of the wish that are between steps, or outside the traffic."""
    at = wish.named("at_s")
    for between in (one for one in wish.at_s if abs(one - round(one, 1)) > 1e-6):
        raise UsageError(
            f"{at} {between:.12g}: the simulation goes in steps of {DT_S:g} s; give a multiple."
        )
    for late in (one for one in wish.at_s if one > until_s + _ROUNDING_S):
        raise UsageError(
            f"{at} {late:.12g}: there is traffic from {begin_s:.12g} to {until_s:.12g} s"
            f" only{later}."
        )
    for early in (one for one in wish.at_s if one < begin_s + SEEN_S - _ROUNDING_S):
        raise UsageError(
            f"{at} {early:.12g}: the simulation begins at {begin_s:.12g} s, and a vehicle must have"
            f" been there for {SEEN_S:g} s."
        )


def _check(sightings: Sightings, wish: WantedMoments) -> None:
    """Raise UsageError for names and times that are not in the traffic."""
    span = f"from {sightings.begin_s:.12g} to {sightings.until_s:.12g} s"
    later = "" if sightings.complete else f" ({wish.later})"
    check_times(wish, sightings.begin_s, sightings.until_s, later)
    names = {
        "av": (wish.av, "vehicle", sorted(body.id for body in sightings.bodies)),
        "av_type": (wish.av_type, "type", sorted({body.type for body in sightings.bodies})),
    }
    for key, (name, kind, known) in names.items():
        meant = wish.av_types or (name,) if key == "av_type" else (name,)
        if name is not None and not set(meant) & set(known):
            nearest = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or known[:3]
            raise UsageError(
                f"{wish.named(key)} {name}: no such {kind} is on the road {span}{later}; there are"
                f" {', '.join(nearest)}{' and others' * (len(known) > len(nearest))}."
            )


def _typed(wish: WantedMoments) -> str:
    return f" of type '{wish.av_type}'" if wish.av_type else ""


def _when(sightings: Sightings, wish: WantedMoments) -> str:
    rows = [row for row, body in enumerate(sightings.bodies) if _is_asked(body, wish)]
    there = sightings.time_s[np.isin(sightings.vehicle, rows)]
    return f" from {there.min():.12g} to {there.max():.12g} s" if len(there) else ""


def _times(wish: WantedMoments) -> str:
    return " or ".join(f"{one:.12g} s" for one in wish.at_s)


def drives(sightings: Sightings, duration_s: float) -> Bools:
    """(K) whether it drives at 3 m/s or more at three quarters of the seconds of an attack."""
    later, seconds = _Later(sightings, duration_s), range(1, max(round(duration_s), 1) + 1)
    fast = [later(sightings.speed_mps, second) >= _DRIVES_MPS for second in seconds]
    driven: Bools = np.mean(fast, axis=0) >= _MOST  # a vehicle that has left does not drive
    return driven


def reached(sightings: Sightings, duration_s: float) -> Bools:
    """(K) whether a pedestrian or a cyclist can be where the AV will be, at the same time.

    In a straight line, at 8 km/h on foot and 20 km/h on a bicycle, a second after the beginning.
    """
    found = np.zeros(len(sightings.time_s), bool)
    seconds = np.arange(_FIRST_S, max(round(duration_s), _FIRST_S) + 1)
    later = _Later(sightings, duration_s)
    ways_m = np.stack([later(sightings.position_m, second) for second in seconds.tolist()], axis=1)
    cyclists = np.array([kind_of(one.permission) == "cyclist" for one in sightings.bodies], bool)
    rides = np.flatnonzero(cyclists[sightings.vehicle] & ~sightings.parked)
    groups = (
        (sightings.walker_s, sightings.walker_m, _HURRIES_MPS["pedestrian"]),
        (sightings.time_s[rides], sightings.position_m[rides], _HURRIES_MPS["bicycle"]),
    )
    for time_s, place_m, fastest_mps in groups:
        reach_m = _NEAR_M + fastest_mps * (seconds - _SETS_OFF_S)
        for now in np.unique(time_s):
            rows = np.flatnonzero(sightings.time_s == now)
            apart = ways_m[rows, :, None] - place_m[time_s == now]
            near = np.hypot(apart[..., 0], apart[..., 1]) <= reach_m[:, None]
            found[rows] |= near.any(axis=(1, 2))
    return found


class _Later:
    """Sightings of the same vehicle some seconds later."""

    def __init__(self, sightings: Sightings, duration_s: float) -> None:
        span = float(sightings.until_s - min(sightings.begin_s, 0.0)) + duration_s + 1.0
        self._key = sightings.vehicle * span + sightings.time_s
        self._order = np.argsort(self._key, kind="stable")

    def __call__(self, values: Floats, seconds: int) -> Floats:
        """(K, ...) of values (K, ...); nan where the vehicle is not there then."""
        wanted, key = self._key + seconds, self._key[self._order]
        above = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        below = np.maximum(above - 1, 0)
        at = np.where(wanted - key[below] < key[above] - wanted, below, above)
        later = np.array(values[self._order[at]], float)
        later[np.abs(key[at] - wanted) > _EITHER_S] = np.nan
        return later
