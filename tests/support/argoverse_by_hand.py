"""A made-up scenario of Argoverse 2, written as av2 does: a pandas table to parquet, a map to JSON.

Two lanes lead east, side by side (100 at y = 0, 101 at y = 3.5), 102 goes on from 100 inside a
junction, 103 leads west on the left of 101, and 104 is a bike lane on the right of 100. The ground
rises by 2 cm a metre from 20 m at x = 0. The AV drives at 10 m/s on 100, car 7 at 12 m/s on 101.
"""

import json
import math

AV_SPEED_MPS = 10.0
SLOPE = 0.02
GROUND_M = 20.0
HALF_M = 1.75
COLUMNS = (
    *("observed", "track_id", "object_type", "object_category", "timestep"),
    *("position_x", "position_y", "heading", "velocity_x", "velocity_y"),
)


def scenario(folder, name="abc", steps=110, tracks=None, **changes):
    """Write a scenario's folder; ``tracks`` as of `track`, ``changes`` of the map. The folder."""
    import pandas as pd

    folder.mkdir(parents=True, exist_ok=True)
    rows = [row for each in tracks or usual(steps) for row in each]
    table = pd.DataFrame(rows, columns=COLUMNS)
    table["scenario_id"] = name
    table["start_timestamp"] = 3.15986559459579e17
    table["end_timestamp"] = 3.15986559459579e17 + (steps - 1) * 1e8
    table["num_timestamps"] = steps
    table["focal_track_id"] = "7"
    table["city"] = "austin"
    table["map_id"] = 74806
    table["slice_id"] = "7bef7e1f"
    table.to_parquet(folder / f"scenario_{name}.parquet")
    write_map(folder, name, road() | changes)
    return folder


def write_map(folder, name, described):
    (folder / f"log_map_archive_{name}.json").write_text(json.dumps(described))


def usual(steps=110):
    return [
        track("7", "vehicle", 3, (5.0, 3.5), (12.0, 0.0), range(steps)),
        track("8", "cyclist", 2, (-10.0, -3.0), (4.0, 0.0), range(10, steps)),
        track("9", "pedestrian", 1, (60.0, -8.0), (0.0, 1.2), range(30)),
        track("10", "bus", 0, (150.0, 7.0), (-6.0, 0.0), range(40, steps)),
        track("11", "motorcyclist", 2, (30.0, 3.5), (12.0, 0.0), range(steps)),
        track("12", "static", 0, (40.0, -6.0), (0.0, 0.0), range(steps)),
        track("AV", "vehicle", 1, (0.0, 0.0), (AV_SPEED_MPS, 0.0), range(steps)),
    ]


def track(agent, kind, category, start, velocity, seen):
    """The rows of a road user that moves evenly; ``start`` is its place at step 0."""
    heading = math.atan2(velocity[1], velocity[0]) if any(velocity) else 0.5
    return [
        (
            *(step < 50, agent, kind, category, step),
            *(start[0] + 0.1 * step * velocity[0], start[1] + 0.1 * step * velocity[1]),
            *(heading, *velocity),
        )
        for step in seen
    ]


def road():
    lanes = {
        100: segment(100, 0.0, 0, 100, left=101, right=104, after=[102], before=[99]),
        101: segment(101, 3.5, 0, 100, left=103, right=100, marks=("DOUBLE_SOLID_YELLOW", "NONE")),
        102: segment(102, 0.0, 100, 150, before=[100], inside=True, centre=True),
        103: segment(103, 7.0, 100, 0, left=101),
        104: segment(104, -3.0, 0, 100, left=100, kind="BIKE", half=1.25),
    }
    lanes[101]["right_lane_mark_type"] = lanes[100]["left_lane_mark_type"] = "DASHED_WHITE"
    return {
        "lane_segments": {str(key): one for key, one in lanes.items()},
        "pedestrian_crossings": {
            "300": {"id": 300, "edge1": line(60, 60, -2, 9), "edge2": line(63, 63, -2, 9)}
        },
        "drivable_areas": {
            "400": {"id": 400, "area_boundary": line(0, 150, -5, -5) + line(150, 0, 9, 9)}
        },
    }


def segment(number, y, start, end, **its):
    """A lane from x = start to x = end, whose boundaries have points of their own each."""
    half = its.get("half", HALF_M) * (1 if end > start else -1)
    left, right = its.get("marks", ("NONE", "NONE"))
    middle = (start + end) / 2
    written = {
        "id": number,
        "is_intersection": its.get("inside", False),
        "lane_type": its.get("kind", "VEHICLE"),
        "left_lane_boundary": line(start, end, y + half, y + half),
        "left_lane_mark_type": left,
        "right_lane_boundary": [
            *line(start, middle, y - half, y - half),
            *line(end, end, y - half, y - half)[:1],
        ],
        "right_lane_mark_type": right,
        "successors": its.get("after", []),
        "predecessors": its.get("before", []),
        "right_neighbor_id": its.get("right"),
        "left_neighbor_id": its.get("left"),
    }
    if its.get("centre"):  # without heights, as in the data set
        written["centerline"] = [one | {"z": 0.0} for one in line(start, end, y + 0.1, y + 0.1)]
    return written


def line(x0, x1, y0, y1):
    return [{"x": float(x), "y": float(y), "z": ground_m(x)} for x, y in ((x0, y0), (x1, y1))]


def ground_m(x):
    return GROUND_M + SLOPE * x
