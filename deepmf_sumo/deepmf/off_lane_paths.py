"""Reference paths of people to predicted positions of the AV: without lanes, on walkable ground.

A pedestrian or a cyclist gets to a goal by going on straight, a turn of the least radius that its
speed allows (pedestrians at rest turn freely), and straight on from there; past the goal it goes on
straight. What differs is when and how fast:

- ``goal``: now, at the constant speed that arrives in time; the turn begins immediately, or
  where the person is abreast of the goal, or half way to there.
- ``wait``: it stops, or stands, and sets off later, at a usual speed: a person that waits at
  the kerb steps out when it matters.
- ``halt``: it gets there before the AV, and stays.
- ``return``: a pedestrian crosses the AV's way, turns back, and meets it then.

Usual speeds are those of the class (`scene.road_users`). Goals that need more than the limits are
dropped.

Candidates of people stay where people can be (`scene.geometry.walkable`). A reference that leads
off this ground stops at its end; a motion that leaves it anyway is not a candidate. No setting
changes this. A person that is elsewhere now, because a recording, SUMO or a spec put it there, may
be there until it comes onto this ground; it does not enter a building or water that it is not in.
"""

from dataclasses import dataclass, fields, replace
from typing import Final, NamedTuple, Self

import numpy as np

from deepmf_sumo.deepmf.candidates import Candidates, References
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Bools, Floats, Forecast, Ints
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.walkable import walkable
from deepmf_sumo.scene.road_users import MotionLimits

