"""One made-up scene as ScenarioNet's converters of several data sets would describe it.

Two lanes lead east side by side. From the left one a curve leads north, and a lane goes on from it.
A lane beside them leads west. The AV drives east at 10 m/s, a car beside it at 8 m/s, and a cone
stands at the roadside.
"""

import numpy as np

STEPS = 91
DT = 0.1
RADIUS = 10.0


def straight(start, end):
    start, end = np.array(start, float), np.array(end, float)
    count = round(np.hypot(*(end - start))) + 1
    return start + (end - start) * np.linspace(0, 1, count)[:, None]


def curve():
    """Left, from (100, 3.5) to (110, 13.5)."""
    angle = np.linspace(0, np.pi / 2, 17)
    return np.column_stack([100 + RADIUS * np.sin(angle), 3.5 + RADIUS * (1 - np.cos(angle))])


LANES = {
    "right": straight((0, 0), (100, 0)),
    "left": straight((0, 3.5), (100, 3.5)),
    "turn": curve(),
    "north": straight((110, 13.5), (110, 80)),
    "west": straight((100, 7), (0, 7)),
}
DIRECTIONS = {
    "right": np.zeros(101),
    "left": np.zeros(101),
    "turn": np.linspace(0, np.pi / 2, 17),
    "north": np.full(len(LANES["north"]), np.pi / 2),
    "west": np.full(101, np.pi),
}
NEXT = {"left": ["turn"], "turn": ["north"]}
PREVIOUS = {"turn": ["left"], "north": ["turn"]}
CONNECTOR = {"turn"}
SQUARE = np.array([[20, -9], [30, -9], [30, -5], [20, -5], [20, -9]], float)


def lane(name, **more):
    kind = "LANE_SURFACE_UNSTRUCTURE" if name in CONNECTOR else "LANE_SURFACE_STREET"
    return {
        "type": kind,
        "polyline": LANES[name].copy(),
        "entry_lanes": list(PREVIOUS.get(name, [])),
        "exit_lanes": list(NEXT.get(name, [])),
        **more,
    }


def moving(start, speed, size, kind="VEHICLE"):
    at = np.zeros((STEPS, 3))
    at[:, 0] = start[0] + speed * DT * np.arange(STEPS)
    at[:, 1] = start[1]
    sizes = {
        name: np.full((STEPS, 1), one)
        for name, one in zip(("length", "width", "height"), size, strict=True)
    }
    return {
        "type": kind,
        "state": {
            "position": at,
            "heading": np.zeros(STEPS),
            "velocity": np.tile([float(speed), 0.0], (STEPS, 1)),
            "valid": np.ones(STEPS),
            **sizes,
        },
        "metadata": {"type": kind, "track_length": STEPS, "object_id": "x"},
    }


def described(dataset, features, av="ego", **metadata):
    return {
        "id": "scene-1",
        "version": dataset,
        "length": STEPS,
        "tracks": {
            av: moving((5, 0), 10, (4.9, 1.9, 1.6)),
            "car": moving((5, 3.5), 8, (4.5, 1.8, 1.5)),
            "cone": moving((40, -4), 0, (0.4, 0.4, 0.8), "TRAFFIC_CONE"),
        },
        "dynamic_map_states": {},
        "map_features": features,
        "metadata": {
            "dataset": dataset,
            "scenario_id": "scene-1",
            "metadrive_processed": False,
            "coordinate": "right-handed",
            "sdc_id": av,
            "ts": np.arange(STEPS) * DT,
            **metadata,
        },
    }


def areas():
    return {
        "walk_1": {"type": "ROAD_EDGE_SIDEWALK", "polygon": SQUARE},
        "walk_2": {"type": "ROAD_EDGE_SIDEWALK", "polygon": SQUARE + 20.0},
        "zebra": {"type": "CROSSWALK", "polygon": SQUARE},
        "boundary_0": {"type": "ROAD_LINE_SOLID_SINGLE_WHITE", "polyline": LANES["right"] - 2.0},
        "divider": {"type": "ROAD_LINE_BROKEN_SINGLE_WHITE", "polyline": LANES["right"] + 1.75},
    }


