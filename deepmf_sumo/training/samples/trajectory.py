"""One scene -> training samples of the trajectory networks."""

import json
import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.encode import FEATURES_VERSION, features
from deepmf_sumo.scene import FUTURE_STEPS, ROLLOUT, SIMULATED, Floats, Scene, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.dataset import Arrays
from deepmf_sumo.training.samples.feature_cache import Features

WINDOW_STEPS = (10, 20, 30, 40)
"""Current steps of the windows of a recording; after later ones less of the future is known."""
ATTACKED_STEPS = (10, 15, 20, 25, 30, 35, 40, 50, 60)
"""The same for attacks, whose later steps matter as much as the first."""
SIMULATED_TARGETS: Final = 3
"""Simulated scenes are plentiful and overlap, so a few vehicles at every other step are enough."""


def features_for(preset: Preset) -> Features:
    """The features of these networks, which depend only on the preset's image sizes."""
    image = {key: value for key, value in preset.record().items() if key.startswith("raster_")}
    counts = f"{WINDOW_STEPS} {SIMULATED_TARGETS} {FEATURES_VERSION} {windows.LABELS}"
    return Features(
        kind="trajectory",
        settings=f"{json.dumps(image, sort_keys=True)} {counts}",
        of=partial(trajectory_samples, preset=preset),
    )


def trajectory_samples(scene: Scene, preset: Preset) -> Iterator[Arrays]:
    """Features of each target in each window, its future and its partner's.

    Added to `encode.Features`: future (80, 2), future_valid (80), driven (80) m along the path,
    partner (80, 3) x, y, heading, partner_known () 0 or 1; futures in the target's frame.
    """
    preset = replace(preset, raster=True)  # networks without the image share the features
    attacked = scene.source.dataset == ROLLOUT  # its only target is the AV
    steps = ATTACKED_STEPS if attacked else WINDOW_STEPS
    simulated = scene.source.dataset == SIMULATED
    for step in steps[::2] if simulated else steps:
        if step >= scene.tracks.steps - windows.least_steps(scene):
            break
        view = windows.view_at(scene, step)
        futures = list(windows.targets(scene, step))
        for future in _some(scene, step, futures) if simulated else futures:
            arrays, _ = features(view, future.agent_id, preset, planner=attacked)
            partner = windows.partner_of(scene, future.agent_id, step)
            given = np.zeros((FUTURE_STEPS, 3))
            if partner is not None:
                given = windows.local_future(view, future.agent_id, partner)
            yield {
                **arrays,
                "future": _float(windows.local_future(view, future.agent_id, future)[:, :2]),
                "future_valid": _float(future.valid),
                "driven": _float(_driven(view, future)),
                "partner": _float(given),
                "partner_known": _float(partner is not None),
            }


def _some(scene: Scene, step: int, futures: list[windows.Future]) -> list[windows.Future]:
    """The AV and other targets, drawn with the scene's name as the seed."""
    rng = np.random.default_rng(zlib.crc32(f"{scene.name} {step}".encode()))
    order = rng.permutation(len(futures)).tolist()
    order.sort(key=lambda row: futures[row].agent_id != scene.av_id)
    return [futures[row] for row in order[:SIMULATED_TARGETS]]


def _float(values: object) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def _driven(view: View, future: windows.Future) -> Floats:
    """(80) metres along the path if the whole future is known, else zeros."""
    if not future.valid.all():
        return np.zeros(FUTURE_STEPS)
    row = view.history.row(future.agent_id)
    start = view.history.position_m[row, -1:]
    heading = view.history.heading_rad[row, -1:]
    return distance_driven(
        np.concatenate([start, future.position_m]),
        frames.wrap(np.concatenate([heading, future.heading_rad])),
    )


def distance_driven(position_m: Floats, heading_rad: Floats) -> Floats:
    """(80) distance driven forwards through positions (81, 2) with headings (81)."""
    step = np.diff(position_m, axis=0)
    ahead = step[:, 0] * np.cos(heading_rad[:-1]) + step[:, 1] * np.sin(heading_rad[:-1])
    distance: Floats = np.maximum.accumulate(np.cumsum(ahead)).clip(min=0.0)
    return distance
