"""People who are put around an AV's way, where they could be: at kerbs, crossings, stops.

Who they are and where they stand is drawn with the seed of the run. Somebody at a place could have
come there, is in nobody's way without an attack, and can get to the AV's way before the AV is past.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import shapely

from deepmf_sumo.scene import (
    DT_S,
    AgentId,
    Floats,
    MadePlace,
    MadeRoadUser,
    PersonPlace,
    Rollout,
    TrafficCase,
)
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.walkable import walkable
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.spec import GivenPerson, WantedPeople
from deepmf_sumo.study.moments.roadside import (
    GAP_M,
    Roadside,
    Side,
    bus_stops,
    crossings,
    parked,
    stop_lines,
)
from deepmf_sumo.sumo.simulation.made_people import without_attack
from deepmf_sumo.sumo.simulation.on_foot import WALK_MPS

_IN_TIME_S: Final = (1.5, 7.0)
"""When the AV comes by: sooner nobody gets onto its way, later the attack is over."""
_SLOWEST_MPS, _FASTEST_MPS = 0.8, 2.0
_STARTS_S: Final = 0.5
_ON_FOOT: Final = ROAD_USERS["pedestrian"].motion
_WALKS: Final = 0.5
"""Share of the people at kerbs who walk along it."""
_CYCLES_MPS: Final = (3.0, 5.5)
_AHEAD_M: Final = (6.0, 40.0)
"""Of the AV, where cyclists are."""
_NEAR_KERB_M: Final = 0.5
_TRIES: Final = 40
_QUEUE_GAP_M: Final = (1.0, 8.0)
_STRAIGHT_M: Final = 0.5
"""A kerb whose distance from the way changes by more within a metre ends there."""
_SHORTEST_M: Final = 4.0
_HALF_M: Final = ROAD_USERS["pedestrian"].size_m[1] / 2
_HALF_BICYCLE_M: Final = ROAD_USERS["bicycle"].size_m[1] / 2
_STOP_REACH_M: Final = 15.0
_WHOLE_S: Final = 1.0
"""Before the start, from which on somebody is there."""
_ROOM_M: Final = 0.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """The people of a case: who was made, and of which place nobody was, and why."""

    made: tuple[MadeRoadUser, ...]
    nobody: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidate:
    """Somebody who could be made; ``at``: number of the point of the way beside it."""

    at: int
    position_m: Floats
    heading_rad: float
    road_user: str = "pedestrian"
    speed_mps: float = 0.0
    way_m: Floats | None = None


def drawn(
    case: TrafficCase, people: WantedPeople, rollout: Rollout, rng: np.random.Generator
) -> Drawn:
    """The people of a case.

    Args:
        case: without made people.
        people: what the spec asks for.
        rollout: its episode without an attack and without made people.
        rng: of the draws.
    """
    if people.given:
        return Drawn(made=_given(people.given, case, rollout))
    here = Roadside.of(case, rollout)
    if here is None:
        return Drawn(made=(), nobody=tuple((one, _STANDS) for one in people.places))
    made: dict[AgentId, MadeRoadUser] = {}
    poses: dict[AgentId, Floats] = {}
    nobody: dict[str, str] = {}
    order = [people.places[at] for at in rng.permutation(len(people.places))]
    for _ in range(-(-people.count // len(order))):  # one at each place before a second one
        for place in list(order):
            if len(made) == people.count:
                break
            found, why = _one_at(place, here, case, rng, poses)
            if found is None:
                order.remove(place)
                if not any(one.place == place for one in made.values()):
                    nobody[place] = why
                continue
            named = replace(found, id=_free_name(found, {*rollout.tracks.ids, *made}))
            made[named.id], poses[named.id] = named, _poses(named, here)
    missing = nobody if len(made) < people.count else {}
    return Drawn(made=tuple(made.values()), nobody=tuple(missing.items()))


_STANDS: Final = "the AV does not move without an attack"


def _free_name(one: MadeRoadUser, taken: set[AgentId]) -> AgentId:
    """``made_pedestrian_1`` and so on: a name that nobody has."""
    kind = ROAD_USERS[one.road_user].kind
    return next(name for n in range(1, 10_000) if (name := f"made_{kind}_{n}") not in taken)


def _one_at(
    place: PersonPlace,
    here: Roadside,
    case: TrafficCase,
    rng: np.random.Generator,
    poses: dict[AgentId, Floats],
) -> tuple[MadeRoadUser | None, str]:
    """Somebody at a place; or None, and why there is nobody."""
    found, why = _FINDERS[place](here, case, rng)
    if not found:
        return None, why
    walked = [one for one in found if here.walked[one.at]]
    if not walked:
        return None, "nobody walks along the AV's road there"
    walked = [one for one in walked if _where_people_can_be(one, here, case)]
    if not walked:
        return None, "buildings or water are where somebody could be"
    timely = [one for one in walked if _in_time(one, here)]
    if not timely:
        return None, f"{_WHERE[place]} is not where anybody gets onto the AV's way in time"
    for number_ in rng.permutation(len(timely))[:_TRIES]:
        one = _made(timely[number_], place, here)
        size_m = ROAD_USERS[one.road_user].size_m
        if here.free(_poses(one, here), size_m, poses):
            return one, ""
    return None, f"other road users are where somebody could be {_WHERE[place]}"


def _where_people_can_be(one: _Candidate, here: Roadside, case: TrafficCase) -> bool:
    points_m = one.position_m[None] if one.way_m is None else one.way_m
    return bool(walkable(case.road).holds(points_m, here.heights_m(points_m)).all())


_WHERE: Final[dict[PersonPlace, str]] = {
    "kerb": "at a kerb",
    "crossing": "at a crossing",
    "stop": "at a stop",
    "behind_vehicle": "behind a vehicle that stands",
    "queue": "between the vehicles of a queue",
    "cyclist": "beside the lane",
}


def _made(one: _Candidate, place: MadePlace, here: Roadside) -> MadeRoadUser:
    return MadeRoadUser(
        id="",
        road_user="bicycle" if one.road_user == "bicycle" else "pedestrian",
        position_m=one.position_m,
        heading_rad=one.heading_rad,
        speed_mps=one.speed_mps,
        place=place,
        way_m=one.way_m,
        z_m=float(here.z_m[one.at]),
        since_s=-_WHOLE_S,
    )


def _poses(one: MadeRoadUser, here: Roadside) -> Floats:
    """(T, 3) without an attack, at the steps of the tracks."""
    times = (np.arange(here.tracks.steps) - here.now) * DT_S
    poses = (without_attack(one, float(time_s)) for time_s in times)
    return np.array([(pose.x_m, pose.y_m, pose.heading_rad) for pose in poses])


def _in_time(one: _Candidate, here: Roadside) -> bool:
    """Whether it can be on the AV's way when the AV comes by, and the AV is not there yet."""
    arrives_s = float(here.arrives_s[one.at])
    if one.road_user == "bicycle":
        return _overtaken(one, here)
    if not _IN_TIME_S[0] <= arrives_s <= _IN_TIME_S[1]:
        return False
    away_m = float(np.hypot(*(here.way_m[one.at] - one.position_m)))
    left_m = away_m - float(here.tracks.size_m[here.av, 1]) / 2 - _HALF_M
    runs = ROAD_USERS["pedestrian"].motion.fastest_mps
    return arrives_s >= _STARTS_S + left_m / runs


