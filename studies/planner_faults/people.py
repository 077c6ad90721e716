"""A planner that is careful with people, and copies of it with exactly one fault each.

It is `careful`, which brakes for who is, or will be, in its corridor, and it is prepared besides:

- past a pedestrian who stands beside the road, near enough to step out, it is slow enough to stop
  within the time that a step out takes;
- past a standing vehicle that hides a place where somebody could walk out, likewise. It knows only
  what a view holds: with ``av_sees: in_sight`` nobody behind such a vehicle is in it.

In a spec::

    planner: {name: "studies.planner_faults.people:FaultyWithPeople", fault: blind_pedestrians}
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np
from pydantic import Field

from deepmf_sumo.scene import Bools, Command, Floats, View
from deepmf_sumo.scene.geometry import boxes, frames, sight
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.scene.road_users import ROAD_USERS
from studies.planner_faults import careful, faults
from studies.planner_faults.faults import Episode, Fault, with_speeds, without
from studies.planner_faults.unguarded import Others

_ON_FOOT: Final = ROAD_USERS["pedestrian"]
_WALK_MPS: Final = 1.4
"""5 km/h, as Euro NCAP's adult."""
_BRAKES_MPS2: Final = 4.0
_ANSWERS_S: Final = 0.4
_SLOWEST_MPS: Final = 3.0
"""It is never prepared by being slower."""
_BESIDE_M: Final = 5.0
"""Who stands farther from the corridor is seen in time once he walks."""
_AHEAD_M: Final = 45.0
_FROM_MPS2, _GENTLE_MPS2 = 1.5, 2.4
"""It slows down once that takes the first, and never harder than the second."""
_BEHIND_IT_M: Final = 0.6
"""From a vehicle to the middle of somebody who comes out behind it."""
_LATE_STEPS: Final = 10


class Settings(careful.Settings):
    """Those of `careful`, and how far ahead it minds who stands, and what it cannot see, in m."""

    kerb_m: float = Field(default=_AHEAD_M, ge=0.0)
    hidden_m: float = Field(default=_AHEAD_M, ge=0.0)


class CarefulWithPeople(careful.Careful):
    """See the module."""

    Settings = Settings
    _view: View

    def act(self, view: View) -> Command:
        """As `careful`, with more that it brakes for."""
        self._view = view
        return super().act(view)

    def risk(self, sight: careful._Sight) -> careful.Risk:
        """The deceleration that each of the others asks for, or that being prepared does."""
        found, settings = super().risk(sight), self._settings
        assert isinstance(settings, Settings)
        beside = _Beside.of(sight)
        prepared = np.maximum(
            _slower(sight, *beside.who_stands(), settings.kerb_m),
            _slower(sight, *beside.what_is_hidden(self._view), settings.hidden_m),
        )
        return careful.Risk(found.ids, np.maximum(found.braking_mps2, prepared))


class _Beside:
    """The N others beside the AV's corridor who stand.

    Attributes:
        stands: (N) and is beside it. clear_m: (N) from its box to the corridor.
        rear_m, far_m: (N) ends along the path, from the AV's front bumper.
    """

    def __init__(
        self, sight: careful._Sight, stands: Bools, clear_m: Floats, far_m: Floats, course: Floats
    ) -> None:
        self._sight, self._stands, self._course = sight, stands, course
        self._clear_m, self._far_m = clear_m, far_m
        self._kinds = np.array(sight.now.kinds)

    @classmethod
    def of(cls, sight: careful._Sight) -> "_Beside":
        now = sight.now
        foot = sight.path.project(now.position_m[:, -1])
        turn = frames.difference(now.heading_rad[:, -1], foot.heading_rad)
        length, width = sight.others_m.T
        along = (length * np.abs(np.cos(turn)) + width * np.abs(np.sin(turn))) / 2
        across = (length * np.abs(np.sin(turn)) + width * np.abs(np.cos(turn))) / 2
        clear_m = np.abs(foot.left_m) - across - float(sight.size_m[1]) / 2
        stands = (now.speed_mps[:, -1] < WAITING_MPS) & (clear_m > 0) & (clear_m < _BESIDE_M)
        far_m = foot.along_m + along - float(sight.size_m[0]) / 2
        return cls(sight, stands, clear_m, far_m, foot.heading_rad)

    def who_stands(self) -> tuple[Bools, Floats, Floats]:
        """(N) pedestrians, (N) metres to them, (N) seconds until one who sets off is in the way."""
        rises_s = _WALK_MPS / _ON_FOOT.motion.planned.accel
        rises_m = _WALK_MPS * rises_s / 2
        walks_s = rises_s + (self._clear_m - rises_m) / _WALK_MPS
        at_once = np.sqrt(2 * np.maximum(self._clear_m, 0.0) / _ON_FOOT.motion.planned.accel)
        enters_s = np.where(self._clear_m < rises_m, at_once, walks_s)
        return self._stands & (self._kinds == "pedestrian"), self._far_m, enters_s

    def what_is_hidden(self, view: View) -> tuple[Bools, Floats, Floats]:
        """(N) vehicles that hide a place behind them, (N) metres to it, (N) seconds from there.

        The place is empty: another vehicle there leaves no room.
        """
        now, tracks = self._sight.now, view.history
        vehicle = np.isin(self._kinds, ("pedestrian", "cyclist"), invert=True)
        near = self._stands & vehicle & (self._far_m > 0)
        rows = np.flatnonzero(near)
        found = np.zeros(len(near), bool)
        enters_s = self._clear_m / _WALK_MPS
        if not len(rows):
            return found, self._far_m, enters_s
        ahead = frames.unit(self._course[rows])
        half_m = (now.size_m[rows, 0] / 2 + _BEHIND_IT_M)[:, None]
        places_m = now.position_m[rows, -1] + half_m * ahead
        me = tracks.row(view.av_id)
        others = np.array([at for at in range(tracks.agents) if at != me])
        opaque = others[[tracks.kinds[at] not in ("pedestrian", "cyclist") for at in others]]
        pose = tracks.position_m[:, -1], tracks.heading_rad[:, -1]
        size = np.broadcast_to(np.array(_ON_FOOT.size_m), (len(rows), 3))
        somebody = sight.Upright(places_m, self._course[rows], size, now.z_m[rows, -1])
        hides = sight.Upright(*(one[opaque] for one in pose), _solid(tracks.size_m[opaque]),
                              tracks.z_m[opaque, -1])  # fmt: skip
        eye = sight.Eye.of(
            pose[0][me], float(pose[1][me]), tracks.size_m[me], float(tracks.z_m[me, -1])
        )
        nobody = np.zeros((len(rows), len(opaque)), bool)
        share = sight.column_shares(eye, somebody, hides, nobody, np.zeros((0, 2, 2)))
        taken = boxes.overlap(
            places_m[:, None], self._course[rows][:, None], size[0, :2],
            hides.centre_m[None], hides.heading_rad[None], hides.size_m[None, :, :2],
        ).any(axis=1)  # fmt: skip
        found[rows] = (share < sight.VISIBLE) & ~taken
        return found, self._far_m + _BEHIND_IT_M, enters_s


