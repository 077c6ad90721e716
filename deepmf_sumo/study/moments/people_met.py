"""Whether people could meet a moving AV: it drives on, and somebody gets onto its way in time.

Who walks into an AV that stands in a queue says nothing about the AV, so that attacks by people
begin where it drives for most of the time that they have.
"""

from typing import Final

import numpy as np

from deepmf_sumo.scene import Bools, Floats
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.sumo.simulation.road_users import kind_of
from deepmf_sumo.sumo.simulation.traffic_survey import Sightings

DRIVES_MPS: Final = 3.0
_MOST: Final = 0.75
_FIRST_S: Final = 2
"""Sooner nobody gets onto its way."""
_SETS_OFF_S: Final = 1.0
_ROUNDING_S: Final = 0.01
_NEAR_M: Final = 1.0
"""Half of the AV and half of a person."""
_HURRIES_MPS: Final = {
    kind: ROAD_USERS[kind].motion.usual_mps[-1] for kind in ("pedestrian", "bicycle")
}


def drives(sightings: Sightings, duration_s: float) -> Bools:
    """(K) whether it drives at 3 m/s or more at three quarters of the seconds of an attack."""
    later, seconds = _Later(sightings, duration_s), range(1, max(round(duration_s), 1) + 1)
    fast = [later(sightings.speed_mps, second) >= DRIVES_MPS for second in seconds]
    driven: Bools = np.mean(fast, axis=0) >= _MOST  # who has left does not drive
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
        at = np.minimum(np.searchsorted(key, wanted - _ROUNDING_S), len(key) - 1)
        later = np.array(values[self._order[at]], float)
        later[np.abs(key[at] - wanted) > _ROUNDING_S] = np.nan
        return later
