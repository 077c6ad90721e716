"""The judgement on a rollout's contact, or why there is none."""

from deepmf_sumo.avoidance.grading import Judgement, judge
from deepmf_sumo.datatypes import Case, Rollout
from deepmf_sumo.metrics.episode import parts


def judgement(rollout: Rollout, case: Case) -> Judgement | str:
    """Who would have avoided the contact; without a contact the reason."""
    if parts.opponent_row(rollout) is None:
        return parts.NO_OPPONENT
    found = judge(rollout, case)
    return parts.NO_COLLISION if found is None else found
