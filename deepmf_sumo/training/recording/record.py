"""Recording of a SUMO configuration's traffic as scenes."""

import tempfile
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, HISTORY_STEPS, Lane, RoadMap, Scene
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.sumo.simulation import sumo_words
from deepmf_sumo.sumo.simulation.observation import LiveSignals
from deepmf_sumo.sumo.simulation.road_users import TrafficReader
from deepmf_sumo.sumo.simulation.sumo_api import STEP_OPTIONS, SumoApi, running, sumo_seed
from deepmf_sumo.sumo.simulation.sumo_config import Configuration, read_configuration
from deepmf_sumo.sumo.simulation.sumo_outputs import confined
from deepmf_sumo.training.recording.driver_population import DriverMix
from deepmf_sumo.training.recording.scenes import Recording, Scenes, TrafficState

__all__ = ["Recording", "record"]

_STEPS: Final = HISTORY_STEPS + FUTURE_STEPS
COMFORTABLE_MPS2: Final = 3.0
"""Lateral acceleration at the tightest bend of a lane; the median over whole turns is then 1.9, as
in recordings."""
_SLOWEST_MPS: Final = 3.0
_SPACING_M: Final = 2.0
_WINDOW_M: Final = 10.0
"""Length over which bends are measured: corners of polylines are not bends."""
_CURVE_RAD: Final = 0.25
"""Junction lanes that turn less in all only lead to a lane with a lateral offset."""


def record(recording: Recording) -> Iterator[Scene]:
    """Scenes of 91 steps of a SUMO configuration's traffic, in the order of time.

    Lateral motion is continuous (sublane model). Moments without a vehicle that could be the AV
    (present at all steps, moving, with others around) give no scene.

    Raises SimulationError if the configuration cannot be run.
    """
    configuration = read_configuration(recording.config)
    if recording.every_s < DT_S:
        raise SimulationError(f"every_s is {recording.every_s}; it must be at least {DT_S} s.")
    road = road_of_net(configuration.net, configuration.additional)
    rng = np.random.default_rng(recording.seed)
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        mix = DriverMix(Path(folder) / "drivers.add.xml", rng) if recording.diverse else None
        arguments = [*_arguments(configuration, recording, mix), *sumo_words.to_file(Path(folder))]
        with running(confined(arguments, Path(folder)), folder=Path(folder)) as api:
            yield from _scenes(api, recording, configuration, road, mix, rng)


def _arguments(
    configuration: Configuration, recording: Recording, mix: DriverMix | None
) -> list[str]:
    additional = [str(path) for path in configuration.additional]
    additional += [str(mix.file)] if mix else []
    return [
        *("-c", str(configuration.file)),
        *(("--additional-files", ",".join(additional)) if additional else ()),
        *("--seed", str(sumo_seed(recording.seed))),
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
        slow_down(api, road)
    reader = TrafficReader(api)
    links = signal_links(configuration.net)
    lights = LiveSignals(api, links)
    scenes = Scenes(recording, road, links)
    window: deque[TrafficState] = deque(maxlen=_STEPS)
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
        if -since % stride < _STEPS:  # other steps are not part of any scene
            window.append(TrafficState(states=reader.states(), signals=lights.states()))
        if len(window) == _STEPS and since == 0:
            yield from scenes.of(list(window), reader.body, step * DT_S - 9.0, rng)
        if api.simulation.getMinExpectedNumber() == 0:
            break


def slow_down(api: SumoApi, road: RoadMap) -> None:
    """Lower the speed limit of each lane with bends to a comfortable speed."""
    for lane in road.lanes.values():
        speed = _comfortable(lane)
        # a straight lane may be one that SUMO does not have
        if np.isfinite(speed) and speed < api.lane.getMaxSpeed(lane.id):
            api.lane.setMaxSpeed(lane.id, speed)


def _comfortable(lane: Lane) -> float:
    """Speed at which the lane's tightest bend takes the comfortable lateral acceleration."""
    step = np.diff(polylines.resample(lane.centre_m, _SPACING_M), axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    if abs(float(frames.difference(heading[-1], heading[0]))) < _CURVE_RAD and lane.interpolating:
        return np.inf
    spacing_m = float(np.hypot(step[:, 0], step[:, 1]).mean())
    over = min(round(_WINDOW_M / _SPACING_M), len(heading) - 1)
    if over < 1:
        return np.inf
    turned = float(np.abs(frames.difference(heading[over:], heading[:-over])).max())
    radius_m = over * spacing_m / max(turned, 1e-6)
    return max(_SLOWEST_MPS, float(np.sqrt(COMFORTABLE_MPS2 * radius_m)))
