"""What the AV drove through: its steps, the lights ahead of it, and what explains that it slows."""

from typing import Final, NamedTuple, Self

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, driving, once
from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, Rollout, SignalState
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.ground import Ground, ground_of, on_level
from deepmf_sumo.scene.signals import GOES, HALTS
from deepmf_sumo.sumo.network.matching import match

CEILING_MPS2: Final = 10.0
"""Of braking: no car brakes harder."""
_LIGHT_M: Final = 120.0
_AHEAD_M: Final = 100.0
_WAY_M: Final = 60.0
_NEAR_M: Final = 60.0
_GENTLE_MPS2: Final = 2.0
_ASIDE_M: Final = 2.5
_ASIDE_MPS: Final = 0.3
_PARALLEL_RAD: Final = float(np.radians(15))
_FREE_S: Final = 2.0
_ALONG: Final = 0.5  # cosine: within 60 degrees
_SLOWER_MPS: Final = 0.5


def driven_steps(rollout: Rollout) -> Bools:
    """(T) simulated steps with the AV, up to its first contact. Raises NotMeasurable if none."""
    tracks = rollout.tracks
    own = [one.step for one in rollout.contacts if one.kind in {"av_opponent", "av_other"}]
    step = np.arange(tracks.steps)
    found: Bools = tracks.valid[tracks.row(rollout.av_id)] & (step > rollout.now)
    found &= step <= min(own, default=tracks.steps)
    if not found.any():
        raise NotMeasurable("the AV was not simulated")
    return found


class DrivenSteps(NamedTuple):
    """The AV at its K `driven_steps`.

    Attributes:
        row: of the AV. steps: (K). position_m: (K, 2). z_m, heading_rad, speed_mps: (K).
        size_m: (2).
        signals: (K) states of the lights before each step; empty where unknown.
    """

    row: int
    steps: Ints
    position_m: Floats
    z_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    size_m: Floats
    signals: tuple[dict[str, SignalState], ...]

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """Of an episode. Raises NotMeasurable where the AV was not simulated."""
        rollout = episode.rollout
        tracks, row = rollout.tracks, rollout.tracks.row(rollout.av_id)
        steps = np.flatnonzero(driven_steps(rollout))
        lights = rollout.signals
        return cls(
            row=row,
            steps=steps,
            position_m=tracks.position_m[row, steps],
            z_m=tracks.z_m[row, steps],
            heading_rad=tracks.heading_rad[row, steps],
            speed_mps=tracks.speed_mps[row, steps],
            size_m=tracks.size_m[row, :2],
            signals=tuple(
                lights[step - 1 - rollout.now] if step - 1 - rollout.now < len(lights) else {}
                for step in steps.tolist()
            ),
        )

    @property
    def front_m(self) -> Floats:
        """(K, 2) the middle of the front bumper."""
        return self.position_m + frames.unit(self.heading_rad) * self.size_m[0] / 2

    def light(self, at: int, lane_id: str) -> SignalState | None:
        """State of a lane's light before a step; None where it has none."""
        return self.signals[at].get(lane_id)


class StopApproach(NamedTuple):
    """A stop line that the AV comes to, or crosses.

    Attributes:
        left_m: (K) from the AV's front to the line along the road, negative beyond it; inf where
            the AV is not on the way to it. halts, goes: (K) whether all lights of the lanes that
            begin there are yellow or red, and whether all are green.
    """

    left_m: Floats
    halts: Bools
    goes: Bools


@once
def approaches(episode: Episode) -> list[StopApproach]:
    """All stop lines that the AV has ahead or crosses. Raises NotMeasurable without lights."""
    rollout = episode.rollout
    if not rollout.signals:
        raise NotMeasurable("the rollout has no states of traffic lights")
    drive, road = DrivenSteps.of(episode), episode.case.road
    groups: dict[tuple[float, ...], list[driving.StopLine]] = {}
    for line in driving.stop_lines(rollout, episode.case):
        if np.hypot(*(drive.position_m - line.point_m).T).min() < _LIGHT_M:
            x, y = line.point_m.tolist()
            place = tuple(round(one, 1) for one in (x, y, line.z_m))
            groups.setdefault(place, []).append(line)
    found = []
    for lines in groups.values():
        left_m = _left_m(drive, road, max(lines, key=lambda one: one.half_m))
        if np.isfinite(left_m).any():
            lit = [[drive.light(at, one.lane_id) for one in lines] for at in range(len(left_m))]
            halts = np.array([all(one in HALTS for one in each) for each in lit])
            goes = np.array([all(one in GOES for one in each) for each in lit])
            found.append(StopApproach(left_m, halts, goes))
    return found


