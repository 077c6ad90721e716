"""The opponent's driving under the policy: limits of its class, the road, traffic lights."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric, once
from deepmf_sumo.scene import (
    Bools,
    Case,
    Driver,
    Floats,
    RecordedCase,
    RoadMap,
    Rollout,
    SignalState,
)
from deepmf_sumo.scene.geometry import frames, polylines, road
from deepmf_sumo.scene.geometry.ground import on_level
from deepmf_sumo.scene.geometry.lane_map import width_m
from deepmf_sumo.scene.geometry.walkable import walkable
from deepmf_sumo.scene.road_users import PEOPLE, RoadUser, road_user
from deepmf_sumo.scene.signals import FORBIDS, GOES, HALTS
from deepmf_sumo.sumo.network.sumo_net import edge_of, junction_of

_TURN_NOISE_RAD = 0.1
_SIDEWAYS, _SLIDING_MPS = 0.5, 2.0  # sine of 30 degrees; slow motion has no exact direction
_NOISE_M = 0.1  # error of a state, mainly of the measured one before the first driven pose
_NOISE_OF_PEOPLE_M = 0.25
_TURNING_MPS = 2.0  # boxes of slow cyclists turn to and fro
_FASTER = 1.25  # times the highest speed that is planned
_MOVING_MPS = 1.0
_SAME_WAY = 0.5  # cosine: within 60 degrees of the lane
_JUNCTION_M = 50.0  # from a place in a junction to its stop lines, at most


@metric("1", better="higher")
def feasible(episode: Episode) -> float:
    """1 where, at every step driven by the policy, the opponent's acceleration (second differences
    over 0.2 s) is at most 8 m/s2 along and 5 m/s2 across its motion, it turns by at most 0.3 rad a
    metre (and 0.1 rad) and moves within 30 degrees of its heading (above 2 m/s; over 0.4 s), and
    each pose is at most 0.14 m from where the state before leads, else 0. Pedestrians and cyclists
    have limits of their own.

    A car neither accelerates nor steers beyond limits, nor slides sideways. Of 241 recorded cars
    240 steer and slide within these limits; the limits of acceleration are those of dry roads. For
    people see `possible`.
    """
    rollout = episode.rollout
    row, steps = _slices.driving(rollout)
    tracks = rollout.tracks
    user = road_user(tracks.kinds[row], tracks.size_m[row])
    if not _follows(rollout, row, steps, user).all():
        return False
    return all(
        possible(user, tracks.position_m[row, run], tracks.heading_rad[row, run], rollout.dt_s)
        for run in _slices.runs(steps)
    )


def possible(user: RoadUser, position_m: Floats, heading_rad: Floats, dt_s: float) -> bool:
    """Whether a road user of a class can move so: poses (K, 2), (K), one every ``dt_s``.

    Vehicles: see `feasible`. Of pedestrians and cyclists accelerations are second differences over
    0.5 s, since their boxes tremble; they are at most 1.25 times as fast as is ever planned for
    them. A cyclist turns by at most 0.83 rad a metre (and 0.1 rad; above 2 m/s); a pedestrian turns
    freely. ``python -m tests.bench.people_limits ../shared/womd/train``: 98.0 % of 1,842 recorded
    pedestrians and 97.9 % of 144 cyclists pass, 99.6 % and 98.6 % of those whose box never jumps.
    The others are boxes that tremble, runners above 4.4 m/s, and a cyclist at 49 km/h.
    """
    motion, limits = user.motion, user.motion.possible
    span = _slices.SPAN_OF_PEOPLE if user.person else _slices.SPAN
    along, across = _slices.accelerations(position_m, heading_rad, dt_s, span)
    if (along > limits.accel).any() or (-along > limits.brake).any():
        return False
    if (np.abs(across) > limits.lateral).any():
        return False
    found = _slices.steering(position_m, heading_rad, dt_s)
    if (found.speed_mps > _FASTER * motion.fastest_mps).any():
        return False
    if motion.body == "point":
        return True
    slides = (found.sideways > _SIDEWAYS) & (found.speed_mps > _SLIDING_MPS)
    turns = found.turn_rad > motion.turn_per_m * found.distance_m + _TURN_NOISE_RAD
    if user.person:
        turns &= found.speed_mps > _TURNING_MPS
    return not (slides.any() or turns.any())


def _follows(rollout: Rollout, row: int, steps: Bools, user: RoadUser) -> Bools:
    """(K) whether the poses of some steps (T) follow from the states one step before them.

    Differences over 0.2 s miss runs of fewer than five poses, and jumps back and forth.
    """
    tracks, at = rollout.tracks, np.flatnonzero(steps)
    before = np.maximum(at - 1, 0)
    moved = tracks.position_m[row, at] - tracks.position_m[row, before]
    missed = np.hypot(*(moved - tracks.velocity_mps[row, before] * rollout.dt_s).T)
    limits = user.motion.possible
    measured = user.person & (rollout.driver[row, before] == Driver.LOG)
    noise = np.where(measured, _NOISE_OF_PEOPLE_M, _NOISE_M)
    allowed = max(limits.accel, limits.brake) * rollout.dt_s**2 / 2 + noise
    return np.asarray((missed <= allowed) | ~tracks.valid[row, before])


@once
def _on_road(episode: Episode) -> float:
    """Share of the driven steps at which the opponent's centre is on the road.

    Human drivers do not reach 1 everywhere: driveways and car parks have no lanes. To people,
    whatever they can walk on or cross is road.
    """
    rollout, road_map = episode.rollout, episode.case.road
    driving = _slices.driving(rollout)
    places = _slices.places(rollout, driving)
    if rollout.tracks.kinds[driving.row] in PEOPLE:
        return float(walkable(road_map).holds(*places).mean())
    return float(road.on_road(road_map, *places).mean())


@metric("1", better="higher")
def on_road(episode: Episode) -> float:
    """Share of the steps driven by the policy at which the opponent's centre is within half a width
    (3.7 m where unknown) and 0.5 m of the centre line of a lane for cars; of a pedestrian or a
    cyclist: where people can be (``scene.geometry.walkable``).
    """
    return _on_road(episode)


@metric("1", better="lower")
def offroad_share(episode: Episode) -> float:
    """Share of the steps driven by the policy at which the centre of the opponent is farther than
    half a width (3.7 m where unknown) and 0.5 m from the centre line of every lane for cars; of a
    pedestrian or a cyclist: where nobody can be (``scene.geometry.walkable``).
    """
    return 1.0 - _on_road(episode)


@metric("1", better="lower")
def wrong_way_share(episode: Episode) -> float:
    """Share of the steps driven by the policy at which the opponent is on the road, moves faster
    than 1 m/s, and every lane there (half a width and 0.5 m around its centre line) runs more than
    120 degrees off its direction of motion.
    """
    return float(against_traffic(episode, _slices.driving(episode.rollout)).mean())


def against_traffic(episode: Episode, driving: _slices.Driving) -> Bools:
    """(K) steps at which an agent is against the traffic, see `wrong_way_share`."""
    rollout = episode.rollout
    velocity = rollout.tracks.velocity_mps[driving.row, driving.steps]
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    position_m, z_m = _slices.places(rollout, driving)
    against = road.against_traffic(episode.case.road, position_m, course, z_m)
    return np.asarray(against & (np.hypot(*velocity.T) > _MOVING_MPS))


@metric("1", better="lower")
def red_light(episode: Episode) -> float:
    """1 where, while the policy drives the opponent, the middle of its front bumper crosses stop
    lines of lanes in their direction (within 60 degrees and half a width) that all are red, else 0.

    A turn on red after a stop, which some countries allow, counts too: maps do not say where it is.
    """
    rollout = episode.rollout
    row, steps = _slices.driving(rollout)
    if not rollout.signals:
        raise NotMeasurable("the rollout has no states of traffic lights")
    return passed_on_red(rollout, episode.case, row, steps)


class StopLine(NamedTuple):
    """The stop line of a lane: (2) point on it, its direction, half its width, its height there."""

    lane_id: str
    point_m: Floats
    heading_rad: float
    half_m: float
    z_m: float


def stop_lines(rollout: Rollout, case: Case) -> list[StopLine]:
    """Stop lines of all lanes with lights: as recorded, or at the lane starts of a SUMO network."""
    if isinstance(case, RecordedCase):
        signals = case.scene.signals
        points = dict(zip(signals.lane_ids, signals.stop_m, strict=True))
    else:
        names = dict.fromkeys(name for lights in rollout.signals for name in lights)
        lanes = case.road.lanes
        points = {name: lanes[name].centre_m[0] for name in names if name in lanes}
    return [
        _stop_line(case.road, lane_id, point)
        for lane_id, point in points.items()
        if lane_id in case.road.lanes and len(case.road.lanes[lane_id].centre_m) > 1
    ]


def lights_passed(
    rollout: Rollout, road: RoadMap, row: int, place_m: Floats, junction: str = ""
) -> set[SignalState]:
    """States of the lights whose stop lines an agent's front crosses, as they were before the step.

    Those of its last crossing alone, and only where the line is near the place (2): at most 50 m
    away. A lane begins at its stop line. Of lights that are crossed together all are given.
    ``junction``: of a network, the only one whose lights count.
    """
    found: dict[int, set[SignalState]] = {}
    for lane_id in dict.fromkeys(name for lights in rollout.signals for name in lights):
        lane = road.lanes.get(lane_id)
        if lane is None or len(lane.centre_m) < 2:
            continue
        if junction and junction_of(edge_of(lane_id)) != junction:
            continue
        if np.hypot(*(lane.centre_m[0] - place_m)) > _JUNCTION_M:
            continue
        line = _stop_line(road, lane_id, lane.centre_m[0])
        for step in np.flatnonzero(_crossing(rollout, road, row, line)).tolist():
            number = step - 1 - rollout.now
            if number >= 0 and lane_id in rollout.signals[number]:
                found.setdefault(step, set()).add(rollout.signals[number][lane_id])
    return found[max(found)] if found else set()


def may_turn_on_red(case: Case, turn_rad: float) -> bool:
    """Whether a turn (left is positive) may be allowed at a red light after a stop.

    Of recordings maps do not say where: turning right may be. SUMO has a letter of its own for
    lights at which it is, so its red forbids all.
    """
    return isinstance(case, RecordedCase) and turn_rad < 0


def passed_green(rollout: Rollout, road: RoadMap, row: int, place_m: Floats, crossing: str) -> bool:
    """Whether the lights that an agent passed last before a place (2), if any, let it go.

    ``crossing``: id of the crossing there. In a network a light stops people at the crossings of
    its own junction alone: a zebra behind it belongs to another junction.
    """
    passed = lights_passed(rollout, road, row, place_m, junction_of(crossing))
    return bool(passed & GOES) and not passed & FORBIDS


def passed_on_red(rollout: Rollout, case: Case, row: int, steps: Bools) -> bool:
    """Whether an agent's front crosses stop lines in one of the steps (T), all of them red.

    Lanes that start side by side are crossed together: a green one counts as the agent's lane.
    """
    for step, lane_ids in _crossed(rollout, case, row, steps).items():
        lights = rollout.signals[step - 1 - rollout.now]  # as they were before the step
        if all(lights.get(lane_id) in FORBIDS for lane_id in lane_ids):
            return True
    return False


def late_at_signal_s(rollout: Rollout, case: Case, row: int, steps: Bools) -> float:
    """Longest time since a light left green when an agent's front crossed its stop line.

    In one of the steps (T); as far as the rollout shows, 0 without such a crossing.
    """
    return max(crossed_late(rollout, case, row, steps).values(), default=0) * rollout.dt_s


def crossed_late(rollout: Rollout, case: Case, row: int, steps: Bools) -> dict[int, int]:
    """Steps of those (T) in which an agent's front crosses a stop line whose light is not green.

    Each with the number of steps since the light left green, as far as the rollout shows. Of lines
    that are crossed together the least counts.
    """
    late = {}
    for step, lane_ids in _crossed(rollout, case, row, steps).items():
        before = rollout.signals[: step - rollout.now]
        late[step] = min(_stopping(before, lane_id) for lane_id in lane_ids)
    return {step: number for step, number in late.items() if number}


def _stopping(signals: tuple[dict[str, SignalState], ...], lane_id: str) -> int:
    """For how many of the last steps a light has been yellow or red."""
    other = (at for at, each in enumerate(reversed(signals)) if each.get(lane_id) not in HALTS)
    return next(other, len(signals))


def _crossed(rollout: Rollout, case: Case, row: int, steps: Bools) -> dict[int, list[str]]:
    """Lanes whose stop lines an agent's front crosses, by step, in some steps (T)."""
    crossed: dict[int, list[str]] = {}
    for line in stop_lines(rollout, case):
        for at in np.flatnonzero(_crossing(rollout, case.road, row, line) & steps):
            crossed.setdefault(int(at), []).append(line.lane_id)
    return crossed