def nuscenes():
    features = {}
    for name, points in LANES.items():
        features[name] = lane(name, polyline=np.column_stack([points, DIRECTIONS[name]]))
        if name in CONNECTOR:
            features[name]["speed_limit_kmh"] = 100
        else:
            features[name] |= {"left_neighbor": [], "right_neighbor": [], "polygon": SQUARE}
    found = described("nuscenes", features | areas(), ts=np.arange(STEPS + 1) * DT, sample_rate=0.1)
    ego, car = found["tracks"]["ego"]["state"], found["tracks"]["car"]["state"]
    ego["length"], ego["width"] = ego["width"], ego["length"]
    ego["velocity"][-1] = 0.0
    for name in ("position", "heading", "velocity", "valid"):
        car[name][60:70] = 0.0
    car["velocity"][[59, 90]] = 0.0
    return found


def nuplan():
    beside = {"right": (["left"], []), "left": ([], ["right"])}
    features = {}
    for name in LANES:
        left, right = beside.get(name, ([], []))
        features[name] = lane(
            name, left_neighbor=left, right_neighbor=right, speed_limit_mps=11.0, polygon=SQUARE
        )
    features["west"]["speed_limit_mps"] = None
    found = described("nuplan", features | areas())
    light = ["TRAFFIC_LIGHT_UNKNOWN"] * 10 + ["TRAFFIC_LIGHT_RED"] * 40
    light += ["TRAFFIC_LIGHT_GREEN"] * 30 + ["TRAFFIC_LIGHT_YELLOW"] * 11
    found["dynamic_map_states"]["turn"] = {
        "type": "TRAFFIC_LIGHT",
        "state": {"object_state": light},
        "stop_point": [float(one) for one in LANES["turn"][8]],
        "lane": "turn",
        "metadata": {"track_length": STEPS, "type": None, "object_id": "turn"},
    }
    return found


def argoverse():
    features = {}
    for name, points in LANES.items():
        some = points[np.linspace(0, len(points) - 1, 10).round().astype(int)]
        height = 7.0 + 0.01 * some[:, :1]
        features[name] = lane(
            name,
            type="LANE_SURFACE_STREET",
            polyline=np.column_stack([some, height]).astype("float32"),
            speed_limit_mph=85.0,
            speed_limit_kmh=136.79,
            interpolating=True,
            left_neighbor=[],
            right_neighbor=[],
            left_boundaries=[],
            right_boundaries=[],
        )
    features["7"] = {"type": "UNKNOWN_LINE", "polyline": LANES["right"] + 1.75}
    return described("av2", features, av="AV", current_time_index=49)


def metadrive():
    """A procedurally generated scene: the exits of a road are all lanes of the next one."""
    features = {}
    for name in LANES:
        features[name] = lane(name, left_neighbor=[], right_neighbor=[], speed_limit_kmh=1000)
    features["right"] |= {"left_neighbor": ["left"], "exit_lanes": ["turn"]}
    features["left"]["right_neighbor"] = ["right"]
    features["turn"] |= {"entry_lanes": ["right", "left"]}
    features["0_line"] = {
        "type": "ROAD_LINE_BROKEN_SINGLE_WHITE",
        "polyline": LANES["right"] + 1.75,
        "speed_limit_kmh": 1000,
    }
    features["0"] = {"type": "ROAD_EDGE_SIDEWALK", "polygon": SQUARE, "height": 0.1}
    found = described(
        "metadrive", features, metadrive_processed=True, coordinate="metadrive", scenario_id=3
    )
    found["version"] = "MetaDrive v0.4.3"
    del found["tracks"]["cone"]["state"]["length"], found["tracks"]["cone"]["state"]["width"]
    return found


def mirrored(found):
    """The scene in a frame whose y axis points to the right."""
    for one in found["map_features"].values():
        for key in ("polyline", "polygon"):
            if key in one:
                one[key] = one[key] * [1, -1]
    for track in found["tracks"].values():
        state = track["state"]
        state["position"] = state["position"] * [1, -1, 1]
        state["velocity"] = state["velocity"] * [1, -1]
        state["heading"] = -state["heading"]
    return found
