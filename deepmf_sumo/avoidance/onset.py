"""When an attack begins: the step from which on the AV may answer it."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Case, Floats, Ints, Rollout
from deepmf_sumo.geometry import boxes
from deepmf_sumo.geometry.ground import clear

DEPARTURE_M: Final = 0.5
CONFLICT_S: Final = 3.0
_TESTED_S = np.arange(0.0, CONFLICT_S + 0.05, 0.1)


def onset_step(rollout: Rollout, case: Case, opponent: int, first: int, contact: int) -> int:
    """First step of first..contact - 1 with a sign of the attack; ``first`` where there is none.

    A sign is that the opponent is more than 0.5 m from where it would have been (the recording's
    position; in SUMO's traffic the likeliest prediction of the first plan), or that the two would
    collide within 3 s at constant velocities.
    """
    steps = np.arange(first, contact)
    departed = _departure_m(rollout, case, opponent, steps) > DEPARTURE_M
    signs = np.flatnonzero(departed | _on_collision_course(rollout, opponent, steps))
    return int(steps[signs[0]]) if len(signs) else first


def _on_collision_course(rollout: Rollout, opponent: int, steps: Ints) -> Bools:
    """(K) whether the two boxes overlap within 3 s if both keep velocity and heading."""
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)

    def ahead(row: int) -> tuple[Floats, Floats, Floats]:
        velocity = tracks.velocity_mps[row, steps][:, None]
        position = tracks.position_m[row, steps][:, None] + velocity * _TESTED_S[:, None]
        return position, tracks.heading_rad[row, steps][:, None], tracks.size_m[row, :2]

    hits = boxes.overlap(*ahead(av), *ahead(opponent))
    hits &= ~clear(tracks.z_m[av, steps], tracks.z_m[opponent, steps])[:, None]
    return np.asarray(hits.any(axis=1))


def _departure_m(rollout: Rollout, case: Case, opponent: int, steps: Ints) -> Floats:
    """(K) distance from where the opponent would have been; 0 where that is not known."""
    distance = np.zeros(len(steps))
    where = rollout.tracks.position_m[opponent, steps]
    name, scene = rollout.tracks.ids[opponent], case.scene
    if scene is not None and name in scene.tracks.ids:
        row = scene.tracks.row(name)
        # a rollout begins at the recording's first step, so that steps are the same in both
        known = steps < scene.tracks.steps
        known[known] = scene.tracks.valid[row, steps[known]]
        expected = scene.tracks.position_m[row, steps[known]]
    else:
        plan = rollout.plans[0] if rollout.plans else None
        if plan is None or plan.reason is None:
            return distance
        origin = plan.reason.origin or ("mode",) * len(plan.reason.candidates.probability)
        likeliest = origin.index("mode") if "mode" in origin else 0
        mode = plan.reason.candidates.futures.position_m[likeliest]
        known = (steps >= plan.first_step) & (steps < plan.first_step + len(mode))
        expected = mode[steps[known] - plan.first_step]
    distance[known] = np.hypot(*(where[known] - expected).T)
    return distance
