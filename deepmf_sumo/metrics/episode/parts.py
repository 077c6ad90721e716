"""Parts of a rollout: steps after the current one, steps driven by the policy."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Case, Driver, Floats, Rollout
from deepmf_sumo.metrics.episode import motion

NO_OPPONENT = "nobody was attacked"
NEVER_DRIVEN = "the policy never drove the opponent"
NO_COLLISION = "AV and opponent did not collide"
NO_LOG = "the case has no recording to compare with"
TOO_SHORT = "fewer than three steps with both a recorded and a planned pose"


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


def places(rollout: Rollout, at: tuple[int, Bools]) -> tuple[Floats, Floats]:
    """(N, 2) box centres and (N) heights of an agent's row at the steps of a mask (T)."""
    row, steps = at
    return rollout.tracks.position_m[row, steps], rollout.tracks.z_m[row, steps]


def together(rollout: Rollout, row: int) -> tuple[int, Bools]:
    """Row of the AV, and (T) steps after the current one at which it and the agent are there."""
    av = rollout.tracks.row(rollout.av_id)
    both = rollout.tracks.valid[av] & rollout.tracks.valid[row]
    return av, both & (np.arange(rollout.tracks.steps) > rollout.now)


class Stretch(NamedTuple):
    """Positions (K, 2) of the opponent at K steps in a row: of the attack and of its recording."""

    attack_m: Floats
    recorded_m: Floats


def compared_stretches(rollout: Rollout, case: Case, row: int, *, beyond: bool) -> list[Stretch]:
    """The opponent beside its recording, over the steps that both have: most logs end early.

    The attack is what the policy drove; ``beyond`` the end of the episode, which is the contact, it
    goes on as its last plan says, up to the case's duration.
    """
    assert case.scene is not None
    last = rollout.now + case.duration_steps
    attack = planned_poses(rollout, row, last if beyond else rollout.tracks.steps - 1)
    recorded = case.scene.tracks
    mine = recorded.row(rollout.tracks.ids[row])
    # a rollout begins at the recording's first step, so that steps are the same in both
    shared = np.zeros(recorded.steps, bool)
    shared[[step for step in attack if step < recorded.steps]] = True
    return [
        Stretch(
            np.array([attack[step] for step in range(run.start, run.stop)]),
            recorded.position_m[mine, run],
        )
        for run in motion.runs(shared & recorded.valid[mine])
    ]


def planned_poses(rollout: Rollout, row: int, last: int) -> dict[int, Floats]:
    """(2) positions by step up to ``last``: driven ones, then those of the last plan."""
    steps = np.flatnonzero(driven(rollout, row)).tolist()
    found = {step: rollout.tracks.position_m[row, step] for step in steps if step <= last}
    if steps and rollout.plans:
        plan = rollout.plans[-1]
        end = plan.first_step + len(plan.position_m)
        for step in range(max(steps[-1] + 1, plan.first_step), min(end, last + 1)):
            found[step] = plan.position_m[step - plan.first_step]
    return found


def is_recorded(case: Case, agent_id: AgentId) -> bool:
    """Whether the recording has the agent after now, within the case's duration."""
    scene = case.scene
    if scene is None or agent_id not in scene.tracks.ids:
        return False
    steps = slice(scene.now + 1, scene.now + 1 + case.duration_steps)
    return bool(scene.tracks.valid[scene.tracks.row(agent_id), steps].any())
