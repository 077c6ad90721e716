"""Classes of road users: what a recorded or simulated box is, how it moves, what it is called.

Recordings and SUMO agree on four kinds; a finer class follows from the size, which is all that both
know of a vehicle. One table, `ROAD_USERS`, so that a van is not a car in one file and a truck in
another, and nobody plans a motion for a pedestrian that another part holds to be impossible.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from deepmf_sumo.scene._arrays import Floats
from deepmf_sumo.scene.scene import AgentKind

PEOPLE: Final[tuple[AgentKind, ...]] = ("pedestrian", "cyclist")
"""Kinds that nothing but a helmet protects: on foot or on a bicycle."""
RoadUserClass = Literal["car", "truck", "motorcycle", "bicycle", "pedestrian", "other"]
"""``truck``: buses, too, which have the same sizes. ``other``: trams, trains, animals, objects."""
Body = Literal["single_track", "point", "fixed"]
"""``single_track``: it steers, and its rear axle follows; ``point``: a person, who turns freely at
rest; ``fixed``: on rails, or nobody knows how it moves: it never attacks."""

LONGEST_CAR_M: Final = 6.5
"""SUMO's delivery vans have this length; its smallest trucks are 7.1 m long."""
_LONGEST_MOTORCYCLE_M: Final = 3.0
_WIDEST_MOTORCYCLE_M: Final = 1.2
"""SUMO's motorcycles are 2.2 m by 0.9 m; the narrowest cars on sale are 1.2 m to 1.3 m wide."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionLimits:
    """Largest accelerations in m/s2: speeding up, braking, across the direction of motion."""

    accel: float
    brake: float
    lateral: float

    def rows(self, count: int) -> Floats:
        """(count, 3) the same limits for each candidate."""
        return np.tile([self.accel, self.brake, self.lateral], (count, 1)).astype(float)

    def mild(self) -> "MotionLimits":
        """Limits of a calm driver: at most (3, 4, 2.5) and 70 % of these limits."""
        return MotionLimits(
            accel=min(3.0, 0.7 * self.accel),
            brake=min(4.0, 0.7 * self.brake),
            lateral=min(2.5, 0.7 * self.lateral),
        )

    def times(self, factor: float) -> "MotionLimits":
        """Each of them, times a factor."""
        return MotionLimits(
            accel=factor * self.accel, brake=factor * self.brake, lateral=factor * self.lateral
        )

    def within(self, other: "MotionLimits") -> "MotionLimits":
        """The smaller of the two, each."""
        return MotionLimits(
            accel=min(self.accel, other.accel),
            brake=min(self.brake, other.brake),
            lateral=min(self.lateral, other.lateral),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionModel:
    """How a road user moves.

    Attributes:
        body: see `Body`.
        planned: limits of a motion that is planned for it: what people do in traffic.
        possible: limits of a motion that is believed: what is measured with the noise of recordings
            must stay within them.
        fastest_mps: it never moves faster; inf for vehicles, which roads limit.
        usual_mps: speeds at which it usually moves, the first more often; empty for vehicles, whose
            speeds roads and traffic decide.
        spread_mps: standard deviation of the first of these among people; 0 where none is known.
        rear_axle: distance of the rear axle behind the centre of the box, per length.
        slip_rad: course against heading at full lock.
        turn_per_m: a motion that is believed turns by at most this, in rad a metre; turning circles
            of cars are at least 3.3 m in radius, of bicycles 1.2 m.
    """

    body: Body
    planned: MotionLimits
    possible: MotionLimits
    fastest_mps: float = float("inf")
    usual_mps: tuple[float, ...] = ()
    spread_mps: float = 0.0
    rear_axle: float = 0.3
    slip_rad: float = 0.33
    turn_per_m: float = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUser:
    """A class of road users.

    Attributes:
        kind: what recordings call it.
        size_m: usual length, width and height, about the medians in recordings.
        noun: what reports call it.
        motion: how it moves.
    """

    kind: AgentKind
    size_m: tuple[float, float, float]
    noun: str
    motion: MotionModel

    @property
    def person(self) -> bool:
        """Whether it is one of `PEOPLE`."""
        return self.kind in PEOPLE


_CAR: Final = MotionModel(
    body="single_track",
    planned=MotionLimits(accel=3.5, brake=5.0, lateral=3.5),
    possible=MotionLimits(accel=8.0, brake=8.0, lateral=5.0),
)
"""Possible: dry roads."""
_BICYCLE: Final = MotionModel(
    body="single_track",
    planned=MotionLimits(accel=1.2, brake=3.0, lateral=2.5),
    possible=MotionLimits(accel=4.0, brake=7.0, lateral=5.0),
    fastest_mps=8.3,
    usual_mps=(15 / 3.6, 20 / 3.6),
    slip_rad=0.45,
    turn_per_m=0.83,
)
"""Planned: acceleration and comfortable braking of SUMO's bicycles, and a lean of 14 degrees.
30 km/h, in the plane few cyclists are faster; turning circles of 1.2 m in radius. Usual: the
cyclists of Euro NCAP 2026."""
_PEDESTRIAN: Final = MotionModel(
    body="point",
    planned=MotionLimits(accel=1.6, brake=2.0, lateral=2.0),
    possible=MotionLimits(accel=4.0, brake=4.0, lateral=4.0),
    fastest_mps=3.5,
    usual_mps=(1.36, 8 / 3.6),
    spread_mps=0.24,
)
"""Planned: an adult who starts to run needs 1.5 m to 8 km/h, 1.6 m/s2 (Euro NCAP 2026, running
adult from the far side); the start of a walk has 0.14 g (Randles, 288 people), braking -2 m/s2 is
that of SUMO's pedestrians. 3.5 m/s is running; a walk has 1.36 m/s +- 0.24 (Randles), Euro NCAP's
running adult 8 km/h."""
_FIXED: Final = MotionModel(body="fixed", planned=_CAR.planned, possible=_CAR.possible)

ROAD_USERS: Final[Mapping[RoadUserClass, RoadUser]] = {
    "car": RoadUser(kind="vehicle", size_m=(4.7, 2.0, 1.7), noun="car", motion=_CAR),
    "truck": RoadUser(kind="vehicle", size_m=(12.0, 2.9, 3.3), noun="truck or bus", motion=_CAR),
    "motorcycle": RoadUser(
        kind="vehicle", size_m=(2.2, 0.9, 1.6), noun="motorcycle", motion=_CAR
    ),
    "bicycle": RoadUser(kind="cyclist", size_m=(1.8, 0.8, 1.75), noun="bicycle", motion=_BICYCLE),
    "pedestrian": RoadUser(
        kind="pedestrian", size_m=(0.9, 0.9, 1.75), noun="pedestrian", motion=_PEDESTRIAN
    ),
    "other": RoadUser(kind="other", size_m=(1.0, 1.0, 1.0), noun="vehicle", motion=_FIXED),
}  # fmt: skip
"""All classes. Trucks and motorcycles have the limits of cars: what is planned for them is driven
by either."""

_BY_KIND: Final[Mapping[AgentKind, RoadUserClass]] = {
    "vehicle": "car",
    "cyclist": "bicycle",
    "pedestrian": "pedestrian",
    "other": "other",
}


def class_of(kind: AgentKind, size_m: Floats) -> RoadUserClass:
    """The class of an agent of a kind, with its size (length, width, ...)."""
    if kind != "vehicle":
        return _BY_KIND[kind]
    length, width = float(size_m[0]), float(size_m[1])
    if length > LONGEST_CAR_M:
        return "truck"
    narrow = length < _LONGEST_MOTORCYCLE_M and width < _WIDEST_MOTORCYCLE_M
    return "motorcycle" if narrow else "car"


def road_user(kind: AgentKind, size_m: Floats) -> RoadUser:
    """The row of `ROAD_USERS` of an agent of a kind, with its size (length, width, ...)."""
    return ROAD_USERS[class_of(kind, size_m)]


def usual_size_m(kind: AgentKind) -> tuple[float, float, float]:
    """Length, width and height of an agent of a kind, of which no size is known."""
    return ROAD_USERS[_BY_KIND[kind]].size_m
