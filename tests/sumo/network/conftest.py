"""Synthetic scenes to convert: a signalled crossing with everything that is hard about maps."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene import (
    Lane,
    Neighbour,
    Polygon,
    RoadMap,
    Scene,
    Signals,
    Source,
    StopSign,
    Tracks,
)
from deepmf_sumo.scene.geometry import polylines

STEPS = 91
ARM_M, EDGE_M = 90.0, 12.0


def make_lane(lane_id, points, z=0.0, **others) -> Lane:
    """A lane with points half a metre apart, as recordings have them."""
    points = np.asarray(points, float)
    centre = polylines.resample(points, 0.5) if len(points) > 1 else points
    heights = np.full(len(centre), z)
    return Lane(
        id=lane_id, kind=others.pop("kind", "street"), centre_m=centre, z_m=heights, **others
    )


def make_road(lanes, joins, **others) -> RoadMap:
    """A road of lanes and their joins."""
    return RoadMap(
        lanes={
            lane.id: replace(
                lane,
                next=tuple(b for a, b in joins if a == lane.id),
                previous=tuple(a for a, b in joins if b == lane.id),
            )
            for lane in lanes
        },
        **others,
    )


def make_scene(road, path=((-60.0, -1.75), (30.0, -1.75)), signalled=(), name="synthetic") -> Scene:
    """A scene with nobody but the AV, which drives evenly along a path."""
    path = np.asarray(path, float)
    length = polylines.arc_lengths(path)[-1]
    along = np.linspace(0.0, length, STEPS)
    position, heading = polylines.points_at(path, along)
    speed = length / (0.1 * (STEPS - 1))
    velocity = speed * np.column_stack([np.cos(heading), np.sin(heading)])
    tracks = Tracks(
        ids=("av",),
        kinds=("vehicle",),
        size_m=np.array([[4.8, 2.0, 1.6]]),
        position_m=position[None],
        z_m=np.zeros((1, STEPS)),
        heading_rad=heading[None],
        velocity_mps=velocity[None],
        valid=np.ones((1, STEPS), bool),
    )
    return Scene(
        name=name,
        source=Source(dataset="test", file="none", record=0, sha256="0" * 64),
        dt_s=0.1,
        now=10,
        timestamps_s=np.arange(STEPS) * 0.1,
        tracks=tracks,
        road=road,
        signals=Signals(
            lane_ids=tuple(signalled),
            state=np.full((len(signalled), STEPS), 4),
            seen=np.ones((len(signalled), STEPS), bool),
            stop_m=np.array([road.lanes[key].centre_m[0] for key in signalled]).reshape(-1, 2),
        ),
        av_id="av",
    )


def _turned(points, quarter):
    cos, sin = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
    return np.asarray(points, float) @ np.array([[cos, sin], [-sin, cos]])


def crossing_lanes(own_lane=1.75):
    """Four arms 0..3 (towards E, N, W, S): `in`, `out`, and the ways `S`, `L`, `R` between them."""
    lanes, joins = [], []
    angle = np.linspace(0.0, np.pi / 2, 30)
    for arm in range(4):
        # Arm 0 arrives from the west, driving east, below the axis.
        arrive = [(-ARM_M, -own_lane), (-EDGE_M, -own_lane)]
        leave = [(EDGE_M, -own_lane), (ARM_M, -own_lane)]
        straight = [(-EDGE_M, -own_lane), (EDGE_M, -own_lane)]
        wide, tight = EDGE_M + own_lane, EDGE_M - own_lane
        left = np.column_stack([-EDGE_M + wide * np.sin(angle), EDGE_M - wide * np.cos(angle)])
        right = np.column_stack([-EDGE_M + tight * np.sin(angle), -EDGE_M + tight * np.cos(angle)])
        for key, points in (("in", arrive), ("out", leave)):
            lanes.append(make_lane(f"{key}{arm}", _turned(points, arm), speed_limit_mps=15.0))
        for key, points, to in (("S", straight, 0), ("L", left, 1), ("R", right, 3)):
            lanes.append(make_lane(f"{key}{arm}", _turned(points, arm), interpolating=True))
            joins += [(f"in{arm}", f"{key}{arm}"), (f"{key}{arm}", f"out{(arm + to) % 4}")]
    return lanes, joins


@pytest.fixture(scope="session")
def crossing() -> Scene:
    """A signalled crossing with a one-point lane, a merge, a bike lane and an overpass."""
    lanes, joins = crossing_lanes()
    lanes += [
        make_lane("point", [(ARM_M, -1.75)]),
        make_lane("far", [(ARM_M, -1.75), (ARM_M + 60, -1.75)]),
        make_lane("ramp", [(30.0, -30.0), (70.0, -12.0), (ARM_M, -1.75)]),
        make_lane("over", [(50.0, -80.0), (50.0, 80.0)], z=7.0, kind="freeway"),
        make_lane("bike", [(-ARM_M, -4.6), (-EDGE_M, -4.6)], kind="bike"),
        make_lane("beside", [(-ARM_M, -5.25 - 3.5), (-EDGE_M, -5.25 - 3.5)]),
    ]
    joins += [("out0", "point"), ("point", "far"), ("ramp", "far")]
    road = make_road(
        lanes,
        joins,
        polygons=(
            Polygon(
                id="9",
                kind="crosswalk",
                points_m=np.array([(-16, -8), (-13, -8), (-13, 8), (-16, 8)]),
                z_m=np.zeros(4),
            ),
        ),
    )
    return make_scene(road, signalled=[f"{way}{arm}" for arm in range(4) for way in "SL"])


@pytest.fixture(scope="session")
def two_lanes() -> RoadMap:
    """A street of two lanes, right and left, in two sections, and a dead end."""

    def beside(lane_id, side):
        last = 160
        neighbour = Neighbour(
            lane_id=lane_id, self_start=0, self_end=last, other_start=0, other_end=last
        )
        return {side: (neighbour,)}

    lanes = [
        make_lane("r1", [(0, 0), (80, 0)], **beside("l1", "left")),
        make_lane("l1", [(0, 3.5), (80, 3.5)], **beside("r1", "right")),
        make_lane("r2", [(80, 0), (160, 0)], **beside("l2", "left")),
        make_lane("l2", [(80, 3.5), (160, 3.5)], **beside("r2", "right")),
    ]
    return make_road(lanes, [("r1", "r2"), ("l1", "l2")])


@pytest.fixture(scope="session")
def scene_of() -> Callable[..., Scene]:
    """`make_scene`."""
    return make_scene


@pytest.fixture(scope="session")
def road_of() -> Callable[..., RoadMap]:
    """`make_road` of (id, points, keywords)."""

    def build(rows, joins, **others):
        return make_road(
            [make_lane(key, points, **more) for key, points, more in rows], joins, **others
        )

    return build


@pytest.fixture(scope="session")
def stop_crossing() -> Callable[[int], Scene]:
    """The crossing with stop signs at the first arms."""

    def build(signs):
        lanes, joins = crossing_lanes()
        stops = tuple(
            StopSign(
                id=f"s{arm}",
                position_m=_turned([(-EDGE_M, -4.0)], arm)[0],
                z_m=0.0,
                lane_ids=(f"in{arm}",),
            )
            for arm in range(signs)
        )
        return make_scene(make_road(lanes, joins, stop_signs=stops))

    return build
