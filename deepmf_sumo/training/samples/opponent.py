"""One scene -> training samples of the opponent network, and the paper's pseudo-labels.

The pseudo-labels (section IV-B1) are computed, so any vehicle of a recording can stand in for the
AV. Each window gives samples around the AV and around some of the vehicles that drive near it.
"""

import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.opponent import OTHERS, opponent_features
from deepmf_sumo.scene import (
    HISTORY_STEPS,
    ROLLOUT,
    SIMULATED,
    AgentId,
    Bools,
    RoadMap,
    Scene,
    Tracks,
    View,
)
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.dataset import Arrays
from deepmf_sumo.training.samples.feature_cache import Features

AV_STEPS = (10, 15, 20, 25, 30, 40)
"""Current steps of the samples around the AV."""
STAND_IN_STEPS = (10, 30)
"""Current steps of the samples around stand-ins."""
STAND_INS: Final = 2
"""Stand-ins per window, the labelled partner of the AV first."""
SIMULATED_STEPS: Final = (10, 30)
"""Current steps in simulated traffic, which is plentiful: there are no stand-ins."""
VERSION: Final = 3
"""Increased when features or labels change; weights do not depend on it."""

_NEAR_M = 60.0
_KNOWN_STEPS = 45
_WAY_M = 4.0
"""A vehicle stands in for the AV only if it drives farther and is observed for longer."""


def features_for(preset: Preset) -> Features:
    """The features of this network, which depend only on the preset's image sizes."""
    image = {key: value for key, value in preset.record().items() if key.startswith("raster_")}
    steps = f"{AV_STEPS} {STAND_IN_STEPS} {STAND_INS} {SIMULATED_STEPS}"
    settings = f"{VERSION} {steps} {json.dumps(image, sort_keys=True)}"
    return Features(kind="opponent", settings=settings, of=partial(opponent_samples, preset=preset))


def opponent_samples(scene: Scene, preset: Preset) -> Iterator[Arrays]:
    """Features around the AV and its stand-ins, with both labels of each vehicle.

    Labels use the recording from the start of the window's history on. Added to
    `opponent_features`: interacts (63), partner (63) one-hot, partner_known (), stands_in ().
    Networks without a branch train on the same samples. Simulated attacks give no samples, since
    the attack chooses which vehicle meets the AV.
    """
    if scene.source.dataset == ROLLOUT:
        return
    preset = replace(preset, raster=True, vectors=True, pairs=True)
    tracks = scene.tracks
    rng = np.random.default_rng(zlib.crc32(scene.name.encode()))
    simulated = scene.source.dataset == SIMULATED
    av_steps, others = (SIMULATED_STEPS, ()) if simulated else (AV_STEPS, STAND_IN_STEPS)
    for step in sorted({*av_steps, *others}):
        if step >= tracks.steps:
            break
        view = windows.view_at(scene, step)
        centres = [scene.av_id] if step in av_steps and scene.av_id in view.history.ids else []
        if step in others:
            centres += _stand_ins(scene, step, rng)
        for centre in centres:
            sample = _sample(scene, replace(view, av_id=centre), preset)
            if sample is not None:
                yield sample


def _stand_ins(scene: Scene, step: int, rng: np.random.Generator) -> list[AgentId]:
    """Vehicles that drive near the AV, the labelled partner among them."""
    tracks, av = scene.tracks, scene.tracks.row(scene.av_id)
    found = []
    for row, agent_id in enumerate(tracks.ids):
        if tracks.kinds[row] != "vehicle" or row == av or not tracks.valid[row, step]:
            continue
        seen = step + np.flatnonzero(tracks.valid[row, step:])
        way = tracks.position_m[row, seen[-1]] - tracks.position_m[row, step]
        away = tracks.position_m[row, step] - tracks.position_m[av, step]
        drives = len(seen) >= _KNOWN_STEPS and np.hypot(*way) > _WAY_M
        if agent_id == scene.partner_id or (drives and np.hypot(*away) < _NEAR_M):
            found.append(agent_id)
    order = rng.permutation(len(found))
    chosen = sorted(order, key=lambda number: found[number] != scene.partner_id)[:STAND_INS]
    return [found[number] for number in sorted(chosen)]


