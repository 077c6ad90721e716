"""Parts of a rollout: steps after the current one, steps driven by the policy."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Case, Driver, Floats, Rollout
from deepmf_sumo.metrics.episode import motion

NO_OPPONENT = "nobody was attacked"
NEVER_DRIVEN = "the policy never drove the opponent"
NO_COLLISION = "AV and opponent did not collide"
NO_LOG = "the case has no recording to compare with"
TOO_SHORT = "fewer than three recorded or planned poses to compare"


def opponent_row(rollout: Rollout) -> int | None:
    """Row of the opponent in the tracks; None if there was nobody to attack."""
    if rollout.opponent_id is None or rollout.opponent_id not in rollout.tracks.ids:
        return None
    return rollout.tracks.row(rollout.opponent_id)


def driven(rollout: Rollout, row: int) -> Bools:
    """(T) steps after the current one at which the policy drove the agent."""
    mask: Bools = (rollout.driver[row] == Driver.POLICY) & rollout.tracks.valid[row]
    return mask & (np.arange(rollout.tracks.steps) > rollout.now)


class Driving(NamedTuple):
    """Row of the opponent, and (T) steps after the current one at which the policy drove it."""

    row: int
    steps: Bools


def driving(rollout: Rollout) -> Driving | str:
    """Where the policy drove the opponent, or the reason why it never did."""
    row = opponent_row(rollout)
    if row is None:
        return NO_OPPONENT
    steps = driven(rollout, row)
    return Driving(row, steps) if steps.any() else NEVER_DRIVEN


def together(rollout: Rollout, row: int) -> tuple[int, Bools]:
    """Row of the AV, and (T) steps after the current one at which it and the agent are there."""
    av = rollout.tracks.row(rollout.av_id)
    both = rollout.tracks.valid[av] & rollout.tracks.valid[row]
    return av, both & (np.arange(rollout.tracks.steps) > rollout.now)


def planned_path(rollout: Rollout, row: int, steps_at_most: int) -> Floats:
    """(K, 2) the opponent's driven poses, and what its last plan says of the time after the end.

    The episode ends at the contact; what the opponent was going to do is in its plan.
    """
    steps = np.flatnonzero(driven(rollout, row))
    path: Floats = rollout.tracks.position_m[row, steps]
    if len(steps) == 0 or not rollout.plans:
        return path
    plan = rollout.plans[-1]
    rest = plan.position_m[max(0, int(steps[-1]) + 1 - plan.first_step) :]
    whole: Floats = np.concatenate([path, rest])[:steps_at_most]
    return whole


def logged_path(case: Case, agent_id: AgentId, steps_at_most: int) -> Floats | None:
    """(K, 2) where the recording has the agent after now; None if it has fewer than three."""
    stretches = logged_stretches(case, agent_id, steps_at_most)
    path: Floats = np.concatenate([np.empty((0, 2)), *stretches])
    return path if len(path) > 2 else None


def logged_stretches(
    case: Case, agent_id: AgentId, steps_at_most: int | None = None
) -> list[Floats]:
    """Where the recording has the agent after now, (K, 2) each, without the gaps between them.

    At most the case's duration, or the given number of steps.
    """
    scene = case.scene
    if scene is None or agent_id not in scene.tracks.ids:
        return []
    row = scene.tracks.row(agent_id)
    count = case.duration_steps if steps_at_most is None else steps_at_most
    steps = slice(scene.now + 1, scene.now + 1 + count)
    position = scene.tracks.position_m[row, steps]
    return [position[run] for run in motion.runs(scene.tracks.valid[row, steps])]