def _left_m(drive: DrivenSteps, road: RoadMap, line: driving.StopLine) -> Floats:
    """(K) see `StopApproach`."""
    way = _way_to(road, line)
    front = drive.front_m
    foot, along = polylines.project(way[:, :2], front), polylines.arc_lengths(way[:, :2])
    left_m = float(along[-1]) - foot.along_m
    on_it = (np.abs(foot.left_m) <= line.half_m / 2) & (foot.along_m > 0) & (left_m > 0)
    on_it &= np.cos(foot.heading_rad - drive.heading_rad) > _ALONG
    on_it &= on_level(road, drive.z_m, np.interp(foot.along_m, along, way[:, 2]))
    ahead, aside = frames.to_local(front, line.point_m, line.heading_rad).T
    before = np.maximum.accumulate(on_it)  # beyond the line only for an AV that came over it
    beyond = before & (ahead > 0) & (ahead < drive.size_m[0] * 2) & (np.abs(aside) <= line.half_m)
    return np.where(on_it & (ahead <= 0), left_m, np.where(beyond, -ahead, np.inf))


def _way_to(road: RoadMap, line: driving.StopLine) -> Floats:
    """(P, 3) centre line of the road that leads to a stop line."""
    lane = road.lanes[line.lane_id]
    begin = float(polylines.project(lane.centre_m, line.point_m).along_m)
    end = np.append(line.point_m, line.z_m)
    own = np.c_[lane.centre_m, lane.z_m][polylines.arc_lengths(lane.centre_m) < begin]
    parts, length, seen = [own, end[None]], begin, {lane.id}
    while length < _LIGHT_M:
        before = [one for one in lane.previous if one in road.lanes and one not in seen]
        if not before or len(road.lanes[before[0]].centre_m) < 2:
            break
        lane = road.lanes[before[0]]
        seen.add(lane.id)
        parts.insert(0, np.c_[lane.centre_m, lane.z_m])
        length += float(polylines.arc_lengths(lane.centre_m)[-1])
    way = np.concatenate(parts)
    way = way[np.concatenate([[True], np.hypot(*np.diff(way[:, :2], axis=0).T) > 1e-6])]
    if len(way) < 2:
        way = np.stack([end - np.append(frames.unit(line.heading_rad), 0.0), end])
    return way


def lane_ids(
    episode: Episode, row: int | None = None, there: Bools | None = None
) -> tuple[str | None, ...]:
    """The lane of the AV at each of its K steps, or of another agent at some steps (T)."""
    tracks, road = episode.rollout.tracks, episode.case.road
    if row is None or there is None:
        return _own_lanes(episode)
    found = match(road, tracks.position_m[row], tracks.heading_rad[row], there, tracks.z_m[row])
    return tuple(name for name, here in zip(found.lane_ids, there, strict=True) if here)


@once
def _own_lanes(episode: Episode) -> tuple[str | None, ...]:
    there = driven_steps(episode.rollout)
    return lane_ids(episode, episode.rollout.tracks.row(episode.rollout.av_id), there)


@once
def unexplained(episode: Episode) -> Bools:
    """(K) whether nothing that can be seen explains that the AV slows down or stands.

    The reasons are listed at `av_rules.av_unexplained_stop`.
    """
    rollout, drive = episode.rollout, DrivenSteps.of(episode)
    free = drive.steps > rollout.now + round(1.0 / rollout.dt_s)
    free &= ~_someone_ahead(rollout, drive, ground_of(episode.case.road))
    free &= ~_ahead_on_road(episode, drive)
    free &= ~own_stops(rollout)[drive.steps]
    if rollout.signals:
        for one in approaches(episode):
            free &= ~(np.isfinite(one.left_m) & ~one.goes)
    return free


