"""One made-up recording, as each of the formats would hold it.

Two lanes lead east, side by side, and one goes on from the right one. The AV drives at 10 m/s in
the right lane, a car at 12 m/s in the left one, and a pedestrian walks north, seen for 30 steps.
"""

import math

import numpy as np

from deepmf_sumo.scene.readers import womd
from deepmf_sumo.scene.readers.protos import scenario_pb2 as pb

AV_SIZE = (5.286, 2.332, 2.33)


def scenario(steps=91, now=10, name="abc123"):
    message = pb.Scenario(scenario_id=name, current_time_index=now, sdc_track_index=2)
    message.timestamps_seconds.extend(step * 0.1 for step in range(steps))
    add_track(message, 7, pb.Track.TYPE_VEHICLE, (5.0, 3.5), (12.0, 0.0), (4.5, 1.9, 1.5), steps)
    add_track(message, 9, pb.Track.TYPE_PEDESTRIAN, (60, -8), (0, 1.2), (0.8, 0.7, 1.8), steps, 30)
    add_track(message, 12, pb.Track.TYPE_VEHICLE, (0.0, 0.0), (10.0, 0.0), AV_SIZE, steps)
    message.objects_of_interest.extend([12, 7])
    message.tracks_to_predict.add(track_index=0, difficulty=1)
    add_lane(message, 100, (0, 0), 100, exits=[102], right=False, other=101)
    add_lane(message, 101, (0, 3.5), 100, right=True, other=100)
    add_lane(message, 102, (100, 0), 50, entries=[100], interpolating=True)
    line = message.map_features.add(id=200).road_line
    line.type = 1
    line.polyline.extend(pb.MapPoint(x=x, y=1.75, z=0.5) for x in range(0, 100, 5))
    edge = message.map_features.add(id=201).road_edge
    edge.type = 2
    edge.polyline.extend(pb.MapPoint(x=x, y=-2.0, z=0.5) for x in range(0, 100, 5))
    area = message.map_features.add(id=202).crosswalk
    area.polygon.extend(pb.MapPoint(x=x, y=y, z=0.5) for x, y in ((60, -2), (63, -2), (63, 5)))
    sign = message.map_features.add(id=203).stop_sign
    sign.lane.append(102)
    sign.position.x, sign.position.y, sign.position.z = 99.0, -3.0, 2.0
    for step in range(steps):
        state = message.dynamic_map_states.add()
        if step % 10:
            light = state.lane_states.add(lane=102, state=6 if step > 40 else 4)
            light.stop_point.x, light.stop_point.y, light.stop_point.z = 100.0, 0.0, 0.5
    return message


def add_track(message, number, kind, start, velocity, size, steps, seen=None):
    track = message.tracks.add(id=number, object_type=kind)
    for step in range(steps):
        if step >= (seen or steps):
            track.states.add(valid=False)
            continue
        track.states.add(
            center_x=start[0] + velocity[0] * step * 0.1,
            center_y=start[1] + velocity[1] * step * 0.1,
            center_z=1.0,
            length=size[0],
            width=size[1],
            height=size[2],
            heading=math.atan2(velocity[1], velocity[0]),
            velocity_x=velocity[0],
            velocity_y=velocity[1],
            valid=True,
        )


def add_lane(message, number, start, length, **links):
    lane = message.map_features.add(id=number).lane
    lane.type = 2
    lane.speed_limit_mph = 30.0
    lane.interpolating = links.get("interpolating", False)
    points = 2 * length + 1
    lane.polyline.extend(
        pb.MapPoint(x=start[0] + 0.5 * step, y=start[1], z=0.5) for step in range(points)
    )
    lane.exit_lanes.extend(links.get("exits", []))
    lane.entry_lanes.extend(links.get("entries", []))
    if "other" in links:
        side = lane.right_neighbors if links["right"] else lane.left_neighbors
        side.add(
            feature_id=links["other"],
            self_end_index=points - 1,
            neighbor_end_index=points,
        )
        lane.left_boundaries.add(lane_end_index=200, boundary_feature_id=200, boundary_type=1)


