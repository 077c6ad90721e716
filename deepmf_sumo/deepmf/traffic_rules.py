"""Futures of an opponent that break no traffic rule, as far as the road map contains the rules.

A future is lawful if

- it stays on lanes that can be reached from the lane where it begins, in their direction;
- it drives at most 110 % of their speed limit, or at most its present speed;
- it does not cross (by more than 2 m) a stop line at red, or a stop sign without standing before
  it, if braking at 5 m/s2 was enough to stop in time; the same at yellow with 3 m/s2;
- it enters the path of the AV only if the unattacked AV arrives at least 1.5 s later: on a link
  over a junction that gives way to the AV's, or when it leaves its lane; while it is out of its
  lane it does not touch the AV in any reaction;
- behind the AV it neither touches the AV nor speeds up within 1 s of it; ahead of the AV, unless a
  line makes it stop or a turn makes it slow down, it brakes by at most 2 m/s2, and to no less than
  half of its speed.

None of this applies where the AV enters the opponent's path: that is a lawful attack.

A pedestrian does not step into the AV's way, nor does a cyclist who is on no lane for cars ride
into it, where the AV could no longer stop before it: see `steps_out`. Nothing else is asked of
them: the map has neither lights for pedestrians nor sidewalks. A cyclist on a lane for cars drives
by the rules of vehicles.

Lights are assumed not to change until the next plan. Rules that the map does not contain are not
applied: recordings have no right of way at junctions, and a vehicle that starts off the lanes may
drive anywhere. Only the AV is considered, not other vehicles.
"""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.deepmf.candidates import Candidates, References
from deepmf_sumo.deepmf.lane_assignment import (
    EVERY_STEPS,
    OFF,
    PACE_S,
    LaneAssignment,
    LaneFutures,
    lanes_at,
    on_lane,
)
from deepmf_sumo.deepmf.reference_paths import OwnPath
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.scene import (
    DT_S,
    FUTURE_STEPS,
    AgentId,
    Bools,
    Floats,
    Lane,
    View,
)
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.scene.geometry.lane_map import width_m
from deepmf_sumo.scene.signals import FORBIDS, HALTS, STOP_FIRST

OVER_M: Final = 2.0
"""A front farther than this past a line has crossed it, and did not merely stop late."""
YELLOW_MPS2: Final = 3.0
RED_MPS2: Final = 5.0
"""Somewhat more than the braking of SUMO's drivers before a light that has long been red."""
_STOP_ZONE_M = 6.0
_STOP_MPS = 0.7
"""Slower before a stop sign counts as a stop: drivers roll."""
_STOPS_MPS2 = (1.0, 2.0, 3.0)


class HaltLine(NamedTuple):
    """Where a lane's traffic stops.

    Attributes:
        lane: that it bounds. point_m: (2) on the lane. heading_rad: of the lane there.
        light: at the start of the lane; else a sign on it.
        sign: a vehicle that stood here goes on: a stop sign, or a light that flashes red.
        brake_mps2: a vehicle that can stop with at most this braking must stop.
    """

    lane: Lane
    point_m: Floats
    heading_rad: float
    light: bool
    sign: bool
    brake_mps2: float

    def crossed(self, driven: LaneFutures) -> Bools:
        """(N) futures whose front crosses the line without having stood before its sign."""
        front = driven.position_m + frames.unit(driven.heading_rad) * driven.size_m[0] / 2
        local = frames.to_local(front, self.point_m, self.heading_rad)
        ahead, left = local[..., 0], local[..., 1]
        over = (ahead > OVER_M) & (np.abs(left) <= width_m(self.lane))
        crossed: Bools = np.asarray(over.any(axis=1))
        if self.light:
            lanes = [lane.id for lane in driven.assignment.lanes]
            crossed &= driven.assignment.driven[:, lanes.index(self.lane.id)]
        if not self.sign:
            return crossed
        waiting = (ahead <= OVER_M) & (ahead > -_STOP_ZONE_M)
        stands = np.asarray((waiting & (driven.speed_mps < _STOP_MPS)).any(axis=1))
        return crossed & ~stands

    def stood(self, driven: LaneFutures, slowest_mps: float) -> bool:
        """Whether a vehicle of this lowest recent speed stood at the sign; False at lights."""
        return self.sign and self.before_m(driven) < _STOP_ZONE_M and slowest_mps < _STOP_MPS

    def before_m(self, driven: LaneFutures) -> float:
        """Distance of the front to the line now; negative past it."""
        start = driven.start
        front = start.position_m + frames.unit(start.heading_rad) * driven.size_m[0] / 2
        ahead, left = frames.to_local(front, self.point_m, self.heading_rad)
        return -float(ahead) if ahead > 0 else float(np.hypot(ahead, left))


