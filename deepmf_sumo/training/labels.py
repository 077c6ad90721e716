"""The paper's pseudo-labels for the opponent network (section IV-B1), from whole recordings."""

import numpy as np

from deepmf_sumo.datatypes import AgentId, Scene
from deepmf_sumo.geometry import boxes


def interacts(scene: Scene, agent_id: AgentId) -> bool:
    """Whether the vehicle's way overlaps the AV's, at any two times, or it came close to the AV.

    Close: at one time the centres are nearer than the AV's length.
    """
    tracks = scene.tracks
    av, other = tracks.row(scene.av_id), tracks.row(agent_id)
    av_seen, seen = np.flatnonzero(tracks.valid[av]), np.flatnonzero(tracks.valid[other])
    both = tracks.valid[av] & tracks.valid[other]
    apart = tracks.position_m[av, both] - tracks.position_m[other, both]
    if len(apart) and np.hypot(apart[:, 0], apart[:, 1]).min() < tracks.size_m[av, 0]:
        return True
    reach = np.hypot(*tracks.size_m[av, :2]) / 2 + np.hypot(*tracks.size_m[other, :2]) / 2
    av_place, place = tracks.position_m[av, av_seen], tracks.position_m[other, seen]
    near = np.linalg.norm(av_place[:, None] - place, axis=-1) < reach
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
