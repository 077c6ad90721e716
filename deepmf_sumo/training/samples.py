"""One scene -> training samples of the trajectory networks."""

import zlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import FUTURE_STEPS, ROLLOUT, SIMULATED, Scene, View
from deepmf_sumo.geometry import angles
from deepmf_sumo.predictors.config import Preset
from deepmf_sumo.predictors.features import features
from deepmf_sumo.training import profiles, windows
from deepmf_sumo.training.cache import Arrays

WINDOW_STEPS = (10, 20, 30, 40)
"""Current steps at which a recording is looked at; later ones know less of the future."""
ATTACKED_STEPS = (10, 15, 20, 25, 30, 35, 40, 50, 60)
"""The same of attacks, where the later steps matter as much as the first."""
SIMULATED_TARGETS: Final = 3
"""Simulated scenes are plentiful and overlap: few vehicles of each are enough, at fewer steps."""


def trajectory_samples(scene: Scene, preset: Preset) -> Iterator[Arrays]:
    """Features of each target at each window, its future and its partner's.

    Added to `features.Features`: future (80, 2), future_valid (80), driven (80) m along the way,
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
    """The AV and others drawn by the scene's name: always the same ones."""
    rng = np.random.default_rng(zlib.crc32(f"{scene.name} {step}".encode()))
    order = rng.permutation(len(futures)).tolist()
    order.sort(key=lambda row: futures[row].agent_id != scene.av_id)
    return [futures[row] for row in order[:SIMULATED_TARGETS]]


def _float(values: object) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.asarray(values, np.float32)


def _driven(
    view: View, future: windows.Future
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(80) metres along the way, where the whole future is known, else zeros."""
    if not future.valid.all():
        return np.zeros(FUTURE_STEPS)
    row = view.history.row(future.agent_id)
    start = view.history.position_m[row, -1:]
    heading = view.history.heading_rad[row, -1:]
    return profiles.driven(
        np.concatenate([start, future.position_m]),
        angles.wrap(np.concatenate([heading, future.heading_rad])),
    )