def _sample(scene: Scene, view: View, preset: Preset) -> Arrays | None:
    """One view with its labels; None if there is no other vehicle."""
    tracks = scene.tracks
    stands_in = view.av_id != scene.av_id
    known_s = (tracks.steps - 1 - view.step) * view.dt_s
    arrays, around = opponent_features(view, preset, known_s=min(known_s, 8.0), stands_in=stands_in)
    if not around.vehicles:
        return None
    ids = around.ids(view)
    partner_of = {scene.av_id: scene.partner_id, scene.partner_id: scene.av_id}
    other = partner_of.get(view.av_id) if scene.partner_id is not None else None
    rest = tracks.window(view.step - HISTORY_STEPS + 1, tracks.steps)
    interacts, partner = np.zeros(OTHERS, np.float32), np.zeros(OTHERS, np.float32)
    interacts[: len(ids)] = interacting(rest, scene.road, view.av_id, ids)
    partner[: len(ids)] = [agent_id == other for agent_id in ids]
    return {
        **arrays,
        "interacts": interacts,
        "partner": partner,
        "partner_known": np.asarray(partner.any(), np.float32),
        "stands_in": np.asarray(stands_in, np.float32),
    }


def interacting(
    tracks: Tracks, road: RoadMap, av_id: AgentId, agent_ids: Sequence[AgentId]
) -> Bools:
    """(A) vehicles whose path overlaps the AV's, at any two times, or that come close to it.

    Close: at one time the distance of the centres is less than the AV's length. Any vehicle may be
    taken as the AV. Vehicles that pass over each other do neither.
    """
    if not ground_of(road).has_levels:
        tracks = replace(tracks, z_m=np.zeros_like(tracks.z_m))
    av = tracks.row(av_id)
    length = float(tracks.size_m[av, 0])
    reach = np.hypot(*tracks.size_m[:, :2].T) / 2
    place = tracks.position_m[av, tracks.valid[av]]
    found = np.zeros(len(agent_ids), bool)
    if len(place) == 0:
        return found
    low, high = place.min(0), place.max(0)
    for number, agent_id in enumerate(agent_ids):
        other = tracks.row(agent_id)
        own = tracks.position_m[other, tracks.valid[other]]
        near = max(float(reach[av] + reach[other]), length)
        if len(own) == 0 or (own > high + near).all(0).any() or (own < low - near).all(0).any():
            continue  # the paths keep apart along one axis: most do
        found[number] = _close(tracks, av, other, length) or _overlap(
            tracks, av, other, float(reach[av] + reach[other])
        )
    return found


def _close(tracks: Tracks, av: int, other: int, length_m: float) -> bool:
    """Whether the centres come closer than the AV's length."""
    both = tracks.valid[av] & tracks.valid[other]
    both &= ~clear(tracks.z_m[av], tracks.z_m[other])
    apart = tracks.position_m[av, both] - tracks.position_m[other, both]
    return bool(len(apart) and np.hypot(apart[:, 0], apart[:, 1]).min() < length_m)


def _overlap(tracks: Tracks, av: int, other: int, reach_m: float) -> bool:
    """Whether the boxes overlap at any two times."""
    av_seen, seen = np.flatnonzero(tracks.valid[av]), np.flatnonzero(tracks.valid[other])
    av_place, place = tracks.position_m[av, av_seen], tracks.position_m[other, seen]
    away = av_place[:, None] - place
    near = (away * away).sum(-1) < reach_m**2
    near &= ~clear(tracks.z_m[av, av_seen][:, None], tracks.z_m[other, seen])
    first, second = near.nonzero()
    if len(first) == 0:
        return False
    hit = boxes.overlap(
        av_place[first],
        tracks.heading_rad[av, av_seen[first]],
        tracks.size_m[av, :2],
        place[second],
        tracks.heading_rad[other, seen[second]],
        tracks.size_m[other, :2],
    )
    return bool(hit.any())
