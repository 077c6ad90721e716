"""Where a vehicle would have been without the attack: one answer for all methods and worlds.

Onset, avoidability and naturalness compare an attack with this motion. It is a fact about the
world: no plan, prediction or reason of the attack has an influence, so that the same motion has the
same grade, whichever method drove it. In order of preference:

- ``log``: the recording, where it drives all vehicles but the AV. It does not react, so no planner
  of the AV changes it, and nothing has to be simulated.
- ``episode``: the same episode without an attack (`scene.Case.unattacked`), where SUMO drives.
- ``lane``: the vehicle goes on along its lane at the speed that it had. For attacks whose episode
  cannot be repeated: in a simulation that another program steps, with an AV that a learner drives,
  and after an earlier attack of the same episode that has changed the world.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from deepmf_sumo.scene import (
    AgentId,
    Bools,
    Case,
    Floats,
    Lane,
    RecordedCase,
    RoadMap,
    Rollout,
    Tracks,
)
from deepmf_sumo.scene._arrays import Frozen
from deepmf_sumo.scene.geometry import frames, polylines, road
from deepmf_sumo.scene.geometry.ground import ground_of, on_nearest_level

By = Literal["log", "episode", "lane", "prediction"]
"""What a counterfactual rests on. ``prediction``: only in results of earlier versions."""
_SAME_M: Final = 0.01
"""A vehicle that is nearer than this to its unattacked position is where it would have been."""
_EQUAL_M: Final = 1e-6
"""Equal episodes are equal to the bit; this much is rounding of stored tracks."""
_ALIGNED_RAD: Final = np.pi / 4
_BEYOND_M: Final = 100.0
"""Lanes are followed this much farther than the vehicle goes on them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counterfactual(Frozen):
    """The motion of one vehicle without the attack, at the T steps of a rollout or of its case.

    Attributes:
        by: what it rests on.
        position_m: (T, 2) box centre, from the rollout's first step on.
        known: (T) whether the position at a step is known.
    """

    by: By
    position_m: Floats
    known: Bools

    def away_m(self, position_m: Floats, first: int) -> Floats:
        """(K) distance of positions (K, 2) at steps from ``first`` on; 0 where it is not known."""
        away = np.zeros(len(position_m))
        here = slice(first, min(first + len(position_m), len(self.known)))
        known = np.flatnonzero(self.known[here])
        away[known] = np.hypot(*(position_m[known] - self.position_m[here][known]).T)
        return away


def counterfactual(rollout: Rollout, case: Case, agent_id: AgentId) -> Counterfactual:
    """Where an agent of the rollout would have been without the attack that began at its ``now``.

    The recording or the unattacked episode tells it only if they are still the same world when the
    attack begins: the agent is where they have it, and with SUMO's traffic, which reacts, so is the
    AV. Otherwise the agent keeps its lane and speed.
    """
    by: By = "episode"
    alone = case.unattacked
    judged: tuple[AgentId, ...] = (agent_id, rollout.av_id)
    if isinstance(case, RecordedCase) and case.traffic == "log":
        by, alone, judged = "log", case.scene.tracks, (agent_id,)
    if alone is None or not all(_begins_alike(rollout, alone, one) for one in judged):
        return _in_lane(rollout, case.road, agent_id)
    row = alone.row(agent_id)
    return Counterfactual(by=by, position_m=alone.position_m[row], known=alone.valid[row])


def unrepeated_m(rollout: Rollout, case: Case) -> tuple[int, float] | None:
    """The first step at which the AV is elsewhere than without the attack, and how far.

    Only where nothing else was elsewhere before that step, so that the planner saw the same and
    answered otherwise: two equal episodes of it differ. None where it did the same, or where no
    episode without the attack is known.
    """
    alone, tracks = case.unattacked, rollout.tracks
    if alone is None:
        return None
    steps = min(tracks.steps, alone.steps)
    both = [one for one in tracks.ids if one in alone.ids]
    mine, theirs = ([each.row(one) for one in both] for each in (tracks, alone))
    away = np.linalg.norm(
        tracks.position_m[mine, :steps] - alone.position_m[theirs, :steps], axis=2
    )
    there, then = tracks.valid[mine, :steps], alone.valid[theirs, :steps]
    moved = (there != then) | (there & then & (away > _EQUAL_M))
    av = both.index(rollout.av_id) if rollout.av_id in both else None
    changed = np.flatnonzero(moved.any(axis=0))
    if av is None or not len(changed) or not moved[av, changed[0]] or changed[0] <= rollout.now:
        return None
    step = int(changed[0])
    return step, float(away[av, step]) if there[av, step] and then[av, step] else math.inf


