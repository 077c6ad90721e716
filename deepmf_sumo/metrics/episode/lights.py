"""Stop lines with lights, and who drives over them."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Bools, Case, Floats, Rollout, SignalState
from deepmf_sumo.geometry import angles, frames, polylines
from deepmf_sumo.geometry.road import WIDTH_M

_RED = {SignalState.STOP, SignalState.ARROW_STOP}
_SAME_WAY = 0.5  # cosine: within 60 degrees of the lane


class StopLine(NamedTuple):
    """Where a lane's traffic stops: (2) point on the lane, its direction, half the lane's width."""

    lane_id: str
    point_m: Floats
    heading_rad: float
    half_m: float


def stop_lines(rollout: Rollout, case: Case) -> list[StopLine]:
    """Of all lanes with lights: as recorded, or in a SUMO network where the lanes begin."""
    if case.scene is not None:
        signals = case.scene.signals
        points = dict(zip(signals.lane_ids, signals.stop_m, strict=True))
    else:
        names = dict.fromkeys(name for lights in rollout.signals for name in lights)
        lanes = case.road.lanes
        points = {name: lanes[name].centre_m[0] for name in names if name in lanes}
    return [
        _stop_line(case, lane_id, point)
        for lane_id, point in points.items()
        if lane_id in case.road.lanes and len(case.road.lanes[lane_id].centre_m) > 1
    ]


def passed_on_red(rollout: Rollout, case: Case, row: int, steps: Bools) -> bool:
    """Whether an agent's front crosses stop lines in one of the steps (T), all of them red.

    Lanes that begin side by side are crossed together: one that is not red is taken as its own.
    """
    crossed: dict[int, list[str]] = {}
    for line in stop_lines(rollout, case):
        for at in np.flatnonzero(_crossing(rollout, row, line) & steps):
            crossed.setdefault(int(at), []).append(line.lane_id)
    for step, lane_ids in crossed.items():
        lights = rollout.signals[step - 1 - rollout.now]  # as they were before the step
        if all(lights.get(lane_id) in _RED for lane_id in lane_ids):
            return True
    return False


def _stop_line(case: Case, lane_id: str, point: Floats) -> StopLine:
    lane = case.road.lanes[lane_id]
    heading = float(polylines.project(lane.centre_m, point).heading_rad)
    return StopLine(lane_id, point, heading, (lane.width_m or WIDTH_M) / 2)


def _crossing(rollout: Rollout, row: int, line: StopLine) -> Bools:
    """(T) steps at whose end the middle of the front bumper is beyond the line, and was not."""
    tracks = rollout.tracks
    heading = tracks.heading_rad[row]
    front = tracks.position_m[row] + angles.unit(heading) * tracks.size_m[row, 0] / 2
    ahead, left = frames.to_local(front, line.point_m, line.heading_rad).T
    over = (ahead[:-1] <= 0) & (ahead[1:] > 0) & (np.abs(left[1:]) <= line.half_m)
    along = np.cos(heading[1:] - line.heading_rad) > _SAME_WAY
    there = tracks.valid[row, :-1] & tracks.valid[row, 1:]
    crossing: Bools = np.concatenate([[False], over & along & there])
    return crossing