def _stop_line(road: RoadMap, lane_id: str, point: Floats) -> StopLine:
    lane = road.lanes[lane_id]
    foot = polylines.project(lane.centre_m, point)
    z_m = float(np.interp(foot.along_m, polylines.arc_lengths(lane.centre_m), lane.z_m))
    return StopLine(lane_id, point, float(foot.heading_rad), width_m(lane) / 2, z_m)


def _crossing(rollout: Rollout, road_map: RoadMap, row: int, line: StopLine) -> Bools:
    """(T) steps in which the middle of the front bumper crosses the line, on its level."""
    tracks = rollout.tracks
    heading = tracks.heading_rad[row]
    front = tracks.position_m[row] + frames.unit(heading) * tracks.size_m[row, 0] / 2
    ahead, left = frames.to_local(front, line.point_m, line.heading_rad).T
    over = (ahead[:-1] <= 0) & (ahead[1:] > 0) & (np.abs(left[1:]) <= line.half_m)
    along = np.cos(heading[1:] - line.heading_rad) > _SAME_WAY
    there = tracks.valid[row, :-1] & tracks.valid[row, 1:]
    there &= on_level(road_map, tracks.z_m[row, 1:], line.z_m)
    crossing: Bools = np.concatenate([[False], over & along & there])
    return crossing