_FIRST_STEP, _EVERY_STEPS = 3, 4  # goals at 0.4, 0.8, 1.2 ... s
_LENGTH_SHARE, _WIDTH_SHARE = 0.35, 0.4
_SHARE: Final = 0.85
"""Of the limits is planned with; the rest corrects tracking errors."""
_SLOWEST_MPS: Final = 0.4
_ABREAST_M: Final = 1.5
"""A person abreast of the goal within this distance turns at once."""
_EARLY_S: Final = 1.0
"""Who halts is there this long before the AV."""
_BEYOND_M: Final = 1.5
"""Who turns back has gone this far past the goal."""
_ROUNDS: Final = 3
"""The radius of a turn follows from the speed that arrives in time, and this from its length."""
_BARELY_RAD: Final = 0.1
"""A turn that needs no lower speed."""
_AWAY_M: Final = 0.5
"""Goals nearer than this are reached."""
_BEFORE_M: Final = 0.3
"""References end so far before the ground does, because tracking cuts corners."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ways:
    """G ways in the person's frame (x ahead, y left): straight, a turn, straight on; arrays (G).

    Attributes:
        ahead_m: length of the first straight. radius_m: of the turn. turn_rad: of the turn, >= 0.
        side: 1 to the left, -1 to the right. length_m: to the goal; inf where no turn gets there.
    """

    ahead_m: Floats
    radius_m: Floats
    turn_rad: Floats
    side: Floats
    length_m: Floats

    @classmethod
    def to(cls, goal_m: Floats, ahead_m: Floats, radius_m: Floats) -> Self:
        """Ways to goals (G, 2) of the person's frame."""
        x, side = goal_m[:, 0] - ahead_m, np.where(goal_m[:, 1] < 0, -1.0, 1.0)
        y = side * goal_m[:, 1] - radius_m
        away = np.hypot(x, y)
        straight = np.sqrt(np.maximum(away**2 - radius_m**2, 0.0))
        # From the circle's centre to the goal: the radius to the tangent's foot, and the tangent.
        turn = np.mod(np.arctan2(y, x) + np.arctan2(radius_m, straight), 2 * np.pi)
        turn = np.where(turn > 2 * np.pi - 1e-6, 0.0, turn)
        length = ahead_m + radius_m * turn + straight
        reached = away >= radius_m - 1e-9
        return cls(
            ahead_m=ahead_m,
            radius_m=radius_m,
            turn_rad=turn,
            side=side,
            length_m=np.where(reached, length, np.inf),
        )

    def at(self, along_m: Floats) -> Floats:
        """(G, F, 2) points of the person's frame at arc lengths (G, F)."""
        ahead, radius, turn = self.ahead_m[:, None], self.radius_m[:, None], self.turn_rad[:, None]
        on_it = np.clip((along_m - ahead) / np.maximum(radius, 1e-9), 0.0, turn)
        rest = np.maximum(along_m - ahead - radius * turn, 0.0)
        x = np.minimum(along_m, ahead) + radius * np.sin(on_it) + rest * np.cos(turn)
        y = radius * (1 - np.cos(on_it)) + rest * np.sin(turn)
        return np.stack([x, self.side[:, None] * y], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class _OffLaneGoals:
    """G goals with their ways and times; arrays (G).

    Attributes:
        way: see `_Ways`. departs_s: when it sets off; 0: it does not stop before.
        hold_mps: speed that it then reaches and holds.
        halts_m: distance at which it stops for good, or turns back; inf: it goes on.
        returns: whether it turns back there.
        kind: number in `_ORIGINS`. step: at which the AV is there. score: the higher, the better.
    """

    way: _Ways
    departs_s: Floats
    hold_mps: Floats
    halts_m: Floats
    returns: Bools
    kind: Ints
    step: Ints
    score: Floats

    def take(self, rows: Ints) -> Self:
        """Only these goals."""
        way = _Ways(**{one.name: getattr(self.way, one.name)[rows] for one in fields(_Ways)})
        rest = {one.name: getattr(self, one.name)[rows] for one in fields(self)[1:]}
        return replace(self, way=way, **rest)


_ORIGINS: Final = ("goal", "wait", "halt", "return")


class _Aim(NamedTuple):
    """Places of the AV in the person's frame: (G, 2), the steps (G), scores (G)."""

    goal_m: Floats
    step: Ints
    score: Floats


def off_lane_paths(situation: Situation, count: int) -> References:
    """At most ``count`` references of a person to the unattacked AV, of each kind the best."""
    start, av = situation.start, situation.unattacked
    when = np.arange(_FIRST_STEP, min(situation.horizon, FUTURE_STEPS), _EVERY_STEPS)
    if av is None or count == 0 or len(when) == 0:
        return References.none(FUTURE_STEPS)
    limits = _planned(situation.limits)
    aim = _aims(start, av, when, situation.av_size_m)
    parts = [*_at_once(aim, start, limits), *_later(aim, start, limits, on_foot=situation.on_foot)]
    goals = _chosen([_best(part, count) for part in parts], count)
    if not len(goals.kind):
        return References.none(FUTURE_STEPS)
    local = goals.way.at(_covered(goals, start, limits))
    position_m = frames.to_scene(local, start.position_m, start.course_rad)
    return References(
        position_m=position_m,
        limits=situation.limits.rows(len(position_m)),
        origin=tuple(_ORIGINS[kind] for kind in goals.kind),
    )


def _planned(limits: MotionLimits) -> MotionLimits:
    return limits.times(_SHARE)


def _aims(start: Start, av: Forecast, when: Ints, av_size_m: Floats) -> _Aim:
    """Points on the AV at its predicted poses: its middle, front, rear, and both sides."""
    position, heading = av.futures.position_m[:, when], av.futures.heading_rad[:, when]
    length, width = _LENGTH_SHARE * av_size_m[0], _WIDTH_SHARE * av_size_m[1]
    spots = np.array([[0, 0], [length, 0], [-length, 0], [0, width], [0, -width]], dtype=float)
    forward = frames.unit(heading)
    left = frames.unit(heading + np.pi / 2)
    point = position + spots[:, None, None, :1] * forward + spots[:, None, None, 1:] * left
    chance = np.log(np.maximum(av.probability, 1e-6)) / 2
    # As of goals on lanes: points off the middle cost as much as a mode e^10 less likely.
    score = chance[:, None] - 5.0 * (np.arange(len(spots)) > 0)[:, None, None]
    every = np.ones((len(spots), len(position), len(when)))
    return _Aim(
        goal_m=frames.to_local(point.reshape(-1, 2), start.position_m, start.course_rad),
        step=(every * when).astype(np.int64).ravel(),
        score=(every * score).ravel(),
    )


def _radius_m(start: Start, speed_mps: Floats, limits: MotionLimits) -> Floats:
    """(G) radius of a turn at speeds (G); 0 for a pedestrian who stands now."""
    if start.motion.body == "point":
        return np.asarray(speed_mps**2 / limits.lateral * (start.speed_mps > 0))
    narrowest = start.rear_m / np.sin(start.motion.slip_rad)
    return np.asarray(np.maximum(speed_mps**2, _SLOWEST_MPS) / limits.lateral + narrowest)


def _at_once(aim: _Aim, start: Start, limits: MotionLimits) -> list[_OffLaneGoals]:
    """Goals that a constant speed reaches in time, if it turns now, abreast of it, or between."""
    abreast = np.maximum(aim.goal_m[:, 0], 0.0)
    moves = start.speed_mps > _SLOWEST_MPS
    found = []
    for share in (0.0, 0.5, 1.0) if moves else (0.0,):
        ahead = share * abreast
        if share == 1.0:  # the turn ends abreast of the goal
            ahead = np.maximum(ahead - _radius_m(start, np.full(1, start.speed_mps), limits), 0.0)
        useful = (share == 0.0) | (abreast > _ABREAST_M)
        found.append(_timed(aim, ahead, useful, start, limits))
    return found


def _timed(
    aim: _Aim, ahead_m: Floats, useful: Bools, start: Start, limits: MotionLimits
) -> _OffLaneGoals:
    """Goals at once with the speed that arrives in time."""
    seconds = np.asarray((aim.step + 1) * DT_S, float)
    radius = _radius_m(start, np.full(len(seconds), start.speed_mps), limits)
    for _ in range(_ROUNDS):
        way = _Ways.to(aim.goal_m, ahead_m, radius)
        hold = _held(way.length_m, seconds, start.speed_mps, limits)
        radius = _radius_m(start, np.fmax(start.speed_mps, hold), limits)
    turns = (way.turn_rad > _BARELY_RAD) & (way.radius_m > 0)
    fastest = np.where(turns, np.sqrt(limits.lateral / _SHARE * way.radius_m), np.inf)
    fastest = np.minimum(fastest, start.motion.fastest_mps)
    fastest = np.maximum(fastest, start.speed_mps)
    possible = useful & (hold >= _SLOWEST_MPS) & (hold <= fastest) & (way.length_m > _AWAY_M)
    effort = np.abs(hold - _usual(start)) + way.turn_rad / 2
    return _goals(way, aim, effort, hold_mps=hold).take(np.flatnonzero(possible))


def _usual(start: Start) -> float:
    """The speed at which the person goes on, or would go."""
    return max(start.speed_mps, start.motion.usual_mps[0])


def _held(length_m: Floats, seconds: Floats, now_mps: float, limits: MotionLimits) -> Floats:
    """(G) speeds to change to that cover lengths in the seconds; nan where none does.

    With the change w of the speed at the rate a: length = now t + w t - w^2 / (2 a), a quadratic.
    """
    lack = np.where(np.isfinite(length_m), length_m, 1e6) - now_mps * seconds
    rate = np.where(lack >= 0, limits.accel, limits.brake)
    with np.errstate(invalid="ignore"):
        change = rate * (seconds - np.sqrt(seconds**2 - 2 * np.abs(lack) / rate))
    return np.asarray(now_mps + np.sign(lack) * change)


def _goals(
    way: _Ways,
    aim: _Aim,
    effort: Floats,
    *,
    hold_mps: Floats | float,
    kind: int = 0,
    departs_s: Floats | float = 0.0,
    halts_m: Floats | float = np.inf,
) -> _OffLaneGoals:
    each = np.ones(len(aim.step))
    return _OffLaneGoals(
        way=way,
        departs_s=each * departs_s,
        hold_mps=each * hold_mps,
        halts_m=each * halts_m,
        returns=np.full(len(each), kind == _ORIGINS.index("return")),
        kind=np.full(len(each), kind),
        step=aim.step,
        score=aim.score - effort,
    )


def _later(aim: _Aim, start: Start, limits: MotionLimits, *, on_foot: bool) -> list[_OffLaneGoals]:
    """Goals for which the person stops or stands first: `wait`, `halt`, `return`."""
    seconds = np.asarray((aim.step + 1) * DT_S, float)
    stop_s, stop_m = start.speed_mps / limits.brake, start.speed_mps**2 / (2 * limits.brake)
    speeds = start.motion.usual_mps
    slow = np.zeros(len(seconds)) if on_foot else np.full(len(seconds), speeds[0])
    way = _Ways.to(aim.goal_m, np.full(len(seconds), stop_m), _radius_m(start, slow, limits))
    left = way.length_m - stop_m
    found = []
    for hold in speeds:
        up_s, up_m = hold / limits.accel, hold**2 / (2 * limits.accel)
        down_s, down_m = hold / limits.brake, hold**2 / (2 * limits.brake)
        there_s = np.where(
            left >= up_m, up_s + (left - up_m) / hold, np.sqrt(2 * left / limits.accel)
        )
        halted_s = up_s + (left - up_m - down_m) / hold + down_s
        beyond_s = halted_s + _BEYOND_M / hold
        back_s = np.where(
            up_m <= _BEYOND_M,
            up_s + (_BEYOND_M - up_m) / hold,
            np.sqrt(2 * _BEYOND_M / limits.accel),
        )
        times = [there_s, halted_s + _EARLY_S, beyond_s + back_s]
        for number, lasts_s in enumerate(times[: 3 if on_foot else 2]):
            departs = seconds - lasts_s
            room = np.isfinite(way.length_m) & (left > _AWAY_M)
            room &= (number == 0) | (left > up_m + down_m)
            ends = (np.inf, way.length_m, way.length_m + _BEYOND_M)[number]
            effort = (hold - speeds[0]) + 0.2 * departs + stop_s / 2 + number + way.turn_rad / 4
            goals = _goals(
                way, aim, effort, hold_mps=hold, kind=number + 1, departs_s=departs, halts_m=ends
            )
            found.append(goals.take(np.flatnonzero(room & (departs >= stop_s))))
    return found


def _best(goals: _OffLaneGoals, count: int) -> _OffLaneGoals:
    """The best ``count``; of goals that end within half a metre at the same time only the best."""
    order = np.argsort(-goals.score, kind="stable")
    way = goals.way
    cells = np.stack(
        [goals.step, np.rint(2 * way.length_m), np.rint(8 * way.side * way.turn_rad),
         np.rint(way.ahead_m), np.rint(2 * goals.departs_s)], -1,
    )  # fmt: skip
    _, first = np.unique(cells[order], axis=0, return_index=True)
    return goals.take(order[np.sort(first)[:count]])


def _chosen(parts: list[_OffLaneGoals], count: int) -> _OffLaneGoals:
    """At most ``count`` of all parts: the first of each, then the second of each, and so on."""
    turn = np.concatenate([np.arange(len(part.kind)) for part in parts])
    part = np.concatenate([np.full(len(one.kind), at) for at, one in enumerate(parts)])
    order = np.lexsort((part, turn))[:count]
    ways = [one.way for one in parts]
    joined = {
        one.name: np.concatenate([getattr(part, one.name) for part in parts])
        for one in fields(_OffLaneGoals)[1:]
    }
    way = _Ways(
        **{one.name: np.concatenate([getattr(w, one.name) for w in ways]) for one in fields(_Ways)}
    )
    return _OffLaneGoals(way=way, **joined).take(order)


def _covered(goals: _OffLaneGoals, start: Start, limits: MotionLimits) -> Floats:
    """(K, F) arc lengths at the steps from the next one on."""
    seconds = (np.arange(FUTURE_STEPS) + 1) * DT_S
    waits = goals.departs_s[:, None] > 0
    stopping = np.minimum(seconds, start.speed_mps / limits.brake)
    stopped = start.speed_mps * stopping - limits.brake * stopping**2 / 2
    now = np.where(waits, 0.0, start.speed_mps)
    before = np.where(waits, stopped, 0.0)
    since = np.maximum(seconds - goals.departs_s[:, None], 0.0)
    hold = goals.hold_mps[:, None]
    along = before + _gone(since, now, hold, limits)
    # Braking begins where it ends at `halts_m`.
    halts, brake_m = goals.halts_m[:, None], hold**2 / (2 * limits.brake)
    up_m = hold**2 / (2 * limits.accel)
    begun = np.where(waits, start.speed_mps**2 / (2 * limits.brake), 0.0)
    brakes_s = hold / limits.accel + (halts - begun - brake_m - up_m) / hold
    braking = np.clip(since - brakes_s, 0.0, hold / limits.brake)
    slower = halts - brake_m + hold * braking - limits.brake * braking**2 / 2
    along = np.where(since > brakes_s, slower, along)
    back = np.maximum(since - brakes_s - hold / limits.brake, 0.0)
    returned = halts - _gone(back, np.zeros_like(hold), hold, limits)
    turned = goals.returns[:, None] & (back > 0)
    return np.asarray(np.where(turned, returned, along))


def _gone(seconds: Floats, now_mps: Floats, hold_mps: Floats, limits: MotionLimits) -> Floats:
    """Metres after seconds of a change from one speed to another, which is then held."""
    rate = np.where(hold_mps >= now_mps, limits.accel, -limits.brake)
    changing = np.minimum(seconds, (hold_mps - now_mps) / rate)
    return np.asarray(now_mps * changing + rate * changing**2 / 2 + hold_mps * (seconds - changing))


def staying_on_ground(situation: Situation, references: References) -> References:
    """The references; those that leave the ground brake, and stop at its end."""
    position_m = references.position_m
    off = off_ground(situation, position_m)
    rows = np.flatnonzero(off.any(axis=1))
    if not len(rows):
        return references
    position_m = position_m.copy()
    for row in rows.tolist():
        position_m[row] = _stopping(situation, position_m[row], int(off[row].argmax()))
    return replace(references, position_m=position_m)


def on_ground(situation: Situation, own: Candidates) -> Candidates:
    """The candidates that stay on the ground; if none does, those that leave it last."""
    off = off_ground(situation, own.forecast.futures.position_m)[:, : situation.horizon]
    first = np.where(off.any(axis=1), off.argmax(axis=1), situation.horizon)
    rows = np.flatnonzero(first == first.max())
    return own if len(rows) == len(own.origin) else own.take(rows)


def off_ground(situation: Situation, position_m: Floats) -> Bools:
    """(K, F) whether positions (K, F, 2) of a person are where it cannot be."""
    road, levels = walkable(situation.view.road), situation.levels
    now_z_m = None if levels is None else levels.opponent[2:]
    z_m = None if levels is None else levels.opponent_z_m(position_m).reshape(-1)
    shape = position_m.shape[:2]
    points, here = position_m.reshape(-1, 2), situation.start.position_m[None]
    on_it = road.holds(points, z_m).reshape(shape)
    if road.holds(here, now_z_m)[0]:
        return ~on_it
    come = np.maximum.accumulate(on_it, axis=1)
    barred = road.barred(points).reshape(shape)
    if road.barred(here)[0]:
        barred &= np.maximum.accumulate(~barred, axis=1)
    return np.asarray(~on_it & (come | barred))


def _stopping(situation: Situation, reference_m: Floats, first: int) -> Floats:
    """(F, 2) a reference that stops before its step ``first``."""
    line = np.concatenate([situation.start.position_m[None], reference_m])
    step = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    end_m = max(float(along[first]) - _BEFORE_M, 0.0)
    brake = _SHARE * situation.limits.brake
    speed = step / DT_S  # from each point to the next
    begin = int((along[:-1] + speed**2 / (2 * brake) >= end_m).argmax())
    left_m = max(end_m - float(along[begin]), 1e-3)
    brake = min(float(speed[begin]) ** 2 / (2 * left_m), situation.limits.brake)
    since = np.minimum(DT_S * np.arange(len(line) - begin), speed[begin] / max(brake, 1e-3))
    along_m = along.copy()
    along_m[begin:] = along[begin] + speed[begin] * since - brake * since**2 / 2
    return np.column_stack([np.interp(along_m[1:], along, axis) for axis in line.T])
