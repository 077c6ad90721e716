"""Scenes made by hand: a straight road of two lanes, and a minor road that crosses a major one."""

from pathlib import Path

import numpy as np

from deepmf_sumo.scene import (
    Lane,
    Neighbour,
    RecordedCase,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    StopSign,
    Tracks,
)
from deepmf_sumo.sumo import network

LANE_M = 3.2
STEPS = 91
NOW = 10
CAR = (4.6, 2.0, 1.5)


def lane(name, start, end, **more):
    points = np.linspace(start, end, 41)
    return Lane(
        id=name, kind="street", centre_m=points, z_m=np.zeros(41), speed_limit_mps=15.0, **more
    )


def straight_road():
    def beside(name):
        return (Neighbour(lane_id=name, self_start=0, self_end=40, other_start=0, other_end=40),)

    right = lane("right", (0, 0), (400, 0), left=beside("left"))
    left = lane("left", (0, LANE_M), (400, LANE_M), right=beside("right"))
    return RoadMap(lanes={"right": right, "left": left})


def crossing_road():
    """The AV comes from the south, the major road runs from west to east."""
    lanes = [
        lane("south", (0, -150), (0, -10), next=("north_in",)),
        lane(
            "north_in", (0, -10), (0, 10), interpolating=True, previous=("south",), next=("north",)
        ),
        lane("north", (0, 10), (0, 200), previous=("north_in",)),
        lane("west", (-300, 0), (-10, 0), next=("east_in",)),
        lane("east_in", (-10, 0), (10, 0), interpolating=True, previous=("west",), next=("east",)),
        lane("east", (10, 0), (300, 0), previous=("east_in",)),
    ]
    sign = StopSign(id="stop", position_m=np.array([0, -10.0]), z_m=0.0, lane_ids=("south",))
    return RoadMap(lanes={one.id: one for one in lanes}, stop_signs=(sign,))


def straight_motion(x, y, heading, speed, steps=STEPS):
    """(T, 4) x, y, heading, speed at constant velocity; (x, y) at the current step."""
    way = speed * 0.1 * (np.arange(steps) - NOW)
    return np.column_stack(
        [
            x + way * np.cos(heading),
            y + way * np.sin(heading),
            np.full(steps, heading),
            np.full(steps, speed),
        ]
    )


def scene_of(road, motions, kinds=None, valid=None, signals=None):
    """``motions``: id -> (T, 4); the first is the AV."""
    ids = tuple(motions)
    state = np.array(list(motions.values()))
    unit = np.stack([np.cos(state[..., 2]), np.sin(state[..., 2])], -1)
    tracks = Tracks(
        ids=ids,
        kinds=tuple((kinds or {}).get(name, "vehicle") for name in ids),
        size_m=np.array(
            [CAR if (kinds or {}).get(n, "vehicle") == "vehicle" else (0.8, 0.8, 1.7) for n in ids]
        ),
        position_m=state[..., :2],
        z_m=np.zeros(state.shape[:2]),
        heading_rad=state[..., 2],
        velocity_mps=state[..., 3:] * unit,
        valid=np.ones(state.shape[:2], bool) if valid is None else valid,
    )
    empty = Signals(
        lane_ids=(), state=np.zeros((0, STEPS)), seen=np.zeros((0, STEPS)), stop_m=np.zeros((0, 2))
    )
    return Scene(
        name="made-by-hand",
        source=Source(dataset="made", file="", record=0, sha256=""),
        dt_s=0.1,
        now=NOW,
        timestamps_s=np.arange(STEPS) * 0.1,
        tracks=tracks,
        road=road,
        signals=signals or empty,
        av_id=ids[0],
    )


def case_of(scene, folder: Path, traffic="log", steps=80):
    return RecordedCase(
        name=scene.name,
        road=scene.road,
        av_id=scene.av_id,
        duration_steps=steps,
        traffic=traffic,
        seed=1,
        scene=scene,
        net=network.convert(scene, folder / "net"),
    )


def red_light(road, lane_id):
    return Signals(
        lane_ids=(lane_id,),
        state=np.full((1, STEPS), int(SignalState.STOP)),
        seen=np.ones((1, STEPS), bool),
        stop_m=road.lanes[lane_id].centre_m[:1],
    )
