"""One scene -> training samples of the network of people."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks import people_net
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS
from deepmf_sumo.deepmf.networks.people import moving_pose, untrained
from deepmf_sumo.deepmf.networks.people_net import MOTIONS
from deepmf_sumo.scene import ROLLOUT, Scene, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.dataset import Arrays
from deepmf_sumo.training.samples.feature_cache import Features

WINDOW_STEPS: Final = (10, 20, 30, 40, 50, 60)
"""Current steps of the windows of a recording; after later ones less of the future is known."""
_KNOTS: Final = list(KNOT_STEPS)


def features_for() -> Features:
    """The features of this network."""
    columns = (people_net.OWN, people_net.AROUND, people_net.MOTION, people_net.AGENTS)
    settings = f"{people_net.INPUTS_VERSION} {WINDOW_STEPS} {MOTIONS} {columns}"
    return Features(kind="people", settings=settings, of=people_samples)


def people_samples(scene: Scene) -> Iterator[Arrays]:
    """Inputs of each person in each window, its motions and its future at the knots.

    Added to `people_net.Inputs`, whose motions are filled up to `MOTIONS`: there (N) 0 or 1; place
    (N, 5, 2), along (N, 5) and width (N, 5, 2) of the kernels; future (5, 2) and future_valid (5).
    All are in the person's frame. Simulated attacks give no samples: their people are the log's.
    """
    if scene.source.dataset == ROLLOUT:
        return
    for step in WINDOW_STEPS:
        if step >= scene.tracks.steps - windows.MIN_FUTURE_STEPS:
            break
        view = windows.view_at(scene, step)
        if scene.av_id not in view.history.ids:
            continue
        for future in windows.people(scene, step):
            if future.valid[_KNOTS].any():
                yield _sample(view, future)


def _sample(view: View, future: windows.Future) -> Arrays:
    found, pose = untrained(view, future.agent_id), moving_pose(view, future.agent_id)
    inputs = people_net.inputs(view, found, pose)
    arrays: Arrays = {
        **inputs._asdict(),
        "there": np.ones(len(found.share)),
        "place": frames.to_local(found.position_m[:, _KNOTS], pose.position_m, pose.heading_rad),
        "along": frames.wrap(found.along_rad - pose.heading_rad),
        "width": found.width_m,
    }
    for name in ("motion", "there", "place", "along", "width"):
        rest = MOTIONS - len(arrays[name])
        arrays[name] = np.pad(arrays[name], [(0, rest), *[(0, 0)] * (arrays[name].ndim - 1)])
    arrays["future"] = frames.to_local(future.position_m[_KNOTS], pose.position_m, pose.heading_rad)
    arrays["future_valid"] = future.valid[_KNOTS]
    return {name: np.asarray(values, np.float32) for name, values in arrays.items()}
