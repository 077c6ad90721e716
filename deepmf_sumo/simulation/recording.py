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
    SIMULATED,
    AgentId,
    Floats,
    RoadMap,
    Scene,
    SignalLink,
    Signals,
    SignalState,
    Source,
    Tracks,
    frozen,
)
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry import angles, sumo_frame
from deepmf_sumo.network.excerpt import Excerpts
from deepmf_sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.simulation import casting, smoothing, turn_speeds
from deepmf_sumo.simulation.configuration import Configuration, read_configuration
from deepmf_sumo.simulation.driver_mix import DriverMix
from deepmf_sumo.simulation.frame import Body
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
        avs: a moment gives up to so many scenes, each with an AV of its own.
        radius_m: agents that come no nearer to the AV than this are left out.
        map_radius_m: so is what of the road lies no nearer to the AV's way.
        name: how the scenes' names begin, and what they name as their source; None takes the
            configuration's name and the seed, and its file.
    """

    config: Path
    seed: int
    start_s: float = 60.0
    stop_s: float = 660.0
    every_s: float = 9.0
    diverse: bool = True
    avs: int = 1
    radius_m: float = 100.0
    map_radius_m: float = 150.0
    name: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    states: dict[AgentId, tuple[float, float, float, float, float]]
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
    if mix is not None:
        turn_speeds.slow_down(api, road)
    reader = TrafficReader(api)
    links = signal_links(configuration.net)
    lights = LiveSignals(api, links)
    scenes = _Scenes(recording, road, links)
    window: deque[_Moment] = deque(maxlen=_STEPS)
    stride = round(recording.every_s / DT_S)
    begin = round(recording.start_s / DT_S)
    step = round(api.simulation.getTime() / DT_S)
    while step < round(recording.stop_s / DT_S):
        api.simulationStep()
        step += 1
        if mix is not None:
            mix.assign(api)
        if step < begin:
            continue
        since = (step - begin + 1 - _STEPS) % stride
        if -since % stride < _STEPS:  # nothing is read that no scene will hold
            window.append(_Moment(states=reader.states(), signals=lights.states()))
        if len(window) == _STEPS and since == 0:
            yield from scenes.of(list(window), reader.body, step * DT_S - 9.0, rng)
        if api.simulation.getMinExpectedNumber() == 0:
            break


class _Scenes:
    """Makes scenes of 91 moments; what does not change from scene to scene is kept."""

    def __init__(
        self, recording: Recording, road: RoadMap, links: dict[str, tuple[SignalLink, ...]]
    ) -> None:
        self._recording = recording
        self._excerpts = Excerpts(road)
        self._stops = {lane: road.lanes[lane].centre_m[0] for lane in links if lane in road.lanes}
        self._digest = hashlib.sha256(recording.config.read_bytes())
        self._digest.update(repr(replace(recording, config=Path())).encode())
        self._taken = 0

    def of(
        self,
        window: list[_Moment],
        body: Callable[[AgentId], Body],
        time_s: float,
        rng: np.random.Generator,
    ) -> Iterator[Scene]:
        """A scene for each AV that can be cast."""
        recording = self._recording
        tracks = _tracks(window, body)
        casts = casting.choose(tracks, HISTORY_STEPS - 1, recording.radius_m, rng, recording.avs)
        first = recording.name or f"{recording.config.stem}-{recording.seed}"
        for number, cast in enumerate(casts):
            name = f"{first}-{time_s:.1f}s" + (f"-{number}" if recording.avs > 1 else "")
            yield self._scene(name, window, tracks, cast)
            self._taken += 1

    def _scene(self, name: str, window: list[_Moment], tracks: Tracks, cast: casting.Cast) -> Scene:
        way_m = tracks.position_m[tracks.row(cast.av_id), ::5]
        road = self._excerpts.near(way_m, self._recording.map_radius_m)
        stops = {lane: stop for lane, stop in self._stops.items() if lane in road.lanes}
        return Scene(
            name=name,
            source=self._source(),
            dt_s=DT_S,
            now=HISTORY_STEPS - 1,
            timestamps_s=frozen(np.arange(tracks.steps) * DT_S),
            tracks=tracks.select(cast.rows),
            road=road,
            signals=_signals(window, stops),
            av_id=cast.av_id,
            interest=cast.interest,
            to_predict=cast.to_predict,
        )

    def _source(self) -> Source:
        digest = self._digest.copy()
        digest.update(str(self._taken).encode())
        file = self._recording.name or str(self._recording.config)
        return Source(dataset=SIMULATED, file=file, record=self._taken, sha256=digest.hexdigest())


def _tracks(window: list[_Moment], body: Callable[[AgentId], Body]) -> Tracks:
    ids = sorted({agent for moment in window for agent in moment.states})
    state = np.zeros((len(ids), len(window), 5))
    valid = np.zeros((len(ids), len(window)), bool)
    row_of = {agent: row for row, agent in enumerate(ids)}
    for step, moment in enumerate(window):
        rows = [row_of[agent] for agent in moment.states]
        state[rows, step] = list(moment.states.values()) or np.zeros((0, 5))
        valid[rows, step] = True
    bodies = [body(agent) for agent in ids]
    size = np.array([one.size_m for one in bodies]).reshape(-1, 3)
    centre, heading = sumo_frame.from_sumo(state[..., :2], state[..., 2], size[:, None, 0])
    raw = Tracks(
        ids=tuple(ids),
        kinds=tuple(one.kind for one in bodies),
        size_m=size,
        position_m=centre,
        z_m=state[..., 4],
        heading_rad=heading,
        velocity_mps=state[..., 3:4] * angles.unit(heading),
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
