"""A scenario of the Waymo Open Motion Dataset: ``womd/run.tfrecord``, one ``Scenario`` message.

It holds the scene of `exporters.scene`: after a contact the AV is not there, and the last plan of
the opponent continues. Ids are numbers in this format: ``ids.csv`` says which is which. Headings,
velocities and sizes have single precision there; of lanes it lacks widths and priorities. Nothing
in the message can mark people who were made: rows ``made`` of ``ids.csv`` do.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo import files, plugins, tables
from deepmf_sumo.exporters._numbers import Numbers, Sort
from deepmf_sumo.exporters.base import Exportable, known_heights
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import Boundary, Floats, Lane, Neighbour, RoadMap, Scene, Signals
from deepmf_sumo.scene.readers.protos import scenario_pb2 as pb
from deepmf_sumo.scene.readers.raw.road import MPS_PER_MPH
from deepmf_sumo.scene.readers.womd import packed

FILE: Final = "womd/"
RECORDS, IDS = "run.tfrecord", "ids.csv"
_TYPES: Final = {
    "vehicle": pb.Track.TYPE_VEHICLE,
    "pedestrian": pb.Track.TYPE_PEDESTRIAN,
    "cyclist": pb.Track.TYPE_CYCLIST,
    "other": pb.Track.TYPE_OTHER,
}
_LANES: Final = {"unknown": 0, "freeway": 1, "street": 2, "bike": 3}
"""LaneCenter.type."""


class Settings(plugins.Settings):
    """None."""


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the folder ``path``. Raises OutputError and what `Exportable.around` raises."""
    scene = _there(scene_of(run))
    tracks = Numbers(("track", agent) for agent in scene.tracks.ids)
    features = Numbers(_features(scene.road, scene.signals))
    message = scenario(scene, tracks, features)
    rows = [
        {"kind": sort, "number": number, "id": name}
        for (sort, name), number in [*tracks.of.items(), *features.of.items()]
        if str(number) != name
    ]
    rows += [
        {"kind": "made", "number": number, "id": name}
        for (_, name), number in tracks.of.items()
        if name in run.made
    ]
    with files.writing(path), files.whole_folder(path) as folder:
        (folder / RECORDS).write_bytes(packed(message))
        (folder / IDS).write_text(tables.to_csv(rows, ("kind", "number", "id")), "utf-8")


def scenario(scene: Scene, tracks: Numbers, features: Numbers) -> pb.Scenario:
    """The scene as a message; the AV and its opponent are those to predict."""
    interest = [tracks("track", agent) for agent in scene.interest]
    message = pb.Scenario(
        timestamps_seconds=scene.timestamps_s.tolist(),
        tracks=_tracks(scene, tracks),
        objects_of_interest=interest,
        scenario_id=scene.name,
        sdc_track_index=scene.tracks.row(scene.av_id),
        dynamic_map_states=_signals(scene.signals, features),
        current_time_index=scene.now,
        tracks_to_predict=[
            pb.RequiredPrediction(track_index=scene.tracks.row(agent)) for agent in scene.interest
        ],
    )
    _add_road(message, scene.road, features)
    return message


def _there(scene: Scene) -> Scene:
    """With the road users that are ever there: a track without a state means nothing."""
    rows = np.flatnonzero(scene.tracks.valid.any(axis=1)).tolist()
    return scene.of_agents([scene.tracks.ids[row] for row in rows])


def _features(road: RoadMap, signals: Signals) -> Iterable[tuple[Sort, str]]:
    """Lanes first, so that they keep their numbers."""
    yield from (("lane", name) for name in road.lanes)
    yield from (("lane", name) for name in signals.lane_ids)
    yield from (("line", one.id) for one in road.lines)
    yield from (("edge", one.id) for one in road.edges)
    yield from (("polygon", one.id) for one in road.polygons)
    yield from (("stop_sign", one.id) for one in road.stop_signs)