def _solid(size_m: Floats) -> Floats:
    """(A, 3) sizes; what has no height is as high as a car."""
    known = np.where(size_m[:, 2] > 0, size_m[:, 2], ROAD_USERS["car"].size_m[2])
    return np.column_stack([size_m[:, :2], known])


def _slower(
    sight: careful._Sight, minds: Bools, ahead_m: Floats, enters_s: Floats, within_m: float
) -> Floats:
    """(N) deceleration to be as slow as each place asks for by the time the AV is there."""
    fit_mps = np.maximum(_SLOWEST_MPS, _BRAKES_MPS2 * (enters_s - _ANSWERS_S))
    room_m = np.maximum(ahead_m, 1.0)
    asked = (sight.speed_mps**2 - fit_mps**2) / (2 * room_m)
    minds = minds & (ahead_m > 0) & (ahead_m < within_m) & (asked >= _FROM_MPS2)
    return np.where(minds, np.minimum(asked, _GENTLE_MPS2), 0.0)


def _of_kind(seen: Others, kind: str) -> Bools:
    return np.array([one == kind for one in seen.view.history.kinds], bool)


def _at_the_kerb(seen: Others) -> Bools:
    """Pedestrians who stand and are not in the corridor."""
    return _of_kind(seen, "pedestrian") & (seen.speed_mps < WAITING_MPS) & (seen.clearance_m > 0)


def _late_for_people(view: View, _: Episode) -> View:
    """Pedestrians and cyclists as they were a second ago; who was not there then is not seen."""
    tracks = view.history
    people = np.array([kind in ("pedestrian", "cyclist") for kind in tracks.kinds], bool)
    column = np.maximum(np.arange(tracks.steps) - _LATE_STEPS, 0)
    changed = {}
    for name in ("valid", "position_m", "z_m", "heading_rad", "velocity_mps"):
        values = getattr(tracks, name).copy()
        values[people] = getattr(tracks, name)[people][:, column]
        changed[name] = values
    shown = replace(tracks, **changed)
    return replace(view, history=shown.select(np.flatnonzero(shown.valid[:, -1]).tolist()))


FAULTS: Final[dict[str, Fault]] = {
    "blind_pedestrians": Fault(
        about="does not see pedestrians", seen=without(lambda one: _of_kind(one, "pedestrian"))
    ),
    "blind_cyclists": Fault(
        about="does not see cyclists", seen=without(lambda one: _of_kind(one, "cyclist"))
    ),
    "late_for_people": Fault(
        about="sees pedestrians and cyclists as they were 1 s ago", seen=_late_for_people
    ),
    "ignores_kerb": Fault(
        about="does not see pedestrians who stand, unless in its corridor",
        seen=without(_at_the_kerb),
    ),
    "slow_cyclists": Fault(
        about="takes cyclists to ride at half their speed",
        seen=with_speeds(lambda one: np.where(_of_kind(one, "cyclist"), 0.5, 1.0)),
    ),
    "blind_behind_vehicles": Fault(
        about="drives past what it cannot see behind standing vehicles as if it were empty",
        settings={"hidden_m": 0.0},
    ),
}
"""All faults of people by name; written before any was measured."""


class FaultySettings(faults.Settings):
    """As of `faults.Settings`, with the faults of people."""

    faults: ClassVar[Mapping[str, Fault]] = FAULTS


class FaultyWithPeople(faults.Faulty):
    """The planner that is careful with people, with one fault."""

    Settings = FaultySettings
    planner = CarefulWithPeople
