"""A survey of the vehicles of a SUMO configuration over time, without attacks."""

import heapq
import itertools
import math
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.scene import DT_S, Bools, Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import Ground
from deepmf_sumo.sumo.simulation.long_vehicles import LongVehicles
from deepmf_sumo.sumo.simulation.road_users import on_foot, somewhere
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi
from deepmf_sumo.sumo.simulation.sumo_config import (
    Configuration,
    Traffic,
    begun,
    read_configuration,
)

Ints = NDArray[np.int64]

EVERY_S: Final = 1.0
MOST_VEHICLE_STEPS: Final = 1_000_000
"""Ten seconds of SUMO on a slow core; a count, so that every machine ends at the same time."""
MOST_WHILE_GROWING: Final = 5 * MOST_VEHICLE_STEPS
"""The same where the traffic has to settle first."""
_GROWS: Final = 1.2
"""A last quarter with more than this times the vehicles of the one before has not settled."""
_FEW: Final = 1.0
"""Vehicles; smaller differences are chance."""
_BEFORE_S: Final = 10.0
_EMPTY_STEP: Final = 20
"""Cost of a step without vehicles, in vehicles."""
_COMPUTED: Final = "!"
"""First character of the names of routes that SUMO has computed itself."""
_BEFORE_LINE_M: Final = 1e-3
_PARKED: Final = 2
"""Bit of SUMO's stop states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficSurvey:
    """What to survey.

    Attributes:
        sumo_options: beside the configuration, as on SUMO's command line.
        at_s: times that must be among those of the survey.
        until_s: end of the survey, at most that of the configuration; None: that end, or the time
            at which `MOST_VEHICLE_STEPS` are reached.
        settles: go on from there while the number of vehicles grows (see `growth`), up to
            `MOST_WHILE_GROWING`.
        corners: longitudes and latitudes to project.
        from_s: beginning of the survey: up to then SUMO drives unseen; None: that of SUMO.
        people: whether persons are noted, too.
    """

    config: Path
    sumo_options: tuple[str, ...]
    seed: int
    at_s: tuple[float, ...] = ()
    until_s: float | None = None
    from_s: float | None = None
    settles: bool = False
    corners: tuple[tuple[float, float], ...] = ()
    people: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DemandVehicle:
    """A vehicle of the demand.

    Attributes:
        departed_s: when SUMO inserted it.
        bends: it is several boxes (`long_vehicles`), which a policy cannot drive.
    """

    id: str
    type: str
    permission: str
    departed_s: float
    bends: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """Vehicles at times a second apart, K sightings of V vehicles.

    Attributes:
        begin_s, until_s: the surveyed time. complete: no vehicles come after it.
        persons: whether there were any. waiting: vehicles that were due, and found no room.
        bodies: (V). edges: names.
        time_s: (K) not decreasing. vehicle, edge: (K) index. following: (K) index of the next edge
            on the route, -1 at its end.
        position_m: (K, 2) box centres. speed_mps: (K). z_m: (K) of the road at the front.
        to_end_m: (K) left of the edge; 0 inside the junction at its end, and there alone.
        parked: (K).
        ground: of the network; None where no vehicle is above another.
        projected_m: the corners that were asked for, in the network's frame.
        warnings: SUMO's, see `sumo_words`.
        walker_s, walker_m: (W), (W, 2) times and places of persons who are not in vehicles, where
            they were asked for.
    """

    begin_s: float
    until_s: float
    complete: bool
    persons: bool
    waiting: int
    bodies: tuple[DemandVehicle, ...]
    edges: tuple[str, ...]
    time_s: Floats
    vehicle: Ints
    edge: Ints
    following: Ints
    position_m: Floats
    to_end_m: Floats
    speed_mps: Floats
    parked: Bools
    z_m: Floats
    ground: Ground | None = None
    projected_m: tuple[tuple[float, float], ...] = ()
    warnings: tuple[str, ...] = ()
    walker_s: Floats = field(default_factory=lambda: np.zeros(0))
    walker_m: Floats = field(default_factory=lambda: np.zeros((0, 2)))


def survey_traffic(survey: TrafficSurvey) -> Sightings:
    """Run the configuration once and note all vehicles.

    Raises SimulationError, with SUMO's own message, if it cannot be run.
    """
    configuration = read_configuration(survey.config, survey.sumo_options)
    warned: list[str] = []
    with begun(Traffic(configuration=configuration, seed=survey.seed), warned=warned) as api:
        corners = (api.simulation.convertGeo(*one, fromGeo=True) for one in survey.corners)
        projected = tuple((float(x), float(y)) for x, y in corners)
        sightings = _surveyed(api, survey, configuration)
    return replace(sightings, projected_m=projected, warnings=tuple(warned))


class Growth(NamedTuple):
    """Mean numbers of vehicles in the third and the last quarter of a time."""

    third: float
    last: float

    @property
    def goes_on(self) -> bool:
        """Whether the number still grows, by more than chance."""
        return self.last > _GROWS * self.third and self.last - self.third > _FEW


def growth(number: Sequence[int] | Floats) -> Growth:
    """Of a number of vehicles (N) at equal steps of time, N at least 1."""
    quarters = [float(part.mean()) for part in np.array_split(np.asarray(number), 4) if len(part)]
    return Growth(third=quarters[max(len(quarters) - 2, 0)], last=quarters[-1])


def _surveyed(api: SumoApi, survey: TrafficSurvey, configuration: Configuration) -> Sightings:
    notes = _Columns(api, people=survey.people)
    begin = now = _begun(api, survey.from_s)
    ends = configuration.end_s if configuration.end_s is not None else math.inf
    until = min(ends, survey.until_s if survey.until_s is not None else math.inf)
    spent, complete, persons = 0, False, False
    seen: list[int] = []
    for moment in _moments(begin, survey.at_s):
        if moment > until + DT_S / 2:
            complete = until == ends
            break
        api.simulationStep(moment)
        seen.append(notes.look(moment))
        spent += round((moment - now) / DT_S) * (_EMPTY_STEP + seen[-1])
        now = moment
        persons = persons or bool(api.person.getIDCount())
        complete = api.simulation.getMinExpectedNumber() == 0
        if complete or (survey.until_s is None and _enough(survey, spent, seen)):
            break
    waiting = len(api.simulation.getPendingVehicles())
    return notes.sightings(begin, now, complete=complete, persons=persons, waiting=waiting)


def _enough(survey: TrafficSurvey, spent: int, seen: list[int]) -> bool:
    """Whether a survey without an end may end: after vehicle steps, with vehicles at each look."""
    if spent <= MOST_VEHICLE_STEPS:
        return False
    return spent > MOST_WHILE_GROWING or not (survey.settles and growth(seen).goes_on)


def _begun(api: SumoApi, from_s: float | None) -> float:
    """The time at which the survey begins; some seconds before ``from_s``, for what is there."""
    now = float(api.simulation.getTime())
    seconds = max(math.floor((from_s or now) - now - _BEFORE_S), 0)
    if not seconds:
        return now
    api.simulationStep(now + seconds)
    return float(api.simulation.getTime())


def _moments(begin_s: float, at_s: tuple[float, ...]) -> Iterator[float]:
    """Every second, and the requested times; endless."""
    last = begin_s
    seconds = (begin_s + number * EVERY_S for number in itertools.count(1))
    for moment in heapq.merge(seconds, sorted(round(one, 1) for one in at_s)):
        if moment > last + DT_S / 2:
            yield moment
            last = moment


@dataclass
class _Columns:
    """Columns that grow; constants are asked for once."""

    api: SumoApi
    people: bool = False
    bodies: dict[str, tuple[int, float]] = field(default_factory=dict)  # row, length
    known: list[DemandVehicle] = field(default_factory=list)
    edges: dict[str, int] = field(default_factory=dict)
    routes: dict[str, tuple[str, ...]] = field(default_factory=dict)
    lengths: dict[str, float] = field(default_factory=dict)
    numbers: "array[float]" = field(default_factory=lambda: array("d"))
    rows: "array[int]" = field(default_factory=lambda: array("q"))
    walkers: "array[float]" = field(default_factory=lambda: array("d"))

    def __post_init__(self) -> None:
        self.long = LongVehicles(self.api)

    def look(self, now: float) -> int:
        """Note all vehicles on the road; returns their number."""
        vehicle = self.api.vehicle
        names = sorted(vehicle.getIDList())
        for name in names:
            lane = vehicle.getLaneID(name)
            at = vehicle.getRouteIndex(name)
            if not lane or at < 0:  # teleported, just now
                continue
            row, length = self._body(name)
            route = self._route(name)
            edge = self._edge(route[at])
            following = self._edge(route[at + 1]) if at + 1 < len(route) else -1
            parked = bool(vehicle.getStopState(name) & _PARKED)
            self.rows.extend((row, edge, following, parked))
            left = 0.0
            if lane[0] != ":":
                along = vehicle.getLanePosition(name)
                left = self._left_m(lane, along, ahead=lane.rpartition("_")[0] == route[at])
            x, y, z = vehicle.getPosition3D(name)
            speed = max(0.0, vehicle.getSpeed(name))
            self.numbers.extend((now, x, y, vehicle.getAngle(name), length, left, speed, z))
        if self.people:
            self._look_for_walkers(now)
        return len(names)

    def _look_for_walkers(self, now: float) -> None:
        person = self.api.person
        for name in sorted(person.getIDList()):
            place = person.getPosition(name)
            if on_foot(person.getVehicle(name)) and somewhere(place):
                self.walkers.extend((now, *place))

    def _left_m(self, lane: str, at_m: float, *, ahead: bool) -> float:
        """More than 0 for a vehicle on the stop line, where SUMO lets it stop without a yellow.

        ``ahead``: it drives along the lane; on the opposite lane it drives to where that begins.
        """
        return max(self._length(lane) - at_m if ahead else at_m, _BEFORE_LINE_M)

    def sightings(
        self, begin: float, until: float, *, complete: bool, persons: bool, waiting: int
    ) -> Sightings:
        numbers = np.array(self.numbers).reshape(-1, 8)
        rows = np.array(self.rows).reshape(-1, 4)
        walkers = np.array(self.walkers).reshape(-1, 3)
        centre, _ = frames.from_sumo(numbers[:, 1:3], numbers[:, 3], numbers[:, 4])
        return Sightings(
            begin_s=begin,
            until_s=until,
            complete=complete,
            persons=persons,
            waiting=waiting,
            bodies=tuple(self.known),
            edges=tuple(self.edges),
            time_s=numbers[:, 0],
            vehicle=rows[:, 0],
            edge=rows[:, 1],
            following=rows[:, 2],
            position_m=centre,
            to_end_m=numbers[:, 5],
            speed_mps=numbers[:, 6],
            parked=rows[:, 3].astype(bool),
            z_m=numbers[:, 7],
            walker_s=walkers[:, 0],
            walker_m=walkers[:, 1:],
        )

    def _body(self, name: str) -> tuple[int, float]:
        if name not in self.bodies:
            vehicle = self.api.vehicle
            self.bodies[name] = (len(self.known), float(vehicle.getLength(name)))
            self.known.append(
                DemandVehicle(
                    id=name,
                    type=vehicle.getTypeID(name).partition("@")[0],
                    permission=vehicle.getVehicleClass(name),
                    departed_s=float(vehicle.getDeparture(name)),
                    bends=bool(self.long.lengths_m(name)),
                )
            )
        return self.bodies[name]

    def _route(self, name: str) -> tuple[str, ...]:
        key = self.api.vehicle.getRouteID(name)
        # rerouters give the name of an abandoned route to the next one
        if key not in self.routes or key.startswith(_COMPUTED):
            self.routes[key] = tuple(self.api.vehicle.getRoute(name))
        return self.routes[key]

    def _edge(self, name: str) -> int:
        return self.edges.setdefault(name, len(self.edges))

    def _length(self, lane: str) -> float:
        if lane not in self.lengths:
            self.lengths[lane] = float(self.api.lane.getLength(lane))
        return self.lengths[lane]
