"""Avoidability of the contact of AV and opponent, and fault.

See `deepmf_sumo.judge.avoidability` for the reference drivers and the manoeuvres.
"""

from deepmf_sumo.judge.avoidability import grading
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric, once


@once
def judgement(episode: Episode) -> grading.Judgement:
    """The drivers that would have avoided the contact. Raises NotMeasurable without a contact."""
    _slices.opponent_row(episode.rollout)
    found = grading.judge(episode.rollout, episode.case)
    if found is None:
        raise NotMeasurable(_slices.NO_COLLISION)
    return found


@metric("1", better="higher")
def avoidable(episode: Episode) -> float:
    """Of contacts: 1 if at least one of the reference drivers (UN R157 competent and careful, fuzzy
    safety model, RSS braking; with people a driver of their own) in the place of the AV avoids the
    same opponent trajectory, else 0.
    """
    return judgement(episode).avoidable


@metric("1", better="higher")
def avoidable_physically(episode: Episode) -> float:
    """Of contacts: 1 if one of the manoeuvres or of the reference drivers avoids the same opponent
    trajectory, else 0.
    """
    return judgement(episode).physically


@metric("1", better="neither")
def avoidance_grade(episode: Episode) -> float:
    """Of contacts: 0 unavoidable, 1 avoided by some braking or steering without delay but by no
    reference driver, 2 avoided by some of the reference drivers, 3 avoided by all.
    """
    return grading.GRADES.index(judgement(episode).grade)


@metric("1", better="neither")
def avoidance_hit_standing(episode: Episode) -> float:
    """Of contacts: 1 if no reference driver in the place of the AV avoids the same opponent
    trajectory, but at least one has stopped before the opponent runs into it, else 0.
    """
    return judgement(episode).hit_standing


@metric("1", better="higher")
def avoided_by_cc(episode: Episode) -> float:
    """Of contacts: 1 if the competent and careful driver of UN R157, in the place of the AV and on
    its path, avoids the same opponent trajectory, else 0.
    """
    return _avoided_by(episode, "cc")


@metric("1", better="higher")
def avoided_by_fsm(episode: Episode) -> float:
    """Of contacts: 1 if the fuzzy safety model of UN R157, in the place of the AV and on its path,
    avoids the same opponent trajectory, else 0.
    """
    return _avoided_by(episode, "fsm")


@metric("1", better="higher")
def avoided_by_rss(episode: Episode) -> float:
    """Of contacts: 1 if a driver that brakes as RSS requires, in the place of the AV and on its
    path, avoids the same opponent trajectory, else 0.
    """
    return _avoided_by(episode, "rss")


@metric("1", better="higher")
def avoided_by_vru(episode: Episode) -> float:
    """Of contacts with a pedestrian or cyclist: 1 if a driver who brakes fully 0.75 s after the
    person was in sight and entered the road, or moved towards it faster than people walk, avoids
    the same trajectory of the person in the place of the AV, or stands before the contact, else 0.
    """
    return _avoided_by(episode, "vru")


def _avoided_by(episode: Episode, driver: str) -> bool:
    known = judgement(episode).avoided_by
    if driver not in known:
        who = "people" if driver == "vru" else "vehicles"
        raise NotMeasurable(f"this driver judges only hits by {who}")
    return known[driver]


@metric("1", better="higher")
def avoided_by_search(episode: Episode) -> float:
    """Of contacts: 1 if one of about a hundred manoeuvres (braking up to 8 m/s2 with lateral
    accelerations up to 6 m/s2, started at the onset) avoids the opponent, hits no other agent and
    stays on the road, else 0.
    """
    return judgement(episode).manoeuvres > 0


@metric("1", better="higher")
def av_at_fault(episode: Episode) -> float:
    """Of contacts: 1 if the AV hits something that stands or hits with its front, or touches
    sideways while not within one lane; 0 if it stands itself, is hit from behind, or keeps its lane
    (nuPlan's at-fault collisions).
    """
    _slices.opponent_row(episode.rollout)
    found = grading.av_at_fault(episode.rollout, episode.case)
    if found is None:
        raise NotMeasurable(_slices.NO_COLLISION)
    return found
