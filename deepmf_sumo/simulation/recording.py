"""SUMO traffic as recorded scenes: data for training that is free of anybody's licence."""

import hashlib
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deepmf_sumo.datatypes import (
    DT_S,
    FUTURE_STEPS,
    HISTORY_STEPS,
    AgentId,
    Driver,
    Floats,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    Tracks,
    frozen,
)
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.simulation import casting, smoothing
from deepmf_sumo.simulation.configuration import Configuration, read_configuration
from deepmf_sumo.simulation.driver_mix import DriverMix
from deepmf_sumo.simulation.frame import Body, Pose
from deepmf_sumo.simulation.reading import TrafficReader
from deepmf_sumo.simulation.signals import LiveSignals
from deepmf_sumo.simulation.sumo_api import STEP_OPTIONS, SumoApi, running

_STEPS = HISTORY_STEPS + FUTURE_STEPS


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """What to record.

    Attributes:
        config: a .sumocfg with traffic.
        seed: of SUMO, of the drivers, of the choice of AVs.
        start_s, stop_s: of the simulation's time; recording waits until the net has filled.
        every_s: a scene begins so often; scenes overlap where this is less than 9 s.
        diverse: give the drivers different models and tempers, instead of the demand's own types.
        radius_m: agents that come no nearer to the AV than this are left out.
    """

    config: Path
    seed: int
    start_s: float = 60.0
    stop_s: float = 660.0
    every_s: float = 9.0
    diverse: bool = True
    radius_m: float = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    poses: dict[AgentId, tuple[Pose, Driver]]
    signals: dict[str, SignalState]


def record(recording: Recording) -> Iterator[Scene]:
    """Scenes of 91 steps of a SUMO configuration's traffic, in the order of time.

    Vehicles move sideways smoothly (sublane model). Moments without a vehicle that could be the AV
    (there throughout, moving, with others around) give no scene.

    Raises SimulationError where the configuration cannot be run.
    """
    configuration = read_configuration(recording.config)
    if recording.every_s < DT_S:
        raise SimulationError(f"every_s is {recording.every_s}; it must be at least {DT_S} s.")
    road = road_of_net(configuration.net, configuration.additional)
    rng = np.random.default_rng(recording.seed)
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        mix = DriverMix(Path(folder) / "drivers.add.xml", rng) if recording.diverse else None
        with running(_arguments(configuration, recording, mix)) as api:
            yield from _scenes(api, recording, configuration, road, mix, rng)


def _arguments(
    configuration: Configuration, recording: Recording, mix: DriverMix | None
) -> list[str]:
    additional = [str(path) for path in configuration.additional]
    additional += [str(mix.file)] if mix else []
    return [
        *("-c", str(configuration.file)),
        *(("--additional-files", ",".join(additional)) if additional else ()),
        *("--seed", str(recording.seed)),
        *("--lateral-resolution", "0.4"),
        *("--lanechange.duration", "0"),  # SUMO takes only one of the two
        *STEP_OPTIONS,
    ]


def _scenes(
    api: SumoApi,
    recording: Recording,
    configuration: Configuration,
    road: RoadMap,
    mix: DriverMix | None,
    rng: np.random.Generator,
) -> Iterator[Scene]:
    reader = TrafficReader(api)
    links = signal_links(configuration.net)
    lights = LiveSignals(api, links)
    stops = {lane: road.lanes[lane].centre_m[0] for lane in links if lane in road.lanes}
    window: deque[_Moment] = deque(maxlen=_STEPS)
    stride = round(recording.every_s / DT_S)
    begin = round(recording.start_s / DT_S)
    step, taken = round(api.simulation.getTime() / DT_S), 0
    while step < round(recording.stop_s / DT_S):
        api.simulationStep()
        step += 1
        if mix is not None:
            mix.assign(api)
        if step < begin:
            continue
        window.append(_Moment(poses=reader.read(), signals=lights.states()))
        if len(window) == _STEPS and (step - begin + 1 - _STEPS) % stride == 0:
            tracks = _tracks(list(window), reader.body)
            cast = casting.choose(tracks, HISTORY_STEPS - 1, recording.radius_m, rng)
            if cast is not None:
                source = _source(recording, taken)
                name = f"{recording.config.stem}-{recording.seed}-{step * DT_S - 9.0:.1f}s"
                scene = _scene(name, source, road, _signals(list(window), stops), tracks, cast)
                taken += 1
                yield scene
        if api.simulation.getMinExpectedNumber() == 0:
            break


def _tracks(window: list[_Moment], body: Callable[[AgentId], Body]) -> Tracks:
    ids = sorted({agent for moment in window for agent in moment.poses})
    state = np.zeros((len(ids), len(window), 4))
    valid = np.zeros((len(ids), len(window)), bool)
    row_of = {agent: row for row, agent in enumerate(ids)}
    for step, moment in enumerate(window):
        for agent, (pose, _) in moment.poses.items():
            state[row_of[agent], step] = pose.x_m, pose.y_m, pose.heading_rad, pose.speed_mps
            valid[row_of[agent], step] = True
    bodies = [body(agent) for agent in ids]
    raw = Tracks(
        ids=tuple(ids),
        kinds=tuple(one.kind for one in bodies),
        size_m=np.array([one.size_m for one in bodies]).reshape(-1, 3),
        position_m=state[..., :2],
        z_m=np.zeros(valid.shape),
        heading_rad=state[..., 2],
        velocity_mps=state[..., 3:] * np.stack([np.cos(state[..., 2]), np.sin(state[..., 2])], -1),
        valid=valid,
    )
    return smoothing.smooth(raw)


def _signals(window: list[_Moment], stops: dict[str, Floats]) -> Signals:
    state = np.array(
        [[int(moment.signals.get(lane, 0)) for moment in window] for lane in stops], np.uint8
    ).reshape(len(stops), len(window))
    return Signals(
        lane_ids=tuple(stops),
        state=state,
        seen=state > 0,
        stop_m=np.array(list(stops.values())).reshape(-1, 2),
    )


def _source(recording: Recording, record: int) -> Source:
    digest = hashlib.sha256(recording.config.read_bytes())
    digest.update(repr(replace(recording, config=Path())).encode())
    digest.update(str(record).encode())
    file = str(recording.config)
    return Source(dataset="sumo", file=file, record=record, sha256=digest.hexdigest())


def _scene(
    name: str, source: Source, road: RoadMap, signals: Signals, tracks: Tracks, cast: casting.Cast
) -> Scene:
    return Scene(
        name=name,
        source=source,
        dt_s=DT_S,
        now=HISTORY_STEPS - 1,
        timestamps_s=frozen(np.arange(tracks.steps) * DT_S),
        tracks=tracks.select(cast.rows),
        road=road,
        signals=signals,
        av_id=cast.av_id,
        interest=cast.interest,
        to_predict=cast.to_predict,
    )
