"""A recording prepared for SUMO: its vehicles, their routes, and their positions at each step."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import Bools, Driver, Floats, RecordedCase, Scene, Tracks
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.sumo.network.matching import edge_route, lane_sequence, match
from deepmf_sumo.sumo.simulation.frame import Body, Frame

_STANDS_M = 1.0
"""A vehicle that never moves farther than this from its first position stands."""
_MATCH_MOVING_M = 5.0
_EXTEND_M = 300.0
"""Length of routes beyond the recording, so that no vehicle arrives and vanishes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """What replaying needs of a recording, computed once per case.

    Attributes:
        rows: agents that are vehicles in SUMO, sorted by id. All others are boxes outside it.
        routes: row -> edges; SUMO never drives rows without a route.
        match_m: (A) `matchThreshold`. Narrow for vehicles that stand: it decides whether a parked
            car blocks the lane. Wide for those that move: with a narrow one SUMO takes the nearest
            lane, whatever its direction and the route of the vehicle.
        front_m: (A, T, 2) and angle_deg: (A, T) as SUMO has them.
        passed: signalled lane -> step at which the AV enters it.
    """

    rows: tuple[int, ...]
    routes: dict[int, tuple[str, ...]]
    match_m: Floats
    front_m: Floats
    angle_deg: Floats
    passed: dict[str, int]


def recorded_body(tracks: Tracks, row: int) -> Body:
    """Kind and size of an agent as recorded."""
    length, width, height = (float(value) for value in tracks.size_m[row])
    return Body(kind=tracks.kinds[row], size_m=(length, width, height))


def recorded_frame(tracks: Tracks, step: int, wanted: Bools) -> Frame:
    """The wanted (A) agents that a recording has at a step; none after its end."""
    if step >= tracks.steps:
        return Frame.of_poses({})
    rows = np.flatnonzero(tracks.valid[:, step] & wanted)
    return Frame(
        ids=[tracks.ids[row] for row in rows],
        position_m=tracks.position_m[rows, step],
        z_m=tracks.z_m[rows, step],
        heading_rad=tracks.heading_rad[rows, step],
        velocity_mps=tracks.velocity_mps[rows, step],
        driver=np.full(len(rows), int(Driver.LOG), np.uint8),
    )


@lru_cache(maxsize=2)
def log_of(case: RecordedCase) -> Log:
    """The log of a case with a recording. Searches ask for the same case many times."""
    tracks = case.scene.tracks
    av = tracks.row(case.av_id)
    stands = _stands(tracks)
    side = np.maximum((tracks.size_m[av, 1] + tracks.size_m[:, 1]) / 2 + 0.1, 1.9)
    blocking = _blocking(case, tracks, stands, side)
    vehicles = [
        row
        for row in sorted(range(tracks.agents), key=lambda row: tracks.ids[row])
        if tracks.kinds[row] == "vehicle"
        and row != av
        and tracks.valid[row, case.scene.now :].any()
    ]
    rows = tuple(row for row in vehicles if not stands[row] or blocking[row])
    routes = {row: _route(case, row) for row in (av, *rows) if row == av or not stands[row]}
    front, angle = frames.to_sumo(tracks.position_m, tracks.heading_rad, tracks.size_m[:, None, 0])
    return Log(
        rows=rows,
        routes={row: route for row, route in routes.items() if route},
        match_m=np.where(stands, side, _MATCH_MOVING_M),
        front_m=front,
        angle_deg=angle,
        passed=_passed_lights(case.scene),
    )


def check_route(case: RecordedCase) -> None:
    """Raise SimulationError if the AV drives on no lane, so that SUMO could not drive it.

    Episodes without SUMO check it, too, so that all planners have the same scenes.
    """
    if not _av_route(case):
        raise SimulationError(
            f"The AV '{case.av_id}' of scene '{case.scene.name}' drives on no lane of the network, "
            "so that SUMO cannot drive it; use another scene."
        )


@lru_cache(maxsize=4)
def _av_route(case: RecordedCase) -> tuple[str, ...]:
    return _route(case, case.scene.tracks.row(case.av_id))


def _passed_lights(scene: Scene) -> dict[str, int]:
    """The step at which the AV enters each signalled lane, whose light is at its first point."""
    tracks, row = scene.tracks, scene.tracks.row(scene.av_id)
    if not scene.signals.lane_ids:
        return {}
    poses = tracks.position_m[row], tracks.heading_rad[row], tracks.valid[row]
    lanes = match(scene.road, *poses, tracks.z_m[row]).lane_ids
    passed: dict[str, int] = {}
    for step, (before, lane) in enumerate(pairwise(lanes), start=1):
        if lane != before and lane in scene.signals.lane_ids and step > scene.now:
            passed.setdefault(lane, step)
    return passed


def _stands(tracks: Tracks) -> Bools:
    first = tracks.valid.argmax(axis=1)
    origin = tracks.position_m[np.arange(tracks.agents), first]
    away = np.hypot(*np.moveaxis(tracks.position_m - origin[:, None], -1, 0))
    return np.where(tracks.valid, away, 0.0).max(axis=1) < _STANDS_M


def _blocking(case: RecordedCase, tracks: Tracks, stands: Bools, match_m: Floats) -> Bools:
    """Standing agents near enough to a lane's centre to block a car there."""
    blocking = np.zeros(tracks.agents, bool)
    rows = np.flatnonzero(stands & tracks.valid.any(axis=1))
    first = tracks.valid[rows].argmax(axis=1)
    points = tracks.position_m[rows, first]
    for lane_id in sorted(case.net.pieces):
        centre = case.road.lanes[lane_id].centre_m
        if len(centre) < 2 or not len(rows):
            continue
        low, high = centre.min(0) - match_m.max(), centre.max(0) + match_m.max()
        near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
        if len(near):
            foot = polylines.project(centre, points[near])
            blocking[rows[near]] |= foot.distance_m < match_m[rows[near]]
    return blocking


def _route(case: RecordedCase, row: int) -> tuple[str, ...]:
    """Edges of an agent in the recording and beyond it; () off every lane."""
    tracks = case.scene.tracks
    if tracks.ids[row] == case.av_id and case.net.ghost_edge is not None:
        return (case.net.ghost_edge,)
    # from where the vehicle is inserted on: SUMO looks for it at the beginning of its route
    valid = tracks.valid[row].copy()
    valid[: case.scene.now] = False
    lanes = lane_sequence(
        case.road, tracks.position_m[row], tracks.heading_rad[row], valid, tracks.z_m[row]
    )
    return edge_route(case.net, lanes, _EXTEND_M)