def _overtaken(one: _Candidate, here: Roadside) -> bool:
    """Whether the AV comes up to a cyclist within the time of an attack."""
    seconds = np.arange(_IN_TIME_S[0], _IN_TIME_S[1], 0.5)
    ridden = one.at + one.speed_mps * seconds
    reached = np.interp(ridden, np.arange(len(here.arrives_s)), here.arrives_s, right=np.inf)
    return bool((reached <= seconds).any())


Finder = Callable[[Roadside, TrafficCase, np.random.Generator], tuple[list[_Candidate], str]]


def _kerb(
    here: Roadside,
    case: TrafficCase,  # noqa: ARG001
    rng: np.random.Generator,
) -> tuple[list[_Candidate], str]:
    """Somebody who stands at the border of the road, or walks along it."""
    kept = here.kept(_HALF_M)
    found = []
    for side in (-1, 1):
        exits_m = np.where(here.inside, np.nan, here.exits_m(kept, side))
        for at in np.flatnonzero(~np.isnan(exits_m))[::2].tolist():
            gap_m = float(rng.uniform(0.0, GAP_M[1] - GAP_M[0]))
            standing = _standing(here, at, side, float(exits_m[at]) + gap_m)
            walking = _walking(here, exits_m + gap_m, at, side, rng)
            found.append(standing if walking is None or rng.random() >= _WALKS else walking)
    return _beside_road(found, here), "the AV is in a junction, or its road has no border"


