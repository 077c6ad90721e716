"""The attack's plans and their constraints; what the AV's planner followed, and how it braked."""

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric
from deepmf_sumo.scene import Floats, Ints, PlanReason, Rollout

_BLIND = "the planner follows no vehicle, or does not report which"
_NO_REASONS = "the policy does not report its candidates"
_SPAN = 2  # steps over which braking is taken


def _reasons(rollout: Rollout) -> list[PlanReason]:
    """Reasons of the plans that have one."""
    return [plan.reason for plan in rollout.plans if plan.reason is not None]


def _some_reasons(rollout: Rollout) -> list[PlanReason]:
    """At least one reason. Raises NotMeasurable."""
    found = _reasons(rollout)
    if not found:
        raise NotMeasurable(_NO_REASONS)
    return found


@metric("1", better="higher")
def colliding_plans(episode: Episode) -> float:
    """Share of the plans in which some pair of candidate and reaction collides."""
    reasons = _some_reasons(episode.rollout)
    return sum(bool(reason.collides.any()) for reason in reasons) / len(reasons)


@metric("1", better="higher")
def predicted_contact(episode: Episode) -> float:
    """Predicted chance that the first plan meets the AV: mass of the AV's reactions that the chosen
    candidate collides with; its mean over runs is to be compared with the rate of hits.
    """
    first = _some_reasons(episode.rollout)[0]
    return float(first.reactions[first.chosen].probability[first.collides[first.chosen]].sum())


@metric("1", better="neither")
def candidate_perplexity(episode: Episode) -> float:
    """Exponential of the entropy of P(OV) over the candidates, mean over plans: how many are about
    equally likely.
    """
    reasons = _some_reasons(episode.rollout)
    return sum(_perplexity(reason.candidates.probability) for reason in reasons) / len(reasons)


def _perplexity(probability: Floats) -> float:
    """Exponential of the entropy of probabilities (N1)."""
    some = probability[probability > 0]
    return float(np.exp(-(some * np.log(some)).sum()))


@metric("1", better="lower")
def unmet_wishes(episode: Episode) -> float:
    """Share of the plans in which no candidate hits the wanted sector, or none that meets the AV is
    fair, or lawful.
    """
    wished = [reason for reason in _reasons(episode.rollout) if reason.allowed]
    if not wished:
        raise NotMeasurable("the attack has no wishes, or nothing was planned")
    return sum(bool(reason.unmet) for reason in wished) / len(wished)


@metric("1", better="higher")
def wanted_sector_hit(episode: Episode) -> float:
    """1 if the opponent hit the AV in the wanted sector, else 0 (no hit, another sector)."""
    wanted = {reason.wanted_sector for reason in _reasons(episode.rollout)} - {None}
    if len(wanted) != 1:
        raise NotMeasurable("no sector was wanted, or nothing was planned")
    contact = episode.rollout.first("av_opponent")
    return contact is not None and contact.sector in wanted


def _steps_with_opponent(rollout: Rollout) -> Ints:
    """Steps, before a contact, at which the AV's planner followed the opponent.

    It followed the vehicle by which it, or SUMO's model for it, chose the next step. Raises
    NotMeasurable if the planner never reports one.
    """
    if all(one is None for one in rollout.leaders):
        raise NotMeasurable(_BLIND)
    seen = [rollout.opponent_id in (one or ()) for one in rollout.leaders]
    return np.flatnonzero(seen) + rollout.now


@metric("1", better="neither")
def planner_saw_opponent(episode: Episode) -> float:
    """1 where, at some step before a contact, the planner named the opponent as what it follows,
    or, for a planner that lets SUMO drive, the opponent was SUMO's leader on its lanes (within 100
    m), else 0; vehicles that it yields to at junctions are not leaders.
    """
    _slices.opponent_row(episode.rollout)
    return bool(len(_steps_with_opponent(episode.rollout)))


@metric("s", better="neither")
def planner_warning_s(episode: Episode) -> float:
    """Time from the first step at which the planner followed the opponent (see
    planner_saw_opponent) to their contact.
    """
    rollout = episode.rollout
    contact, seen = _slices.collision(rollout), _steps_with_opponent(rollout)
    if not len(seen):
        raise NotMeasurable("the planner never followed the opponent")
    return (contact.step - seen[0]) * rollout.dt_s


@metric("m/s2", better="higher")
def planner_hardest_braking(episode: Episode) -> float:
    """Hardest braking of the AV after the current step, from speeds 0.2 s apart; 0 without any."""
    rollout = episode.rollout
    row = rollout.tracks.row(rollout.av_id)
    steps = np.flatnonzero(rollout.tracks.valid[row])
    speed = rollout.tracks.speed_mps[row, steps[steps >= rollout.now]]
    if len(speed) <= _SPAN:
        raise NotMeasurable("the AV was present for fewer than three steps")
    braking = (speed[:-_SPAN] - speed[_SPAN:]) / (_SPAN * rollout.dt_s)
    return max(0.0, braking.max())
