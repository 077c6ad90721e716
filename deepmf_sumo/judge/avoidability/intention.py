"""From when on a driver can act on a person: visible, and with an intention that shows.

A hit by a pedestrian or cyclist is avoidable only by a driver who reacts after both: the person is
in sight (`scene.geometry.sight`), and has entered the road or moves towards it faster than people
walk. Nobody has to brake for all who stand or walk beside a road, and nobody sees through a truck.

- *On the road*: the middle of the person's box is on a lane for cars, or at most 0.5 m beside it.
  Where the AV itself is off all lanes (a car park), the map does not tell where the road is, and
  every place counts as road.
- *Faster than people walk*: 1.84 m/s towards the nearest lane, over 0.5 s: the mean of 1.36 m/s and
  two standard deviations of 0.24 m/s (Randles, 288 people). Euro NCAP's running adult (8 km/h)
  shows it on the pavement, its walking adult (5 km/h) with the first step into the road.
- What was shown and taken back before does not count: the intention lasts up to the contact.

Standards say little about intentions. UN R157 (5.2.5) asks that a crossing pedestrian who is not
obstructed does not get hit, up to 60 km/h, and leaves timing to tests; R152 and Euro NCAP let an
unobstructed pedestrian or cyclist start metres beside the road, and measure from there.

The driver is ``vru``, see `CarefulWithPeople`. The models of R157 are of cars that cut in or brake:
they know no pedestrians, and do not judge hits by them.
"""

from typing import Final

import numpy as np

from deepmf_sumo.judge.avoidability.reference_drivers import (
    DELAY_S,
    JERK_MPS3,
    MODELS,
    CompetentCareful,
    DriverModel,
    Sight,
    in_the_way,
)
from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, Rollout, Tracks
from deepmf_sumo.scene.geometry import road, sight
from deepmf_sumo.scene.geometry.ground import on_level
from deepmf_sumo.scene.geometry.slow import STANDING_MPS
from deepmf_sumo.scene.road_users import ROAD_USERS, road_user

_WALK: Final = ROAD_USERS["pedestrian"].motion
_FASTEST_WALK_MPS: Final = _WALK.usual_mps[0] + 2 * _WALK.spread_mps
"""Hardly anybody walks faster."""
_PACE_S: Final = 0.5
_NEAR_M: Final = 20.0
"""Lanes farther away are not looked for."""
_EMERGED_S: Final = 1.0
"""A person that was hidden longer ago counts as in sight since."""
_NOWHERE: Final = RoadMap(lanes={})


class CarefulWithPeople:
    """Brakes fully once a person is in the way, 0.75 s after the person could be understood.

    The reaction time, the jerk (12.65 m/s3) and the full braking (0.774 g) are those of the
    competent and careful driver of UN R157. Braking begins if the person, at its velocity, enters
    the AV's corridor before the AV has passed and is still there when the AV comes; it goes on to
    standstill. Who walks into the car after it has stopped was not hit by it.
    """

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """Nothing for 0.75 s, then the ramp, whatever follows."""
        middle_s = since_s + sight.dt_s / 2
        ramp = np.minimum(JERK_MPS3 * (middle_s - DELAY_S), CompetentCareful.HARDEST_MPS2)
        return in_the_way(sight), np.maximum(ramp, 0.0)


MODELS_FOR_PEOPLE: Final[dict[str, DriverModel]] = {"vru": CarefulWithPeople()}
"""The reference driver for hits by pedestrians and cyclists, by its name."""


def is_person(tracks: Tracks, row: int) -> bool:
    """Whether an agent is a pedestrian or a cyclist."""
    return road_user(tracks.kinds[row], tracks.size_m[row]).person


def models_for(tracks: Tracks, row: int) -> dict[str, DriverModel]:
    """The reference drivers that judge hits by an agent."""
    return MODELS_FOR_PEOPLE if is_person(tracks, row) else MODELS


def shown_since(
    rollout: Rollout, road_map: RoadMap | None, row: int, first: int, contact: int
) -> int:
    """First step of first..contact from which on a person is understood by the AV's driver.

    The first at which the person is in sight and its intention shows; a driver remembers a person
    that is hidden again later. ``contact`` if there is none.
    """
    tracks, known = rollout.tracks, road_map or _NOWHERE
    steps = np.arange(first, contact)
    taken_back = np.flatnonzero(~_intends(rollout, known, row, steps))
    begin = first if not len(taken_back) else first + int(taken_back[-1]) + 1
    av = tracks.row(rollout.av_id)
    for step in range(begin, contact):
        if sight.shares(tracks, step, av, known, only=row)[row] >= sight.VISIBLE:
            return step
    return contact