def _tracks(scene: Scene, numbers: Numbers) -> list[pb.Track]:
    tracks, heights = scene.tracks, known_heights(scene.tracks)
    found = []
    for row, agent in enumerate(tracks.ids):
        length, width, _ = tracks.size_m[row].tolist()
        track = pb.Track(id=numbers("track", agent), object_type=_TYPES[tracks.kinds[row]])
        for step in range(tracks.steps):
            state = track.states.add(valid=bool(tracks.valid[row, step]))
            if state.valid:
                state.center_x, state.center_y = tracks.position_m[row, step].tolist()
                state.center_z = float(tracks.z_m[row, step] + heights[row] / 2)
                state.heading = float(tracks.heading_rad[row, step])
                state.velocity_x, state.velocity_y = tracks.velocity_mps[row, step].tolist()
                state.length, state.width = length, width
                state.height = float(heights[row])
        found.append(track)
    return found


def _signals(signals: Signals, numbers: Numbers) -> list[pb.DynamicMapState]:
    """At each step the lanes whose state was seen."""
    found = []
    for step in range(signals.seen.shape[1]):
        states = pb.DynamicMapState()
        for row in signals.seen[:, step].nonzero()[0].tolist():
            x, y = signals.stop_m[row].tolist()
            states.lane_states.add(
                lane=numbers("lane", signals.lane_ids[row]),
                state=int(signals.state[row, step]),
                stop_point=pb.MapPoint(x=x, y=y, z=float(signals.stop_z_m[row])),
            )
        found.append(states)
    return found


def _add_road(message: pb.Scenario, road: RoadMap, numbers: Numbers) -> None:
    add = message.map_features.add
    for lane in road.lanes.values():
        add(id=numbers("lane", lane.id), lane=_lane(lane, numbers))
    for line in road.lines:
        drawn = pb.RoadLine(type=line.kind, polyline=_points(line.points_m, line.z_m))
        add(id=numbers("line", line.id), road_line=drawn)
    for edge in road.edges:
        kerb = pb.RoadEdge(type=edge.kind, polyline=_points(edge.points_m, edge.z_m))
        add(id=numbers("edge", edge.id), road_edge=kerb)
    for one in road.polygons:
        outline = getattr(add(id=numbers("polygon", one.id)), one.kind)
        outline.polygon.extend(_points(one.points_m, one.z_m))
    for sign in road.stop_signs:
        x, y = sign.position_m.tolist()
        stop = pb.StopSign(
            lane=numbers.known("lane", sign.lane_ids), position=pb.MapPoint(x=x, y=y, z=sign.z_m)
        )
        add(id=numbers("stop_sign", sign.id), stop_sign=stop)


def _points(points_m: Floats, z_m: Floats) -> list[pb.MapPoint]:
    return [
        pb.MapPoint(x=x, y=y, z=z)
        for (x, y), z in zip(points_m.tolist(), z_m.tolist(), strict=True)
    ]


def _lane(lane: Lane, numbers: Numbers) -> pb.LaneCenter:
    return pb.LaneCenter(
        speed_limit_mph=(lane.speed_limit_mps or 0.0) / MPS_PER_MPH,
        type=_LANES[lane.kind],
        interpolating=lane.interpolating,
        polyline=_points(lane.centre_m, lane.z_m),
        entry_lanes=numbers.known("lane", lane.previous),
        exit_lanes=numbers.known("lane", lane.next),
        left_neighbors=_neighbours(lane.left, numbers),
        right_neighbors=_neighbours(lane.right, numbers),
        left_boundaries=_boundaries(lane.left_boundaries, numbers),
        right_boundaries=_boundaries(lane.right_boundaries, numbers),
    )


def _neighbours(beside: Sequence[Neighbour], numbers: Numbers) -> list[pb.LaneNeighbor]:
    return [
        pb.LaneNeighbor(
            feature_id=number,
            self_start_index=one.self_start,
            self_end_index=one.self_end,
            neighbor_start_index=one.other_start,
            neighbor_end_index=one.other_end,
        )
        for one in beside
        for number in numbers.known("lane", [one.lane_id])
    ]


def _boundaries(borders: Sequence[Boundary], numbers: Numbers) -> list[pb.BoundarySegment]:
    """Those of painted lines, else of a road's edges."""
    return [
        pb.BoundarySegment(
            lane_start_index=one.start,
            lane_end_index=one.end,
            boundary_feature_id=number,
            boundary_type=one.kind,
        )
        for one in borders
        for number in (
            numbers.known("line", [one.feature_id]) + numbers.known("edge", [one.feature_id])
        )[:1]
    ]
