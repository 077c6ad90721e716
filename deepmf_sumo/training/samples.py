"""One scene -> training samples of each network."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deepmf_sumo.datatypes import FUTURE_STEPS, HISTORY_STEPS, Scene, View
from deepmf_sumo.geometry import angles
from deepmf_sumo.predictors.features import features
from deepmf_sumo.predictors.opponent_features import SCENE_AGENTS, opponent_features
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.training import labels, profiles, windows
from deepmf_sumo.training.cache import Arrays

WINDOW_STEPS = (10, 20, 30, 40)
"""Current steps at which a recording is looked at; later ones know less of the future."""
OPPONENT_STEPS = (10, 20, 30)


def trajectory_samples(scene: Scene, preset: Preset) -> Iterator[Arrays]:
    """Features of each target at each window, its future and its partner's.

    Added to `features.Features`: future (80, 2), future_valid (80), driven (80) m along the way,
    partner (80, 3) x, y, heading, partner_known () 0 or 1; futures in the target's frame.
    """
    for step in WINDOW_STEPS:
        if step >= scene.tracks.steps - windows.MIN_FUTURE_STEPS:
            break
        view = windows.view_at(scene, step)
        for future in windows.targets(scene, step):
            arrays, _ = features(view, future.agent_id, preset)
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


def opponent_samples(scene: Scene, preset: Preset) -> Iterator[Arrays]:
    """Features around the AV at each window, with both labels of each candidate.

    Labels look at the recording from the start of the window's history on. Added to
    `opponent_features`: interacts (64), partner (64) one-hot, partner_known ().
    """
    tracks = scene.tracks
    for step in OPPONENT_STEPS:
        if step >= tracks.steps or not tracks.valid[tracks.row(scene.av_id), step]:
            continue
        arrays, ids = opponent_features(windows.view_at(scene, step), preset)
        if not ids:
            continue
        rest = replace(scene, tracks=tracks.window(step - HISTORY_STEPS + 1, tracks.steps))
        slots = np.flatnonzero(arrays["candidate"])
        interacts, partner = np.zeros(SCENE_AGENTS), np.zeros(SCENE_AGENTS)
        interacts[slots] = [labels.interacts(rest, agent_id) for agent_id in ids]
        partner[slots] = [agent_id == scene.partner_id for agent_id in ids]
        yield {
            **arrays,
            "interacts": _float(interacts),
            "partner": _float(partner),
            "partner_known": _float(partner.any()),
        }


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
