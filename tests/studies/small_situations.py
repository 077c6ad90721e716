"""Small situations without SUMO: an AV on a path, others that move as given, and what happens."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from deepmf_sumo.scene import RoadMap, SignalState, Tracks, View
from deepmf_sumo.scene.geometry import boxes, polylines

from tests.support.simulated_worlds import CAR, lane

DT_S = 0.1
LIMIT_MPS = 15.0


def road():
    """The AV's lane along x, one beside it, and one of the other direction."""
    lanes = [
        lane("own", (-200, 0), (600, 0)),
        lane("beside", (-200, 3.2), (600, 3.2)),
        lane("oncoming", (600, 6.4), (-200, 6.4)),
    ]
    return RoadMap(lanes={one.id: one for one in lanes})


STRAIGHT = np.array([[-200.0, 0.0], [600.0, 0.0]])
ARC = np.linspace(0, np.pi / 2, 40)
BEND = np.concatenate(
    [[[-200.0, 0.0]], np.column_stack([30 * np.sin(ARC) + 30, 30 - 30 * np.cos(ARC)]), [[60, 300]]]
)


def still(x, y, heading=0.0):
    return lambda t: (x, y, heading, 0.0)


def steady(x, y, heading, speed, start_s=0.0):
    def motion(t):
        way = speed * max(t - start_s, 0.0)
        return x + way * np.cos(heading), y + way * np.sin(heading), heading, speed

    return motion


def braking(x, speed, at_s, decel, y=0.0):
    def motion(t):
        braked = min(max(t - at_s, 0.0), speed / decel)
        way = speed * min(t, at_s + braked) - decel * braked**2 / 2
        return x + way, y, 0.0, speed - decel * braked

    return motion


def cutting_in(x, speed, at_s, for_s=2.0, y=3.2):
    def motion(t):
        share = np.clip((t - at_s) / for_s, 0.0, 1.0)
        aside = -y / for_s if 0 < share < 1 else 0.0
        heading = float(np.arctan2(aside, speed))
        return x + speed * t, y * (1 - share), heading, float(np.hypot(speed, aside))

    return motion


@dataclass(frozen=True, kw_only=True)
class Situation:
    """Others: id -> (motion, size); a motion gives x, y, heading, speed at seconds."""

    others: dict = field(default_factory=dict)
    speed_mps: float = 13.0
    seconds: float = 8.0
    path_m: np.ndarray = field(default_factory=lambda: STRAIGHT)
    signals: dict = field(default_factory=dict)
    seed: int = 0


@dataclass
class Driven:
    """What happened: whether the AV hit anybody, the least gap, commands, and the AV's speeds."""

    hit: bool = False
    nearest_m: float = np.inf
    commands: list = field(default_factory=list)
    speeds: list = field(default_factory=list)

    @property
    def hardest(self):
        return float(-np.diff(self.speeds).min() / DT_S)

    @property
    def first_braking_s(self):
        """When it first braked by more than 1 m/s2."""
        braked = np.flatnonzero(np.diff(self.speeds) < -1.0 * DT_S)
        return float(braked[0]) * DT_S if len(braked) else np.inf


def drive(planner, situation, road_map):
    planner.reset(SimpleNamespace(net=None, seed=situation.seed), np.random.default_rng(0))
    line = polylines.Measured(situation.path_m)
    start = polylines.project(situation.path_m, np.zeros(2)).along_m
    along, speed, past = float(start), situation.speed_mps, []
    # before the first step the AV drove at its speed
    for step in range(-10, round(situation.seconds / DT_S)):
        time = step * DT_S
        place = start + time * speed if step < 0 else along
        past.append(_states(line, place, speed, situation, time))
        past = past[-11:]
        if step < 0:
            continue
        view = _view(situation, past, step, line, along, road_map)
        if not step:
            result = Driven(speeds=[speed])
        result.nearest_m = min(result.nearest_m, _gap_m(view))
        if result.nearest_m == 0.0:
            result.hit = True
            return result
        command = planner.act(view)
        faster = _speed_after(command, planner.model, speed)
        along, speed = along + (speed + faster) / 2 * DT_S, faster
        result.commands.append(command)
        result.speeds.append(speed)
    return result


def _states(line, along, speed, situation, time):
    point, heading = line.at(np.array([along]))
    rows = [(*point[0], float(heading[0]), speed)]
    rows += [motion(time) for motion, _ in situation.others.values()]
    return np.array(rows)


def _view(situation, past, step, line, along, road_map):
    state = np.stack(past, axis=1)
    sizes = [CAR, *(size for _, size in situation.others.values())]
    unit = np.stack([np.cos(state[..., 2]), np.sin(state[..., 2])], -1)
    tracks = Tracks(
        ids=("av", *situation.others),
        kinds=tuple(_kind(size[0]) for size in sizes),
        size_m=np.array(sizes),
        position_m=state[..., :2],
        z_m=np.zeros(state.shape[:2]),
        heading_rad=state[..., 2],
        velocity_mps=state[..., 3:] * unit,
        valid=np.ones(state.shape[:2], bool),
    )
    ahead = line.at(along + CAR[0] / 2 + np.arange(0.0, 121.0, 2.0))[0]
    return View(
        step=step, dt_s=DT_S, av_id="av", history=tracks, road=road_map,
        signals=situation.signals, steps_left=80, av_path_m=ahead,
    )  # fmt: skip


def _gap_m(view):
    tracks = view.history
    now = tracks.position_m[:, -1], tracks.heading_rad[:, -1], tracks.size_m[:, :2]
    gaps = boxes.gap(*(part[0] for part in now), *(part[1:] for part in now))
    return float(gaps.min(initial=np.inf))


def _speed_after(command, model, speed):
    """As the simulation would: SUMO's IDM by its formula, with nobody on the lane."""
    if command.kind == "speed":
        return command.speed_mps
    use = 0.0
    if command.kind == "leader":
        brisk = 2 * np.sqrt(model.accel_mps2 * model.decel_mps2)
        closing = speed * (speed - command.leader_mps) / brisk
        wanted = model.gap_m + max(0.0, speed * model.headway_s + closing)
        use = wanted / max(command.gap_m, 0.1)
    accel = model.accel_mps2 * (1 - (speed / LIMIT_MPS) ** 4 - use**2)
    return max(0.0, speed + max(accel, -model.emergency_mps2) * DT_S)


TRUCK = (12.0, 2.5, 3.5)
PERSON = (0.6, 0.6, 1.7)
YELLOW = {"own": SignalState.CAUTION}
__all__ = [
    "BEND", "CAR", "PERSON", "TRUCK", "YELLOW", "Driven", "Situation", "braking", "cutting_in",
    "drive", "road", "steady", "still",
]  # fmt: skip


def _kind(length_m):
    return "pedestrian" if length_m < 1 else "cyclist" if length_m < 2 else "vehicle"