def shard(path, *messages):
    path.write_bytes(b"".join(womd.framed(one.SerializeToString()) for one in messages))
    return path


def scenarionet(message):
    """The message as ScenarioNet 1.2 describes it."""
    kinds = {1: "VEHICLE", 2: "PEDESTRIAN", 3: "CYCLIST"}
    tracks = {
        str(track.id): {
            "type": kinds[track.object_type],
            "state": {
                "position": column(track, "center_x", "center_y", "center_z"),
                "length": column(track, "length")[:, 0],
                "width": column(track, "width")[:, 0],
                "height": column(track, "height")[:, 0],
                "heading": column(track, "heading")[:, 0],
                "velocity": column(track, "velocity_x", "velocity_y"),
                "valid": column(track, "valid")[:, 0] > 0,
            },
            "metadata": {"object_id": str(track.id)},
        }
        for track in message.tracks
    }
    return {
        "id": message.scenario_id,
        "version": "v1.2",
        "length": len(message.timestamps_seconds),
        "tracks": tracks,
        "map_features": {str(one.id): _described(one) for one in message.map_features},
        "dynamic_map_states": {"102": _light(message)},
        "metadata": {
            "scenario_id": message.scenario_id,
            "sdc_id": "12",
            "sdc_track_index": message.sdc_track_index,
            "current_time_index": message.current_time_index,
            "ts": np.array(message.timestamps_seconds),
            "objects_of_interest": [str(one) for one in message.objects_of_interest],
            "tracks_to_predict": {"7": {"track_index": 0, "track_id": "7", "difficulty": 1}},
            "coordinate": "waymo",
            "metadrive_processed": False,
        },
    }


def column(track, *names, dtype="float32"):
    return np.array([[getattr(one, name) for name in names] for one in track.states], dtype)


def _light(message):
    states = [
        {4: "LANE_STATE_STOP", 6: "LANE_STATE_GO"}[step.lane_states[0].state]
        if step.lane_states
        else None
        for step in message.dynamic_map_states
    ]
    return {
        "type": "TRAFFIC_LIGHT",
        "state": {"object_state": states},
        "lane": 102,
        "stop_point": np.array([100.0, 0.0, 0.5], "float32"),
    }


def _described(feature):
    kind = feature.WhichOneof("feature_data")
    one = getattr(feature, kind)
    if kind == "road_line":
        return {"type": "ROAD_LINE_BROKEN_SINGLE_WHITE", "polyline": xyz(one.polyline)}
    if kind == "road_edge":
        return {"type": "ROAD_EDGE_MEDIAN", "polyline": xyz(one.polyline)}
    if kind == "crosswalk":
        return {"type": "CROSSWALK", "polygon": xyz(one.polygon)}
    if kind == "stop_sign":
        return {"type": "STOP_SIGN", "lane": list(one.lane), "position": xyz([one.position])[0]}
    return {
        "type": "LANE_SURFACE_STREET",
        "polyline": xyz(one.polyline),
        "speed_limit_mph": one.speed_limit_mph,
        "interpolating": one.interpolating,
        "entry_lanes": list(one.entry_lanes),
        "exit_lanes": list(one.exit_lanes),
        "left_neighbor": [_neighbour(other) for other in one.left_neighbors],
        "right_neighbor": [_neighbour(other) for other in one.right_neighbors],
        "left_boundaries": [
            {
                "lane_start_index": str(other.lane_start_index),
                "lane_end_index": str(other.lane_end_index),
                "boundary_type": "ROAD_LINE_BROKEN_SINGLE_WHITE",
                "boundary_feature_id": str(other.boundary_feature_id),
            }
            for other in one.left_boundaries
        ],
        "right_boundaries": [],
        "width": np.zeros((len(one.polyline), 2), "float32"),
    }