def own_stops(rollout: Rollout) -> Bools:
    """(T) whether a stop of the AV's route is within 100 m, or the AV stands at it."""
    there = np.zeros(rollout.tracks.steps, bool)
    for event in rollout.events:
        if event.kind in {"av_stop_ahead", "av_stop_over"}:
            there[event.step :] = event.kind == "av_stop_ahead"
    return there


def _someone_ahead(rollout: Rollout, drive: DrivenSteps, ground: Ground) -> Bools:
    tracks, found = rollout.tracks, np.zeros(len(drive.steps), bool)
    for row in range(tracks.agents):
        if row == drive.row:
            continue
        offset = tracks.position_m[row, drive.steps] - drive.position_m
        forward, left = frames.unit(drive.heading_rad), frames.unit(drive.heading_rad + np.pi / 2)
        ahead, aside = (offset * forward).sum(-1), (offset * left).sum(-1)
        velocity = tracks.velocity_mps[row, drive.steps]
        along, across = (velocity * forward).sum(-1), (velocity * left).sum(-1)
        turn = frames.difference(tracks.heading_rad[row, drive.steps], drive.heading_rad)
        parallel = np.abs(np.sin(turn)) < np.sin(_PARALLEL_RAD)
        nearer = across * np.sign(aside) < -_ASIDE_MPS
        passes = parallel & (np.abs(aside) > _ASIDE_M) & ~nearer
        free_m = drive.size_m[0] + _FREE_S * drive.speed_mps
        leaves = (np.cos(turn) > 0) & (along >= drive.speed_mps + _SLOWER_MPS) & (ahead > free_m)
        seen_m = _NEAR_M + drive.speed_mps**2 / (2 * _GENTLE_MPS2)
        near = tracks.valid[row, drive.steps] & (np.hypot(*offset.T) < seen_m)
        reach = (drive.size_m[0] + tracks.size_m[row, 0]) / 2
        near &= (ahead > -reach) & ~passes & ~leaves
        ends = tracks.position_m[row, drive.steps], tracks.z_m[row, drive.steps]
        near &= ~ground.apart(drive.position_m, drive.z_m, *ends)
        found |= near
    return found


def _ahead_on_road(episode: Episode, drive: DrivenSteps) -> Bools:
    """(K) whether a lower limit, the end of the lane, or a lane that gives way comes soon."""
    road, found = episode.case.road, np.zeros(len(drive.steps), bool)
    known: dict[str, list[tuple[float, float, bool]]] = {}
    for at, name in enumerate(lane_ids(episode)):
        if name is None:
            found[at] = True
            continue
        lane = road.lanes[name]
        foot = polylines.project(lane.centre_m, drive.front_m[at])
        if name not in known:
            known[name] = _features(road, name)
        for from_m, limit, waits in known[name]:
            left_m = from_m - float(foot.along_m)
            slower = left_m < _AHEAD_M and limit < drive.speed_mps[at] + _SLOWER_MPS / 5
            found[at] |= slower or (waits and left_m < _WAY_M)
    return found


def limits_ahead(episode: Episode, at: int) -> list[float]:
    """Speed limits of the lane that the AV is on, and of those within 100 m, at step ``at``."""
    name = lane_ids(episode)[at]
    return [] if name is None else [limit for _, limit, _ in _features(episode.case.road, name)]


def _features(road: RoadMap, name: str) -> list[tuple[float, float, bool]]:
    """Lanes from this one on: distance from its start, limit (0: the road ends), and gives way."""
    found, waiting = [], [(name, 0.0)]
    seen = {name}
    while waiting:
        one, from_m = waiting.pop()
        lane = road.lanes[one]
        length = float(polylines.arc_lengths(lane.centre_m)[-1])
        found.append((from_m, lane.speed_limit_mps or np.inf, bool(lane.gives_way_to)))
        after = [each for each in lane.next if each in road.lanes]
        if not after:
            found.append((from_m + length, 0.0, False))
        if from_m + length < _AHEAD_M + float(polylines.arc_lengths(road.lanes[name].centre_m)[-1]):
            waiting += [(each, from_m + length) for each in after if each not in seen]
            seen.update(after)
    return found


__all__ = [
    "CEILING_MPS2",
    "DrivenSteps",
    "StopApproach",
    "approaches",
    "driven_steps",
    "lane_ids",
    "limits_ahead",
    "own_stops",
    "unexplained",
]  # fmt: skip