def stop_lines(view: View, assignment: LaneAssignment) -> list[HaltLine]:
    """Lines on the lanes ahead at which vehicles must stop now: at lights and stop signs.

    The line of a light is the start of the lane behind it.
    """
    lines = []
    known = {lane.id: lane for lane in assignment.lanes if len(lane.centre_m) > 1}
    for lane in known.values():
        state = view.signals.get(lane.id)
        if state in HALTS or state in STOP_FIRST:
            dx, dy = lane.centre_m[1] - lane.centre_m[0]
            brake = YELLOW_MPS2 if state in HALTS - FORBIDS else RED_MPS2
            heading, then_goes = float(np.arctan2(dy, dx)), state in STOP_FIRST
            lines.append(HaltLine(lane, lane.centre_m[0], heading, True, then_goes, brake))
    for sign in view.road.stop_signs:
        for lane in (known[name] for name in sign.lane_ids if name in known):
            foot = polylines.project(lane.centre_m, sign.position_m)
            point, _ = polylines.points_at(lane.centre_m, foot.along_m)
            lines.append(HaltLine(lane, point, float(foot.heading_rad), False, True, RED_MPS2))
    return lines


def stops(situation: Situation, paths: list[OwnPath]) -> References:
    """References that stop along each of the opponent's own paths, gently to firmly."""
    start, limits = situation.start, situation.limits
    seconds = (np.arange(FUTURE_STEPS) + 1) * DT_S
    brakes = [one for one in _STOPS_MPS2 if one < limits.brake] + [limits.brake]
    found = []
    for path in paths:
        for brake in brakes:
            busy = np.minimum(seconds, start.speed_mps / brake)
            driven = start.speed_mps * busy - brake * busy**2 / 2
            found.append(polylines.points_at(path.points_m, driven)[0])
    return References.of("stop", np.stack(found), limits.rows(len(found)))


GIVE_WAY_S: Final = 1.5
FOLLOW_S: Final = 1.0
CAUSELESS_MPS2: Final = 2.0
_FASTER = 1.1  # times the speed limit
_OUTSIDE_M = 0.3  # a box that reaches this far out of its lane leaves it
_CUT_IN_S = 2.0  # for this time after it left its lane it must leave the AV room
_SAME_WAY = 0.7  # cosine: within 45 degrees
_SLOWING_S = 0.4


def off_lanes(driven: LaneFutures) -> Bools:
    """At some time on none of the lanes that lead on from its own."""
    return np.asarray((driven.assignment.nearest == OFF).any(axis=1))


def speeds(driven: LaneFutures) -> Bools:
    """Faster than the lane allows, and than its present speed."""
    limits = np.array([lane.speed_limit_mps or np.inf for lane in driven.assignment.lanes])
    allowed = np.maximum(_FASTER * limits[driven.assignment.nearest], driven.start.speed_mps)
    return np.asarray((driven.speed_mps > allowed + 0.1).any(axis=1))


