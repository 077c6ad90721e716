"""Which share of recorded people moves within what is possible for their class.

``python -m tests.bench.people_limits ROOT`` prints a row for pedestrians and for cyclists: tracks
of at least 2 s, how many pass, and how many of those whose box never jumps. Scenes of
``../shared/womd/train`` gave the numbers in `deepmf_sumo.judge.metrics.driving.possible`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepmf_sumo import api
from deepmf_sumo.judge.metrics import _slices
from deepmf_sumo.judge.metrics.driving import possible
from deepmf_sumo.scene import Scene
from deepmf_sumo.scene.road_users import road_user

_LEAST_STEPS = 20
_JUMP_M = 0.3
"""A box that is farther from where its speeds lead has jumped: that is no motion of a person."""


def judged(scene: Scene) -> Iterator[tuple[str, bool, bool]]:
    """Kind of each person, whether its box jumps, and whether it moves within the limits."""
    tracks = scene.tracks
    for row, kind in enumerate(tracks.kinds):
        user = road_user(kind, tracks.size_m[row])
        if not user.person:
            continue
        for run in _slices.runs(tracks.valid[row]):
            if run.stop - run.start < _LEAST_STEPS:
                continue
            position, speed = tracks.position_m[row, run], tracks.velocity_mps[row, run]
            missed = np.diff(position, axis=0) - (speed[1:] + speed[:-1]) / 2 * scene.dt_s
            jumps = bool((np.hypot(*missed.T) > _JUMP_M).any())
            yield kind, jumps, possible(user, position, tracks.heading_rad[row, run], scene.dt_s)


def main(root: str) -> None:
    """See the module."""
    every = [
        one for scene in api.read_scenes(Path(root)) if isinstance(scene, Scene)
        for one in judged(scene)
    ]  # fmt: skip
    for kind in ("pedestrian", "cyclist"):
        of_kind = [one for one in every if one[0] == kind]
        calm = [one for one in of_kind if not one[1]]
        print(
            f"{kind}: {sum(one[2] for one in of_kind)} of {len(of_kind)} pass,"
            f" {sum(one[2] for one in calm)} of {len(calm)} whose box does not jump"
        )


if __name__ == "__main__":
    main(sys.argv[1])
