"""Rules of the road: each says of N futures (N) whether they break it."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, View
from deepmf_sumo.geometry import boxes, frames
from deepmf_sumo.geometry.ground import clear
from deepmf_sumo.policies.factorization.lawful.driven import PACE_S, Driven
from deepmf_sumo.policies.factorization.lawful.lines import RED
from deepmf_sumo.policies.factorization.lawful.road_ahead import (
    EVERY_STEPS,
    OFF,
    lanes_at,
    on_lane,
    width_m,
)

GIVE_WAY_S: Final = 1.5
FOLLOW_S: Final = 1.0
CAUSELESS_MPS2: Final = 2.0
_FASTER = 1.1  # times the speed limit
_OUTSIDE_M = 0.3  # a box that reaches so far out of its lane leaves it
_CUT_IN_S = 2.0  # so long after it left its lane it has to leave the AV room
_SAME_WAY = 0.7  # cosine: within 45 degrees
_SLOWING_S = 0.4


def off_lanes(driven: Driven) -> Bools:
    """Somewhere on none of the lanes that lead on from its own."""
    off: Bools = np.asarray((driven.ways.nearest == OFF).any(axis=1))
    return off


def speeds(driven: Driven) -> Bools:
    """Faster than the lane allows, and than now."""
    limits = np.array([lane.speed_limit_mps or np.inf for lane in driven.ways.lanes])
    allowed = np.maximum(_FASTER * limits[driven.ways.nearest], driven.start.speed_mps)
    too_fast: Bools = np.asarray((driven.speed_mps > allowed + 0.1).any(axis=1))
    return too_fast


def takes_way(view: View, driven: Driven) -> Bools:
    """On a link that gives way to the AV's, in front of the AV; not where the AV's light is red."""
    takes = np.zeros(len(driven.position_m), bool)
    for row, lane in enumerate(driven.ways.lanes):
        first = [view.road.lanes[name] for name in lane.gives_way_to if name in view.road.lanes]
        first = [one for one in first if view.signals.get(one.id) not in RED]
        if not first or driven.ways.begins[row]:
            continue
        used = [on_lane(one, driven.av_position_m, driven.av_heading_rad)[0] for one in first]
        goes_first = np.any(used, axis=(0, 2))  # (K)
        if goes_first.any():
            there = driven.ways.on[:, :, row, None] & driven.av_comes(GIVE_WAY_S)
            takes |= driven.ways.driven[:, row] & (there & goes_first).any(axis=(1, 2))
    return takes


def through(view: View, driven: Driven) -> Bools:
    """(L) lanes inside a junction at whose end nobody has to be waited for.

    None where the map tells no right of way: there anybody may have to be waited for.
    """
    lanes = view.road.lanes
    known = any(one.gives_way_to for one in lanes.values())
    free: list[bool] = []
    for lane in driven.ways.lanes:
        after = [lanes[name] for name in lane.next if name in lanes]
        waits = any(one.interpolating and one.gives_way_to for one in after)
        free.append(known and lane.interpolating and not waits)
    return np.array(free, bool)


def blocks(driven: Driven, free: Bools, so_far_mps: float) -> Bools:
    """Slows down to less than half inside a junction that it could be through.

    ``free``: as of `through`; ``so_far_mps``: its highest speed there until now.
    """
    inside = np.append(free, False)[driven.ways.nearest]  # `OFF` is the last
    fastest = np.maximum.accumulate(np.where(inside, driven.speed_mps, 0.0), axis=1)
    slowest = np.maximum(fastest, so_far_mps) / 2 - 0.1
    broken: Bools = np.asarray((inside & (driven.speed_mps < slowest)).any(axis=1))
    return broken


def cuts_in(driven: Driven, collision_step: Floats) -> Bools:
    """Leaves its lane right before the AV, or is out of it where it touches the AV."""
    ways = driven.ways
    rows = np.flatnonzero(ways.straight)
    slack = [(width_m(ways.lanes[row]) - driven.size_m[1]) / 2 + _OUTSIDE_M for row in rows]
    inside = ways.on[..., rows] & (np.abs(ways.left_m[..., rows]) <= np.maximum(slack, 0.5))
    outside = ~np.asarray(inside.any(axis=-1))
    leaving = outside & (np.cumsum(outside, axis=1) * PACE_S <= _CUT_IN_S)
    cuts = leaving[..., None] & driven.av_comes(GIVE_WAY_S)
    time = collision_step.astype(int) // EVERY_STEPS  # (N, M), beyond the last where there is none
    there = np.minimum(time, outside.shape[1] - 1)
    touches = np.take_along_axis(outside, there, axis=1) & (time <= there)
    broken: Bools = np.asarray(cuts.any(axis=(1, 2)) | touches.any(axis=1))
    return broken


def hinders(view: View, driven: Driven, collides: Bools, halts: bool) -> Bools:
    """Comes too near to the AV ahead in its lane, or brakes before the AV without a cause.

    ``collides`` (N): the future touches the AV in one of its reactions; ``halts``: a line makes the
    opponent stop.
    """
    if _follows(view, driven):
        near = np.any([driven.meets(-back) for back in (PACE_S, FOLLOW_S / 2, FOLLOW_S)], axis=0)
        faster = (driven.speed_mps > driven.start.speed_mps + 0.1).any(axis=1)
        pushes: Bools = collides | (near.any(axis=(1, 2)) & faster)
        return pushes
    if halts or not _leads(driven):
        return np.zeros(len(collides), bool)
    now = np.full((len(collides), 1), driven.start.speed_mps)
    speed = np.concatenate([now, driven.speed_mps], axis=1)
    span = round(_SLOWING_S / PACE_S)
    slowing = (speed[:, :-span] - speed[:, span:]).max(axis=1, initial=0.0) / _SLOWING_S
    turns = np.cos(driven.heading_rad - driven.start.heading_rad).min(axis=1) < _SAME_WAY
    crawls = driven.speed_mps.min(axis=1) < driven.start.speed_mps / 2
    broken: Bools = (slowing > CAUSELESS_MPS2 + 0.2) | (crawls & ~turns)
    return broken


def _follows(view: View, driven: Driven) -> bool:
    """Whether the AV is ahead in the opponent's lane, or one that it leads to."""
    row = view.history.row(view.av_id)
    position = view.history.position_m[row, -1]
    heading, z_m = view.history.heading_rad[row, -1], view.history.z_m[row, -1]
    under = lanes_at(view.road, position, float(heading), float(z_m))
    ahead = zip(driven.ways.lanes, driven.ways.straight, strict=True)
    shared = {lane.id for lane, straight in ahead if straight} & {*under}
    start = driven.start
    return bool(shared) and frames.to_local(position, start.position_m, start.heading_rad)[0] > 0


def _leads(driven: Driven) -> bool:
    """Whether the AV goes, behind, where the opponent is now."""
    start = driven.start
    hit = boxes.overlap(
        driven.av_position_m,
        driven.av_heading_rad,
        driven.av_size_m,
        start.position_m,
        np.array(start.heading_rad),
        driven.size_m,
    )
    same = np.cos(driven.av_heading_rad - start.heading_rad) > _SAME_WAY
    return bool((hit & same & ~clear(driven.av_z_m, np.array(driven.z_now_m))).any())
