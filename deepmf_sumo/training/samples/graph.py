"""One scene -> training samples of the motion prior: a graph, and each vehicle's future."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from deepmf_sumo.baselines.priors.bicycle import SUBSTEPS
from deepmf_sumo.baselines.priors.graph import MEMBERS, graph_of, members
from deepmf_sumo.scene import ROLLOUT, SIMULATED, AgentId, Floats, Scene, View
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.dataset import Arrays
from deepmf_sumo.training.samples.feature_cache import Features

WINDOW_STEPS: Final = (10, 20, 30, 40)
"""Current steps of the windows of a recording; after later ones less of the future is known."""
SIMULATED_STEPS: Final = (10,)
"""Simulated scenes are plentiful and overlap, so one window is used."""
KNOTS: Final = 16
VERSION: Final = 1
"""Increased when features change."""


def features() -> Features:
    """The features of the motion prior."""
    settings = f"{VERSION} {MEMBERS} {WINDOW_STEPS} {SIMULATED_STEPS}"
    return Features(kind="graph", settings=settings, of=graph_samples)


def graph_samples(scene: Scene) -> Iterator[Arrays]:
    """The graph around the AV in each window, and the vehicles' futures.

    Added to `graph.Graph`: future (16, 16, 4), x, y, heading in the vehicle's own frame every
    0.5 s, and 1 where known.
    """
    for step in _steps(scene):
        if step >= scene.tracks.steps - windows.MIN_FUTURE_STEPS:
            break
        view = windows.view_at(scene, step)
        if scene.av_id not in view.history.ids:
            continue
        ids = members(view)
        future = np.zeros((MEMBERS, KNOTS, 4), np.float32)
        for number, agent_id in enumerate(ids):
            if _teaches(scene, agent_id):
                future[number] = _future(scene, view, agent_id)
        if future[..., 3].any():
            yield {**graph_of(view, ids), "future": future}


def _steps(scene: Scene) -> tuple[int, ...]:
    return SIMULATED_STEPS if scene.source.dataset == SIMULATED else WINDOW_STEPS


def _teaches(scene: Scene, agent_id: AgentId) -> bool:
    """Whether a vehicle is learnt from. In a simulated attack that is only the AV."""
    if scene.source.dataset == ROLLOUT and agent_id != scene.av_id:
        return False
    return not windows.jumps(scene.tracks, scene.tracks.row(agent_id))


def _future(scene: Scene, view: View, agent_id: AgentId) -> Floats:
    """(16, 4) every fifth step; zero where unknown."""
    future = windows.future_of(scene, agent_id, view.step)
    local = windows.local_future(view, agent_id, future)
    known = future.valid.astype(float)[:, None]
    rows: Floats = np.concatenate([local * known, known], axis=1)[SUBSTEPS - 1 :: SUBSTEPS]
    return rows