def takes_priority(view: View, driven: LaneFutures) -> Bools:
    """On a link that gives way to the AV's, shortly before the AV; not if the AV's light is red."""
    takes = np.zeros(len(driven.position_m), bool)
    for row, lane in enumerate(driven.assignment.lanes):
        first = [view.road.lanes[name] for name in lane.gives_way_to if name in view.road.lanes]
        first = [one for one in first if view.signals.get(one.id) not in FORBIDS]
        first = [one for one in first if lane.id not in one.gives_way_to]  # as at all-way stops
        if not first or driven.assignment.begins[row]:
            continue
        av_poses = driven.av_position_m, driven.av_heading_rad
        used = [on_lane(view.road, one, *av_poses)[0] for one in first]
        goes_first = np.any(used, axis=(0, 2))  # (K)
        if goes_first.any():
            there = driven.assignment.on[:, :, row, None] & driven.av_comes(GIVE_WAY_S)
            takes |= driven.assignment.driven[:, row] & (there & goes_first).any(axis=(1, 2))
    return takes


def through(view: View, driven: LaneFutures) -> Bools:
    """(L) lanes inside a junction that can be left without giving way.

    No lanes if the map contains no right of way: any vehicle may then have priority.
    """
    lanes = view.road.lanes
    known = any(one.gives_way_to for one in lanes.values())
    free: list[bool] = []
    for lane in driven.assignment.lanes:
        after = [lanes[name] for name in lane.next if name in lanes]
        waits = any(one.interpolating and one.gives_way_to for one in after)
        free.append(known and lane.interpolating and not waits)
    return np.array(free, bool)


def blocks(driven: LaneFutures, free: Bools, so_far_mps: float) -> Bools:
    """Slows down to less than half of its speed inside a junction that it could have left.

    ``free``: see `through`; ``so_far_mps``: its highest speed inside until now.
    """
    inside = np.append(free, False)[driven.assignment.nearest]  # `OFF` is the last
    fastest = np.maximum.accumulate(np.where(inside, driven.speed_mps, 0.0), axis=1)
    slowest = np.maximum(fastest, so_far_mps) / 2 - 0.1
    return np.asarray((inside & (driven.speed_mps < slowest)).any(axis=1))


def cuts_in(driven: LaneFutures, collision_step: Floats) -> Bools:
    """Leaves its lane shortly before the AV, or is out of its lane when it touches the AV."""
    lanes = driven.assignment
    rows = np.flatnonzero(lanes.straight)
    slack = [(width_m(lanes.lanes[row]) - driven.size_m[1]) / 2 + _OUTSIDE_M for row in rows]
    inside = lanes.on[..., rows] & (np.abs(lanes.left_m[..., rows]) <= np.maximum(slack, 0.5))
    outside = ~np.asarray(inside.any(axis=-1))
    leaving = outside & (np.cumsum(outside, axis=1) * PACE_S <= _CUT_IN_S)
    cuts = leaving[..., None] & driven.av_comes(GIVE_WAY_S)
    time = collision_step.astype(int) // EVERY_STEPS  # (N, M), past the last without collision
    there = np.minimum(time, outside.shape[1] - 1)
    touches = np.take_along_axis(outside, there, axis=1) & (time <= there)
    return np.asarray(cuts.any(axis=(1, 2)) | touches.any(axis=1))


