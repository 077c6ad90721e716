"""A faulty copy without SUMO's help.

SUMO's model sees every vehicle of its lane and at its junctions. An AV that is left to it, or
drives behind a leader, is never faster than SUMO allows, so it brakes for what a faulty copy does
not see or not mind. Where a copy is shown something else than the truth of what SUMO may react to,
or judges it otherwise, the copy therefore drives by its own IDM: limits, stop lines at yellow and
red, the leader that it sees.
SUMO's right of way does not hold then; conflicts are left to the careful planner's prediction.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.scene import Bools, Command, Floats, Lane, SignalState, VehicleModel, View
from deepmf_sumo.scene.geometry import frames, polylines
from studies.planner_faults.careful import idm_accel

_LEADER_M: Final = 100.0
_CROSSING_M: Final = 60.0
_CLEAR_M: Final = 0.5
_COMES_TO_STAND_MPS2: Final = 4.5
"""Where it would have to brake harder for yellow or red, it drives on."""


@dataclass(frozen=True, slots=True, eq=False)
class Others:
    """The N agents of a view as the AV has them now, the AV's own row included.

    Attributes:
        local_m: (N, 2) centres in the AV's frame. turn_rad: (N) heading against the AV's.
        speed_mps, length_m, width_m: (N).
        clearance_m: (N) between the box and what the AV sweeps on its path; negative inside.
    """

    local_m: Floats
    turn_rad: Floats
    speed_mps: Floats
    length_m: Floats
    width_m: Floats
    clearance_m: Floats
    view: View


def around(view: View) -> Others:
    """The agents of a view."""
    tracks, me = view.history, view.history.row(view.av_id)
    position, heading = tracks.position_m[:, -1], tracks.heading_rad[:, -1]
    length, width = tracks.size_m[:, 0], tracks.size_m[:, 1]
    course, left = heading[me], np.abs(frames.to_local(position, position[me], heading[me])[:, 1])
    turned = heading - course
    if view.av_path_m is not None:
        foot = polylines.project(view.av_path_m, position)
        left, turned = np.abs(foot.left_m), heading - foot.heading_rad
    reach = np.abs(length * np.sin(turned)) + np.abs(width * np.cos(turned)) + width[me]
    return Others(
        local_m=frames.to_local(position, position[me], float(course)),
        turn_rad=np.abs(frames.difference(heading, course)),
        speed_mps=tracks.speed_mps[:, -1],
        length_m=length,
        width_m=width,
        clearance_m=left - reach / 2,
        view=view,
    )


def speed_of(view: View) -> float:
    """The AV's speed."""
    return float(view.history.speed_mps[view.history.row(view.av_id), -1])


def lanes_ahead(view: View, ahead_m: float) -> list[Lane]:
    """Lanes that lie on the AV's path within a distance, in no particular order."""
    if view.av_path_m is None:
        return []
    points, course = polylines.points_at(view.av_path_m, np.arange(0.0, ahead_m, 4.0))
    found = []
    for lane in view.road.lanes.values():
        if len(lane.centre_m) < 2 or lane.kind == "bike":
            continue
        low, high = lane.centre_m.min(0) - 1.0, lane.centre_m.max(0) + 1.0
        near = ((points >= low) & (points <= high)).all(-1)
        if near.any():
            foot = polylines.project(lane.centre_m, points[near])
            turn = np.abs(frames.difference(foot.heading_rad, course[near]))
            if ((foot.distance_m < 1.0) & (turn < np.pi / 6)).any():
                found.append(lane)
    return found


def limit_of(view: View) -> float | None:
    """The speed limit where the AV is; None if unknown."""
    known = [lane.speed_limit_mps for lane in lanes_ahead(view, 4.0) if lane.speed_limit_mps]
    return min(known) if known else None


STOPS: Final = {
    SignalState.STOP,
    SignalState.CAUTION,
    SignalState.ARROW_STOP,
    SignalState.ARROW_CAUTION,
}


def misled(truth: View, shown: View) -> bool:
    """Whether anything that SUMO may react to is hidden, or shown elsewhere or at another speed."""
    true, seen = around(truth), around(shown)
    row = {name: at for at, name in enumerate(shown.history.ids)}
    at = np.array([row.get(name, -1) for name in truth.history.ids])
    moved = np.zeros(len(at), bool)
    for mine, theirs in ((true.local_m, seen.local_m), (true.speed_mps, seen.speed_mps)):
        moved |= np.abs((mine - theirs[at]).reshape(len(at), -1)).max(axis=1) > 1e-6
    moved |= (true.clearance_m < 0) != (seen.clearance_m[at] < 0)
    return bool((_matters(true) & (moved | (at < 0))).any())


def met(view: View) -> bool:
    """Whether there is anything that SUMO may react to, or will as the AV comes nearer."""
    return bool(_matters(around(view), within_m=np.inf).any())


def _matters(seen: Others, within_m: float = _CROSSING_M) -> Bools:
    """(N) those ahead that SUMO may react to: in the AV's corridor, or on another course."""
    distance = np.hypot(*seen.local_m.T)
    corridor = (seen.clearance_m < _CLEAR_M) & (distance < _LEADER_M)
    crossing = (seen.turn_rad > np.pi / 4) & (distance < within_m)
    matters: Bools = (seen.local_m[:, 0] > 0) & (corridor | crossing)
    matters[seen.view.history.row(seen.view.av_id)] = False
    return matters


def driven(command: Command, shown: View, model: VehicleModel) -> Command:
    """The speed that the AV's own IDM would have instead of SUMO's, for the same leader."""
    if command.kind not in {"sumo", "leader"}:
        return command
    speed = speed_of(shown)
    wanted = model.desired_mps or limit_of(shown) or max(speed, 1.0)
    behind = [(_to_stop_line_m(shown, speed), 0.0)]
    if command.kind == "leader":
        behind.append((command.gap_m, command.leader_mps))
    accel = min(idm_accel(model, speed, *one) for one in behind)
    accel -= model.accel_mps2 * (speed / wanted) ** model.exponent
    faster = speed + max(accel, -model.emergency_mps2) * shown.dt_s
    return Command(kind="speed", speed_mps=max(0.0, faster), leader_id=command.leader_id)


def _to_stop_line_m(view: View, speed: float) -> float:
    """From the front bumper to the nearest line at yellow or red; inf where it drives on."""
    path = view.av_path_m
    if path is None or not view.signals:
        return np.inf
    lit = [one for one in lanes_ahead(view, 60.0) if view.signals.get(one.id) in STOPS]
    along = [float(polylines.project(path, one.centre_m[0]).along_m) for one in lit]
    ahead = [one for one in along if one > 0.1 and speed**2 / (2 * one) < _COMES_TO_STAND_MPS2]
    return min(ahead, default=np.inf)
