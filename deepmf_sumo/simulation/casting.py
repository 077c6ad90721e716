"""Who plays the AV, and who its partner, in a scene recorded from SUMO."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Floats, Tracks
from deepmf_sumo.geometry import angles, boxes
from deepmf_sumo.geometry.ground import distance_m

_MOVES_M = 10.0
_PARTNER_MOVES_M = 3.0
_NEIGHBOURS = 2
_NEIGHBOUR_M = 50.0
_PARTNER_GAP_M = 8.0
_TURN_RAD = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Cast:
    """Rows kept, sorted; the AV; the two interacting vehicles, or none; vehicles to predict."""

    rows: list[int]
    av_id: AgentId
    interest: tuple[AgentId, ...]
    to_predict: tuple[AgentId, ...]


def choose(
    tracks: Tracks, now: int, radius_m: float, rng: np.random.Generator, most: int = 1
) -> list[Cast]:
    """Draw AVs among the vehicles that are there throughout, move, and have others around.

    Those who turn, or whose speed changes, are drawn more often: most traffic just drives on.
    Returns at most ``most`` casts, none if there is nobody like that.
    """
    car = np.array([kind == "vehicle" for kind in tracks.kinds], bool)
    moved = _travelled(tracks)
    here = tracks.valid[:, now]
    between = np.hypot(*np.moveaxis(_offsets(tracks.position_m[:, now]), -1, 0))
    around = ((between < _NEIGHBOUR_M) & here & here[:, None] & car).sum(axis=1) - 1
    suits = np.flatnonzero(
        car & tracks.valid.all(axis=1) & (moved > _MOVES_M) & (around >= _NEIGHBOURS)
    )
    if not len(suits):
        return []
    weight = _eventfulness(tracks, now)[suits]
    count = min(most, len(suits))
    drawn = rng.choice(suits, count, replace=False, p=weight / weight.sum())
    movers = car & here & (moved > _PARTNER_MOVES_M)
    return [_cast(tracks, int(av), now, radius_m, movers, between[av]) for av in drawn]


def _cast(
    tracks: Tracks, av: int, now: int, radius_m: float, movers: Bools, away_now: Floats
) -> Cast:
    away = np.hypot(*np.moveaxis(tracks.position_m - tracks.position_m[av], -1, 0))
    kept = np.where(tracks.valid, away, np.inf).min(axis=1) < radius_m
    partner = _partner(tracks, av, now, movers & kept)
    others = movers & kept
    others[av] = False
    nearest = [int(row) for row in np.argsort(away_now, kind="stable") if others[row]][:8]
    return Cast(
        rows=[int(row) for row in np.flatnonzero(kept)],
        av_id=tracks.ids[av],
        interest=() if partner is None else (tracks.ids[av], tracks.ids[partner]),
        to_predict=tuple(tracks.ids[row] for row in [av, *nearest]),
    )


def _eventfulness(tracks: Tracks, now: int) -> Floats:
    """(A) from 1 for who drives on evenly, up to 7 for who turns and brakes or starts."""
    heading = tracks.heading_rad[:, now::10]
    turned = np.abs(angles.difference(heading[:, 1:], heading[:, :-1])).sum(axis=1)
    speed = np.where(tracks.valid, tracks.speed_mps, np.nan)[:, now:]
    known = tracks.valid[:, now:].any(axis=1)
    change = np.zeros(tracks.agents)
    change[known] = np.nanmax(speed[known], axis=1) - np.nanmin(speed[known], axis=1)
    eventfulness: Floats = 1.0 + 3.0 * (turned > _TURN_RAD) + 3.0 * np.minimum(change / 6.0, 1.0)
    return eventfulness


def _travelled(tracks: Tracks) -> Floats:
    step = np.hypot(*np.moveaxis(np.diff(tracks.position_m, axis=1), -1, 0))
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    travelled: Floats = np.where(both, step, 0.0).sum(axis=1)
    return travelled


def _offsets(position: Floats) -> Floats:
    offsets: Floats = position[:, None] - position
    return offsets


def _partner(tracks: Tracks, av: int, now: int, candidates: Bools) -> int | None:
    """The moving vehicle whose box comes closest to the AV's at one time after ``now``."""
    rows = [int(row) for row in np.flatnonzero(candidates) if row != av]
    if not rows:
        return None
    gap = boxes.gap(
        tracks.position_m[av, now:],
        tracks.heading_rad[av, now:],
        tracks.size_m[av, :2],
        tracks.position_m[rows, now:],
        tracks.heading_rad[rows, now:],
        np.broadcast_to(tracks.size_m[rows, None, :2], (*tracks.position_m[rows, now:].shape,)),
    )
    gap = distance_m(gap, tracks.z_m[av, now:], tracks.z_m[rows, now:])
    closest = np.where(tracks.valid[rows, now:], gap, np.inf).min(axis=1)
    best = int(closest.argmin())
    return rows[best] if closest[best] < _PARTNER_GAP_M else None