def violates_priority(view: View, driven: LaneFutures, collides: Bools, halts: bool) -> Bools:
    """Comes too close to the AV ahead in its lane, or brakes ahead of the AV without a cause.

    ``collides`` (N): the future touches the AV in one of the reactions; ``halts``: a line makes the
    opponent stop.
    """
    if _follows(view, driven):
        near = np.any([driven.meets(-back) for back in (PACE_S, FOLLOW_S / 2, FOLLOW_S)], axis=0)
        faster = (driven.speed_mps > driven.start.speed_mps + 0.1).any(axis=1)
        return collides | (near.any(axis=(1, 2)) & faster)
    if halts or not _leads(driven):
        return np.zeros(len(collides), bool)
    now = np.full((len(collides), 1), driven.start.speed_mps)
    speed = np.concatenate([now, driven.speed_mps], axis=1)
    span = round(_SLOWING_S / PACE_S)
    slowing = (speed[:, :-span] - speed[:, span:]).max(axis=1, initial=0.0) / _SLOWING_S
    turns = np.cos(driven.heading_rad - driven.start.heading_rad).min(axis=1) < _SAME_WAY
    crawls = driven.speed_mps.min(axis=1) < driven.start.speed_mps / 2
    return (slowing > CAUSELESS_MPS2 + 0.2) | (crawls & ~turns)


def _follows(view: View, driven: LaneFutures) -> bool:
    """Whether the AV is ahead, in the opponent's lane or one that it leads to."""
    row = view.history.row(view.av_id)
    position = view.history.position_m[row, -1]
    heading, z_m = view.history.heading_rad[row, -1], view.history.z_m[row, -1]
    under = lanes_at(view.road, position, float(heading), float(z_m))
    ahead = zip(driven.assignment.lanes, driven.assignment.straight, strict=True)
    shared = {lane.id for lane, straight in ahead if straight} & {*under}
    start = driven.start
    return bool(shared) and frames.to_local(position, start.position_m, start.heading_rad)[0] > 0


def _leads(driven: LaneFutures) -> bool:
    """Whether the AV follows: it will be at the opponent's present position."""
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


REACTS_S: Final = 1.0
_UNSTOPPED_SHARE = 0.1  # of the AV's futures; some of them may be too fast in any case
_BESIDE_M = 0.3


def steps_out(situation: Situation, own: Candidates) -> Bools:
    """(N) candidates that come into the AV's way where it could not stop before them any more.

    Convention on Road Traffic (Vienna, 1968), article 20, 6 b and c: pedestrians step onto the road
    only if the distance and the speed of vehicles allow it, on a crossing, too. The AV can stop if
    the distance along its way, from its front to the candidate's box, is at least v t + v^2 / (2 b)
    with `REACTS_S` and `RED_MPS2`, at the step at which the candidate first comes within 0.3 m of
    the way. Who is in the way now has not stepped out; behind the AV nobody does. All but 10 % of
    the AV's futures without an attack count.
    """
    av = situation.unattacked
    assert av is not None
    here = np.concatenate([np.tile(situation.start.position_m, (len(own.speed_mps), 1, 1)),
                           own.forecast.futures.position_m], axis=1)[:, ::EVERY_STEPS]  # fmt: skip
    row = situation.view.history.row(situation.view.av_id)
    now_m = situation.view.history.position_m[row, -1]
    unstopped = np.zeros(len(here))
    for future, chance in zip(av.futures.position_m, av.probability, strict=True):
        way = np.concatenate([now_m[None], future])
        unstopped += chance * _unstopped(situation, here, way)
    return np.asarray(unstopped > _UNSTOPPED_SHARE)


def _unstopped(situation: Situation, here_m: Floats, way_m: Floats) -> Bools:
    """(N) of `steps_out`, for positions (N, S, 2) from now on and one way (F + 1, 2) of the AV."""
    (length, width), (av_length, av_width) = situation.size_m, situation.av_size_m
    beside_m = (av_width + max(length, width)) / 2 + _BESIDE_M
    if polylines.arc_lengths(way_m)[-1] < 1e-6:
        return np.zeros(len(here_m), bool)
    foot = polylines.project(way_m, here_m)
    driven = polylines.arc_lengths(way_m)
    speed = np.gradient(driven, DT_S)
    steps = np.minimum(np.arange(here_m.shape[1]) * EVERY_STEPS, len(way_m) - 1)
    apart = foot.along_m - driven[steps] - (av_length + max(length, width)) / 2
    in_way = (foot.distance_m <= beside_m) & (apart > -av_length)
    first = in_way.argmax(axis=1)
    needed = speed[steps] * REACTS_S + speed[steps] ** 2 / (2 * RED_MPS2)
    rows = np.arange(len(here_m))
    return np.asarray(in_way.any(axis=1) & (first > 0) & (apart[rows, first] < needed[first]))


