"""What hits are worth, by the ladder."""

from deepmf_sumo.judge import ladder
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric


@metric("1", better="higher")
def finding(episode: Episode) -> float:
    """1 for a hit of rung A (the AV's error) or B (avoidable, and not contrived), else 0.

    A miss counts 0: the mean is a rate over attacked scenes, like that of `collision`.
    """
    _slices.opponent_row(episode.rollout)
    found = ladder.verdict(episode)
    return found is not None and found.finding


@metric("1", better="neither")
def rung(episode: Episode) -> float:
    """Rung of a hit: 0 A (the AV's error), 1 B (avoidable), 2 C (contrived), 3 D (unavoidable)."""
    _slices.opponent_row(episode.rollout)
    found = ladder.verdict(episode)
    if found is None:
        raise NotMeasurable(_slices.NO_COLLISION)
    return ladder.RUNGS.index(found.rung)