def intends_since(
    road_map: RoadMap,
    position_m: Floats,
    av_m: Floats,
    contact: Ints,
    dt_s: float,
    heights_m: tuple[Floats, Floats] | None = None,
) -> Ints:
    """(N) steps from which on futures of a person show its intention, without a break.

    It is `shown_since` for motions that are planned, without the line of sight.

    Args:
        road_map: of the futures.
        position_m: (N, K, 2) of the person.
        av_m: (K, 2) of the AV, at the same steps.
        contact: (N) steps at which they touch: only steps before count. Where nothing is shown
            before, it is these. 0 where they do not touch.
        dt_s: of a step.
        heights_m: (N, K) of the person and (K) of the AV, where the road passes over itself.
    """
    steps = position_m.shape[1]
    row, step = np.nonzero(np.arange(steps) < contact[:, None])
    shows = np.ones(position_m.shape[:2], bool)
    here_m = position_m[row, step]
    z_m, av_z_m = (None, None) if heights_m is None else (heights_m[0][row, step], heights_m[1])
    there = road.on_road(road_map, here_m, z_m) | ~road.on_road(road_map, av_m, av_z_m)[step]
    before = np.maximum(step - round(_PACE_S / dt_s), 0)
    seconds = np.maximum(step - before, 1) * dt_s
    was_m = position_m[row, before]
    fast = np.hypot(*(here_m - was_m).T) / seconds > _FASTEST_WALK_MPS
    look = np.flatnonzero(fast & ~there)
    look_z_m = None if z_m is None else z_m[look]
    away, was = (_to_road_m(road_map, each[look], look_z_m) for each in (here_m, was_m))
    there[look] = (was - away) / seconds[look] > _FASTEST_WALK_MPS
    shows[row, step] = there
    last = steps - 1 - (~shows)[:, ::-1].argmax(axis=1)
    return np.asarray(np.where(shows.all(axis=1), 0, last + 1))


def emerged_from(rollout: Rollout, road_map: RoadMap | None, row: int, onset: int) -> str:
    """What hid a person from the AV just before a step: ``a standing car``; empty for nothing."""
    tracks, known = rollout.tracks, road_map or _NOWHERE
    av = tracks.row(rollout.av_id)
    for step in range(onset - 1, max(onset - 1 - round(_EMERGED_S / rollout.dt_s), -1), -1):
        if not (tracks.valid[row, step] and tracks.valid[av, step]):
            break
        found = sight.hidden_by(tracks, step, av, row, known)
        if found == "building":
            return "a building"
        if found is not None:
            noun = road_user(tracks.kinds[found], tracks.size_m[found]).noun
            stands = tracks.speed_mps[found, step] <= STANDING_MPS
            return f"a {'standing ' * bool(stands)}{noun}"
    return ""


def in_sight_for(rollout: Rollout, road_map: RoadMap, row: int, steps: Ints) -> bool:
    """Whether the AV sees a person at all steps (K)."""
    av = rollout.tracks.row(rollout.av_id)
    shares = (sight.shares(rollout.tracks, step, av, road_map, only=row)[row] for step in steps)
    return all(share >= sight.VISIBLE for share in shares)


def on_road(
    rollout: Rollout, road_map: RoadMap, row: int, steps: Ints, *, bicycles: bool = False
) -> Bools:
    """(K) whether an agent is on the road at steps (K), see the module.

    ``bicycles``: cycle lanes are road to it.
    """
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)
    there, av_there = (
        road.on_road(road_map, tracks.position_m[one, steps], tracks.z_m[one, steps], bicycles=too)
        for one, too in ((row, bicycles), (av, False))
    )
    return np.asarray(there | ~av_there)


def _intends(rollout: Rollout, road_map: RoadMap, row: int, steps: Ints) -> Bools:
    """(K) whether a person is on the road or moves towards it faster than people walk."""
    tracks = rollout.tracks
    before = np.maximum(steps - round(_PACE_S / rollout.dt_s), 0)
    away, was = (
        _to_road_m(road_map, tracks.position_m[row, at], tracks.z_m[row, at])
        for at in (steps, before)
    )
    seconds = np.maximum(steps - before, 1) * rollout.dt_s
    faster = (was - away) / seconds > _FASTEST_WALK_MPS
    known = tracks.valid[row, steps] & tracks.valid[row, before]
    return on_road(rollout, road_map, row, steps) | (faster & known)


def _to_road_m(road_map: RoadMap, points_m: Floats, z_m: Floats | None) -> Floats:
    """(K) distance of points (K, 2) to the nearest lane's edge; 20 m where none is nearer.

    Heights (K): lanes of other levels do not count.
    """
    lanes = road.lanes_for_cars(road_map)
    feet = lanes.feet(points_m, lanes.widest_m + _NEAR_M)
    away = np.hypot(*feet.away_m.T) - lanes.reach_m[lanes.lane[feet.segment]]
    found = np.full(len(points_m), _NEAR_M)
    level = np.ones(len(away), bool)
    if z_m is not None:
        level = on_level(road_map, z_m[feet.point], lanes.heights_m(feet))
    np.minimum.at(found, feet.point[level], np.maximum(away, 0.0)[level])
    return found