def _neighbour(other):
    names = ("self_start_index", "self_end_index", "neighbor_start_index", "neighbor_end_index")
    indices = {name: str(getattr(other, name)) for name in names}
    return {"feature_id": str(other.feature_id), **indices, "boundaries": []}


def xyz(points):
    return np.array([(one.x, one.y, one.z) for one in points], "float32")


def gpudrive(message):
    """The message as the newest GPUDrive files (v3) hold it."""
    kinds = {1: "vehicle", 2: "pedestrian", 3: "cyclist"}
    lights = [
        (step, state.lane_states[0])
        for step, state in enumerate(message.dynamic_map_states)
        if state.lane_states
    ]
    return {
        "name": "made_up.json",
        "scenario_id": message.scenario_id,
        "objects": [
            {
                "position": _marked(track, {"x": "center_x", "y": "center_y", "z": "center_z"}),
                "velocity": _marked(track, {"x": "velocity_x", "y": "velocity_y"}),
                "heading": [one.heading if one.valid else -10000.0 for one in track.states],
                "valid": [one.valid for one in track.states],
                "length": track.states[0].length,
                "width": track.states[0].width,
                "height": track.states[0].height,
                "goalPosition": {"x": 0.0, "y": 0.0, "z": 0.0},
                "type": kinds[track.object_type],
                "id": track.id,
                "mark_as_expert": False,
            }
            for track in message.tracks
        ],
        "roads": [_road(feature) for feature in message.map_features],
        "tl_states": {
            "102": {
                "state": [{4: "stop", 6: "go"}[light.state] for _, light in lights],
                "x": [100.0] * len(lights),
                "y": [0.0] * len(lights),
                "z": [0.5] * len(lights),
                "time_index": [step for step, _ in lights],
            }
        },
        "metadata": {
            "sdc_track_index": message.sdc_track_index,
            "objects_of_interest": list(message.objects_of_interest),
            "tracks_to_predict": [{"track_index": 0, "difficulty": 1}],
        },
    }


def _marked(track, names):
    return [
        {axis: getattr(one, name) if one.valid else -10000.0 for axis, name in names.items()}
        for one in track.states
    ]


def _road(feature):
    kind = feature.WhichOneof("feature_data")
    one = getattr(feature, kind)
    points = {"stop_sign": lambda: [one.position], "crosswalk": lambda: one.polygon}.get(
        kind, lambda: one.polyline
    )()
    element = {"lane": 2, "road_line": 6, "road_edge": 16, "stop_sign": 17, "crosswalk": 18}[kind]
    geometry = [{"x": point.x, "y": point.y, "z": point.z} for point in points]
    return {"geometry": geometry, "type": kind, "map_element_id": element, "id": feature.id}


def nocturne_v1(described):
    """GPUDrive's first form: 2-D, degrees, no ids, no height, no metadata."""
    flat = {"name": described["name"], "tl_states": described["tl_states"]}
    flat["objects"] = [
        {
            "position": [{"x": one["x"], "y": one["y"]} for one in thing["position"]],
            "velocity": thing["velocity"],
            "heading": [
                np.degrees(heading) + 360.0 if heading > -100 else heading
                for heading in thing["heading"]
            ],
            **{key: thing[key] for key in ("valid", "length", "width", "goalPosition", "type")},
        }
        for thing in described["objects"]
    ]
    flat["roads"] = [
        {"geometry": [{"x": p["x"], "y": p["y"]} for p in road["geometry"]], "type": road["type"]}
        for road in described["roads"]
    ]
    return flat


def nocturne_early(described):
    """Nocturne's first form: as v1, but dicts of lists."""
    flat = nocturne_v1(described)
    del flat["tl_states"]
    for thing in flat["objects"]:
        for key in ("position", "velocity"):
            thing[key] = {axis: [one[axis] for one in thing[key]] for axis in ("x", "y")}
    return flat