def _beside_road(found: Sequence[_Candidate], here: Roadside) -> list[_Candidate]:
    """Those who are not on the carriageway, nor far from it."""
    half_m = {"bicycle": _HALF_BICYCLE_M, "pedestrian": _HALF_M}
    kept = []
    for one in found:
        points = shapely.points(one.position_m[None] if one.way_m is None else one.way_m)
        away_m = shapely.distance(points, here.carriageway) - half_m[one.road_user]
        if GAP_M[0] - 0.05 <= away_m.min() and away_m.max() <= GAP_M[1] + 0.1:
            kept.append(one)
    return kept


def _standing(here: Roadside, at: int, side: Side, offset_m: float) -> _Candidate:
    """Somebody who stands beside the way and looks at it."""
    to_road = -side * here.normal[at]
    return _Candidate(
        at=at,
        position_m=here.beside(at, side, offset_m),
        heading_rad=float(np.arctan2(to_road[1], to_road[0])),
    )


def _walking(
    here: Roadside, offset_m: Floats, at: int, side: Side, rng: np.random.Generator
) -> _Candidate | None:
    """Somebody who walks along the kerb, in either direction; None where it is too short."""
    speed = float(np.clip(rng.normal(WALK_MPS, _ON_FOOT.spread_mps), _SLOWEST_MPS, _FASTEST_MPS))
    return _along(here, offset_m, at, side, speed, backwards=bool(rng.random() < 0.5))


def _along(
    here: Roadside,
    offset_m: Floats,
    at: int,
    side: Side,
    speed: float,
    *,
    backwards: bool = False,
) -> _Candidate | None:
    """Somebody who moves at an offset (P) from the way, as far as that is without a break."""
    low, high = _run(offset_m, at)
    kernel = np.ones(3) / 3
    smooth = np.convolve(np.pad(offset_m[low : high + 1], 1, mode="edge"), kernel, mode="valid")
    smooth = np.maximum(smooth, offset_m[low : high + 1])  # never nearer to the road
    ats = np.arange(low, high + 1)
    line = here.way_m[ats] + side * smooth[:, None] * here.normal[ats]
    if backwards:
        line, ats = line[::-1], ats[::-1]
    if len(line) < 2:
        return None
    along_m = polylines.arc_lengths(line)
    here_m = float(along_m[np.flatnonzero(ats == at)[0]])
    if here_m < speed * _WHOLE_S + _ROOM_M or along_m[-1] - here_m < _SHORTEST_M:
        return None
    (place,), (heading,) = polylines.points_at(line, np.array([here_m]))
    return _Candidate(
        at=at, position_m=place, heading_rad=float(heading), speed_mps=speed, way_m=line
    )


def _run(offset_m: Floats, at: int) -> tuple[int, int]:
    """First and last point around ``at`` between which the offset is known and has no steps."""
    smooth = np.abs(np.diff(offset_m)) <= _STRAIGHT_M  # False at nan, too
    broken = np.flatnonzero(~smooth)
    before, after = broken[broken < at], broken[broken >= at]
    low = int(before[-1]) + 1 if len(before) else 0
    high = int(after[0]) if len(after) else len(offset_m) - 1
    return low, high


