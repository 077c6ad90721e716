"""A crossing of two roads with a few vehicles, made in code."""

import numpy as np

from deepmf_sumo.scene import (
    Lane,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    Tracks,
)

STEPS = 91


def lane(name, points, **fields):
    points = np.asarray(points, float)
    return Lane(id=name, kind="street", centre_m=points, z_m=np.zeros(len(points)), **fields)


def straight(start, end, count=100):
    return np.linspace(start, end, count)


def arc(centre, radius, start_deg, end_deg, count=20):
    angle = np.deg2rad(np.linspace(start_deg, end_deg, count))
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def crossing():
    """East-west and south-north, meeting at the origin; a left turn from the west to the north."""
    lanes = [
        lane("west", straight((-150, 0), (-10, 0)), next=("through", "left"), speed_limit_mps=13.9),
        lane("through", straight((-10, 0), (10, 0), 21), next=("east",), interpolating=True),
        lane("left", arc((-10, 10), 10, -90, 0), next=("north",), interpolating=True),
        lane("east", straight((10, 0), (150, 0))),
        lane("south", straight((0, -150), (0, -10)), next=("up",)),
        lane("up", straight((0, -10), (0, 10), 21), next=("north",), interpolating=True),
        lane("north", straight((0, 10), (0, 150))),
    ]
    edge = Polyline(id="e", kind=1, points_m=straight((-150, 6), (150, 6)), z_m=np.zeros(100))
    square = np.array([[12, -4], [15, -4], [15, 4], [12, 4.0]])
    zebra = Polygon(id="z", kind="crosswalk", points_m=square, z_m=np.zeros(4))
    return RoadMap(lanes={each.id: each for each in lanes}, edges=(edge,), polygons=(zebra,))


def driving(start, heading, speed, steps=STEPS):
    """(position, heading, velocity) of constant motion, at the start position at step 10."""
    time = (np.arange(steps) - 10) * 0.1
    direction = np.array([np.cos(heading), np.sin(heading)])
    return (
        np.asarray(start) + speed * time[:, None] * direction,
        np.full(steps, heading),
        np.broadcast_to(speed * direction, (steps, 2)),
    )


def scene(shift=0.0, turn=0.0, av_speed=10.0, labelled=True):
    """The AV from the west, its partner from the south; one parked, one waiting, one walking."""
    agents = {
        "av": ("vehicle", driving((-50, 0), 0.0, av_speed)),
        "south": ("vehicle", driving((0, -45 + shift), np.pi / 2, 9.0)),
        "parked": ("vehicle", driving((-30, 12), 0.0, 0.0)),
        "waiting": ("vehicle", driving((60, 0), 0.0, 0.0)),
        "walker": ("pedestrian", driving((14, -6), np.pi / 2, 1.3)),
        "far": ("vehicle", driving((-140, 0), 0.0, 8.0)),
    }
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    sizes = {"vehicle": (4.8, 2.0, 1.5), "pedestrian": (0.6, 0.6, 1.7)}
    tracks = Tracks(
        ids=tuple(agents),
        kinds=tuple(kind for kind, _ in agents.values()),
        size_m=np.array([sizes[kind] for kind, _ in agents.values()]),
        position_m=np.array([motion[0] @ rotation for _, motion in agents.values()]),
        z_m=np.zeros((len(agents), STEPS)),
        heading_rad=np.array([motion[1] + turn for _, motion in agents.values()]),
        velocity_mps=np.array([motion[2] @ rotation for _, motion in agents.values()]),
        valid=np.ones((len(agents), STEPS), bool),
    )
    state = np.full((1, STEPS), int(SignalState.GO), np.uint8)
    signals = Signals(
        lane_ids=("through",), state=state, seen=state > 0, stop_m=np.array([[-10.0, 0.0]])
    )
    return Scene(
        name=f"crossing-{shift}",
        source=Source(dataset="synthetic", file="-", record=0, sha256=""),
        dt_s=0.1,
        now=10,
        timestamps_s=np.arange(STEPS) * 0.1,
        tracks=tracks,
        road=rotated(crossing(), rotation),
        signals=signals,
        av_id="av",
        interest=("av", "south") if labelled else (),
    )


def rotated(road, rotation):
    """The road with all points turned."""
    lanes = {
        each.id: lane(
            each.id,
            each.centre_m @ rotation,
            next=each.next,
            interpolating=each.interpolating,
            speed_limit_mps=each.speed_limit_mps,
        )
        for each in road.lanes.values()
    }
    edges = tuple(
        Polyline(id=e.id, kind=e.kind, points_m=e.points_m @ rotation, z_m=e.z_m)
        for e in road.edges
    )
    polygons = tuple(
        Polygon(id=p.id, kind=p.kind, points_m=p.points_m @ rotation, z_m=p.z_m)
        for p in road.polygons
    )
    return RoadMap(lanes=lanes, edges=edges, polygons=polygons)


def view(given=None, step=10):
    """What a policy sees of the scene at a step."""
    from deepmf_sumo.scene import View

    given = given or scene()
    return View(
        step=step,
        dt_s=0.1,
        av_id="av",
        history=given.tracks.window(step - 10, step + 1),
        road=given.road,
        signals=given.signals.at(step),
        steps_left=80,
    )