def _begins_alike(rollout: Rollout, alone: Tracks, agent_id: AgentId) -> bool:
    """Whether an agent begins the attack where it is without it."""
    now, tracks = rollout.now, rollout.tracks
    if agent_id not in alone.ids or agent_id not in tracks.ids or now >= alone.steps:
        return False
    mine, theirs = tracks.row(agent_id), alone.row(agent_id)
    away = tracks.position_m[mine, now] - alone.position_m[theirs, now]
    there = tracks.valid[mine, now] and alone.valid[theirs, now]
    return bool(there and np.hypot(*away) < _SAME_M)


def likeliest(position_m: Floats, origin: Sequence[str]) -> Floats:
    """(F, 2) likeliest prediction of candidates (M, F, 2), most likely first, with origins (M).

    While an attack is planned no future is known, and this stands in for it (`deepmf.constraints`).
    Judgements do not ask it.
    """
    return position_m[origin.index("mode") if "mode" in origin else 0]


def predicted(first_step: int, position_m: Floats) -> Counterfactual:
    """A prediction (F, 2) from a step on, with which earlier versions judged attacks of DeepMF."""
    missing = [(first_step, 0), (0, 0)]
    known = np.arange(first_step + len(position_m)) >= first_step
    return Counterfactual(by="prediction", position_m=np.pad(position_m, missing), known=known)


def _in_lane(rollout: Rollout, road_map: RoadMap, agent_id: AgentId) -> Counterfactual:
    """The agent at the speed that it has when the attack begins, along its lane and those after it.

    Where lanes branch it goes the way to which the driven motion is nearest. It keeps its distance
    from the lane's middle. On no lane nothing is known.
    """
    tracks, row = rollout.tracks, rollout.tracks.row(agent_id)
    steps = np.flatnonzero(tracks.valid[row] & (np.arange(tracks.steps) >= rollout.now))
    position, known = np.zeros((tracks.steps, 2)), np.zeros(tracks.steps, bool)
    points, own = tracks.position_m[row, steps], None
    if len(steps):
        z_m = float(tracks.z_m[row, steps[0]])
        own = _own_lane(road_map, points[0], float(tracks.heading_rad[row, steps[0]]), z_m)
    if own is not None:
        gone_m = tracks.speed_mps[row, steps[0]] * rollout.dt_s * (steps - steps[0])
        reach_m = max(float(gone_m[-1]), float(polylines.arc_lengths(points)[-1])) + _BEYOND_M
        ways = list(_ways(road_map, own, reach_m))
        away = [polylines.project(way, points).distance_m.mean() for way in ways]
        way = ways[int(np.argmin(away))]
        foot = polylines.project(way, points[0])
        middle, heading = polylines.points_at(way, foot.along_m + gone_m)
        position[steps] = middle + foot.left_m * frames.unit(heading + np.pi / 2)
        known[steps] = True
    return Counterfactual(by="lane", position_m=position, known=known)


def _own_lane(road_map: RoadMap, point_m: Floats, heading_rad: float, z_m: float) -> Lane | None:
    """The nearest lane of the direction that a pose is on; None if there is none."""
    lanes = road.lanes_for_cars(road_map)
    under = road.covering(road_map, point_m[None])
    aligned = np.abs(frames.difference(under.heading_rad, heading_rad)) < _ALIGNED_RAD
    found = [lanes.lanes[at] for at in np.unique(under.lane[aligned])]
    feet = [polylines.project(lane.centre_m, point_m) for lane in found]
    if found and ground_of(road_map).has_levels:
        heights = [
            float(np.interp(foot.along_m, polylines.arc_lengths(lane.centre_m), lane.z_m))
            for lane, foot in zip(found, feet, strict=True)
        ]
        one = np.zeros(len(found), np.int64)
        level = np.flatnonzero(on_nearest_level(one, np.array(heights), np.array(z_m)))
        found, feet = [found[at] for at in level], [feet[at] for at in level]
    return found[int(np.argmin([foot.distance_m for foot in feet]))] if found else None


def _ways(road_map: RoadMap, own: Lane, reach_m: float) -> Iterator[Floats]:
    """Centre lines (P, 2) from the start of a lane along the lanes that follow it, up to a reach.

    A lane to which several lead is on the first of these ways alone.
    """
    lanes = road.lanes_for_cars(road_map)
    seen, begun = {own.id}, [(own, own.centre_m, 0.0)]
    while begun:
        lane, way, before_m = begun.pop(0)
        after = [name for name in lane.next if name in lanes.row and name not in seen]
        if not after or before_m > reach_m:
            yield way
            continue
        seen.update(after)
        length_m = before_m + float(polylines.arc_lengths(lane.centre_m)[-1])
        for name in after:
            one = lanes.lanes[lanes.row[name]]
            begun.append((one, np.concatenate([way, one.centre_m]), length_m))