def _crossing(
    here: Roadside, case: TrafficCase, rng: np.random.Generator
) -> tuple[list[_Candidate], str]:
    """Somebody at an end of a pedestrian crossing, or beside a stop line where there is none."""
    found = [one for line in crossings(here) for one in _at_ends(line, here, rng)]
    if not found:
        kept = here.kept(_HALF_M)
        ends = stop_lines(here)
        for side in (-1, 1) if ends else ():
            exits_m = here.exits_m(kept, side)
            gap_m = float(rng.uniform(0.0, GAP_M[1] - GAP_M[0]))
            found += [
                _standing(here, at, side, float(exits_m[at]) + gap_m)
                for at in ends
                if not np.isnan(exits_m[at])
            ]
    del case
    return _beside_road(found, here), "the AV comes to no crossing and no traffic light"


def _at_ends(line: Floats, here: Roadside, rng: np.random.Generator) -> Iterator[_Candidate]:
    kept = here.kept(_HALF_M, float(rng.uniform(*GAP_M)))
    middle = shapely.LineString(here.way_m).intersection(shapely.LineString(line)).centroid
    at, _ = here.reached(np.array([middle.x, middle.y]))
    for end, inner in ((line[0], line[1]), (line[-1], line[-2])):
        out = (end - inner) / max(float(np.hypot(*(end - inner))), 1e-9)
        steps = end + np.arange(0.0, 3.0, 0.1)[:, None] * out
        free = np.flatnonzero(~shapely.contains_xy(kept, *steps.T))
        if len(free):
            yield _Candidate(
                at=at,
                position_m=steps[free[0]],
                heading_rad=float(np.arctan2(-out[1], -out[0])),
            )


def _stop(
    here: Roadside, case: TrafficCase, rng: np.random.Generator
) -> tuple[list[_Candidate], str]:
    """Somebody who waits at a bus stop of the additional files."""
    kept = here.kept(_HALF_M)
    exits_m = here.exits_m(kept, here.outer)
    found = []
    for place in bus_stops(here, case):
        at, away_m = here.reached(place)
        side_m = float((place - here.way_m[at]) @ here.normal[at]) * here.outer
        if away_m < _STOP_REACH_M and side_m > -1.0 and not np.isnan(exits_m[at]):
            gap_m = float(rng.uniform(0.0, GAP_M[1] - GAP_M[0]))
            found.append(_standing(here, at, here.outer, float(exits_m[at]) + gap_m))
    return _beside_road(
        found, here
    ), "the AV comes to no bus stop of the network's additional files"


def _beside_vehicles(
    here: Roadside, ends: Sequence[tuple[int, Side, float]], rng: np.random.Generator
) -> list[_Candidate]:
    """Somebody beside the road at points of the way, at least at an offset from it."""
    kept = here.kept(_HALF_M)
    found = []
    for at, side, from_m in ends:
        exit_m = float(here.exits_m(kept, side, from_m)[at])
        if not np.isnan(exit_m) and exit_m - from_m < 6.0:
            gap_m = float(rng.uniform(0.0, GAP_M[1] - GAP_M[0]))
            found.append(_standing(here, at, side, exit_m + gap_m))
    return found


def _behind_vehicle(
    here: Roadside,
    case: TrafficCase,  # noqa: ARG001
    rng: np.random.Generator,
) -> tuple[list[_Candidate], str]:
    """Somebody beyond a vehicle that stands, seen from the AV."""
    ends = []
    for one in parked(here):
        at = round(one.last_m + _HALF_M + _ROOM_M + 0.2)
        if at < len(here.way_m):
            ends.append((at, one.side, max(abs(one.left_m) - 0.5, 0.0)))
    found = _beside_vehicles(here, ends, rng)
    return _beside_road(found, here), "no vehicle stands beside the AV's way"