@dataclass(slots=True)
class TrafficRules:
    """The traffic rules for one attack, with a memory of the opponent's behaviour in earlier plans.

    - Lines at which the opponent was still able to stop: it must stop there until the light turns
      green, or it could approach a red light until it is too late to stop.
    - Signs at which the opponent has stood: it may drive on, even if a plan is made before it has
      crossed the line.
    - The speed at which the opponent entered a junction: else each plan could halve its speed.
    """

    _owed: set[tuple[AgentId, str]] = field(default_factory=set)
    _stood: set[tuple[AgentId, str]] = field(default_factory=set)
    _inside_mps: dict[AgentId, float] = field(default_factory=dict)

    def lawful(self, situation: Situation, own: Candidates, collision_step: Floats) -> Bools:
        """(N) candidates that break no rule; the situation needs the unattacked AV.

        ``collision_step`` (N, M): first contact of each candidate and reaction; F without contact.
        """
        view, agent_id = situation.view, situation.opponent_id
        if situation.on_foot:
            return ~steps_out(situation, own)
        driven = LaneFutures.of(situation, own)
        if not driven.assignment.begins.any():
            lawful = np.ones(len(own.speed_mps), bool)
            return ~steps_out(situation, own) if situation.person else lawful
        self._forget(view)
        touches = (collision_step < own.speed_mps.shape[1]).any(axis=1)
        halts, over_line = self._lines(view, agent_id, driven)
        return ~(
            over_line
            | off_lanes(driven)
            | speeds(driven)
            | takes_priority(view, driven)
            | cuts_in(driven, collision_step)
            | self._blocks(view, agent_id, driven)
            | violates_priority(view, driven, touches, halts)
        )

    def _lines(self, view: View, agent_id: AgentId, driven: LaneFutures) -> tuple[bool, Bools]:
        """Whether a line makes the opponent stop, and (N) futures that cross such a line."""
        over, halts = np.zeros(len(driven.position_m), bool), False
        row = view.history.row(agent_id)
        slowest_mps = float(view.history.speed_mps[row, view.history.valid[row]].min())
        lines = [
            line for line in stop_lines(view, driven.assignment) if line.before_m(driven) >= -OVER_M
        ]
        self._stood &= {(agent_id, line.lane.id) for line in lines}
        for line in lines:
            key, before_m = (agent_id, line.lane.id), line.before_m(driven)
            if line.stood(driven, slowest_mps):
                self._stood.add(key)
            if max(before_m, 0.0) >= driven.start.speed_mps**2 / (2 * line.brake_mps2):
                self._owed.add(key)
            if key in self._owed:
                halts = True
                if key not in self._stood:
                    over |= line.crossed(driven)
        return halts, over

    def _blocks(self, view: View, agent_id: AgentId, driven: LaneFutures) -> Bools:
        """(N) futures that slow down inside a junction without a cause."""
        free = through(view, driven)
        fastest = 0.0
        if (free & driven.assignment.begins).any():
            row = view.history.row(agent_id)
            now = float(view.history.speed_mps[row, view.history.valid[row]].max())
            fastest = max(self._inside_mps.get(agent_id, 0.0), now)
        self._inside_mps[agent_id] = fastest
        return blocks(driven, free, fastest)

    def _forget(self, view: View) -> None:
        """Drop lines whose light no longer requires a stop; signs stay."""
        self._owed = {
            (agent_id, lane)
            for agent_id, lane in self._owed
            if lane not in view.signals or view.signals[lane] in HALTS | STOP_FIRST
        }