def _queue(
    here: Roadside,
    case: TrafficCase,  # noqa: ARG001
    rng: np.random.Generator,
) -> tuple[list[_Candidate], str]:
    """Somebody beside the gap between two vehicles that stand one behind the other."""
    standing, ends = parked(here), []
    for one in standing:
        for other in standing:
            gap_m = other.first_m - one.last_m
            in_line = abs(one.left_m - other.left_m) < 1.0
            if in_line and _QUEUE_GAP_M[0] <= gap_m <= _QUEUE_GAP_M[1]:
                at = round((one.last_m + other.first_m) / 2)
                if at < len(here.way_m):
                    ends.append((at, one.side, max(abs(one.left_m) - 0.5, 0.0)))
    found = _beside_vehicles(here, ends, rng)
    return _beside_road(found, here), "no vehicles stand in a queue beside the AV's way"


def _cyclist(
    here: Roadside,
    case: TrafficCase,  # noqa: ARG001
    rng: np.random.Generator,
) -> tuple[list[_Candidate], str]:
    """A cyclist who rides in the direction of traffic, beside the lane near the kerb."""
    kept = here.kept(_HALF_BICYCLE_M)
    exits_m = np.where(here.inside, np.nan, here.exits_m(kept, here.outer))
    begin = int(np.argmax(here.arrives_s >= 0.0))
    found = []
    for ahead_m in range(int(_AHEAD_M[0]), int(_AHEAD_M[1]), 2):
        at = begin + ahead_m
        if at >= len(exits_m) or np.isnan(exits_m[at]):
            continue
        gap_m = float(rng.uniform(0.0, _NEAR_KERB_M - GAP_M[0]))
        speed = float(rng.uniform(*_CYCLES_MPS))
        one = _along(here, exits_m + gap_m, at, here.outer, speed)
        if one is not None:
            found.append(replace(one, road_user="bicycle"))
    return _beside_road(found, here), "there is no room beside the AV's road"


_FINDERS: Final[dict[PersonPlace, Finder]] = {
    "kerb": _kerb,
    "crossing": _crossing,
    "stop": _stop,
    "behind_vehicle": _behind_vehicle,
    "queue": _queue,
    "cyclist": _cyclist,
}


def _given(
    people: Sequence[GivenPerson], case: TrafficCase, rollout: Rollout
) -> tuple[MadeRoadUser, ...]:
    """The people whom a spec puts somewhere, in its order."""
    tracks, found = rollout.tracks, list[MadeRoadUser]()
    height = float(tracks.z_m[tracks.row(case.av_id), rollout.now])
    for one in people:
        position = np.array(one.position_m, float)
        way = np.array(one.way_m, float).reshape(-1, 2)
        made = MadeRoadUser(
            id="",
            road_user=one.road_user,
            position_m=position,
            heading_rad=one.heading_rad,
            speed_mps=one.speed_mps,
            place=one.place,
            way_m=way if len(way) > 1 else _straight(one, case.duration_steps * DT_S),
            z_m=height,
            since_s=-_WHOLE_S,
        )
        taken = {*tracks.ids, *(other.id for other in found)}
        found.append(replace(made, id=_free_name(made, taken)))
    return tuple(found)


def people_later(people: WantedPeople, seconds: float) -> dict[str, Any]:
    """Given people as a spec has them that begins later: where they are then without an attack."""
    values: dict[str, Any] = people.model_dump(mode="json")
    for one, written in zip(people.given, values["given"], strict=True):
        way = np.array(one.way_m, float).reshape(-1, 2)
        pose = without_attack(
            MadeRoadUser(
                id="",
                road_user=one.road_user,
                position_m=np.array(one.position_m, float),
                heading_rad=one.heading_rad,
                speed_mps=one.speed_mps,
                way_m=way if len(way) > 1 else _straight(one, seconds),
            ),
            seconds,
        )
        written |= {
            "position_m": [pose.x_m, pose.y_m],
            "heading_rad": pose.heading_rad,
            "speed_mps": pose.speed_mps,
        }
    return values


def _straight(one: GivenPerson, seconds: float) -> Floats | None:
    """The way (2, 2) of somebody who is given without one: straight on, for a time."""
    if not one.speed_mps:
        return None
    ahead = frames.unit(np.array(one.heading_rad))
    far_m = one.speed_mps * (seconds + _WHOLE_S) + 10.0
    return np.asarray(one.position_m + np.array([[-2 * one.speed_mps], [far_m]]) * ahead, float)
