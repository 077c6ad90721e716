"""Impact: where on the AV's front it was, and what it means for a person.

Risks are those of published curves. They are indicative: a curve is of the accidents, cars and
people of its data, and knows nothing but the speed.
"""

import math
from typing import Final

from deepmf_sumo.judge import impact
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric
from deepmf_sumo.scene import Contact
from deepmf_sumo.scene.road_users import PEOPLE, class_of

_KMH: Final = 3.6
_FATAL_PEDESTRIAN: Final = (6.9, 0.090)
"""Rosen and Sander (Accident Analysis and Prevention 41, 2009): P = 1 / (1 + exp(6.9 - 0.090 v)),
v in km/h; 490 adults hit by the fronts of cars, of whom 36 died (GIDAS 1999 to 2007)."""


@metric("1", better="neither")
def impact_share(episode: Episode) -> float:
    """Of contacts of the AV's front: where on it the opponent is reached first, as a share of the
    AV's width; 0 is the left end, 1 the right one.

    Of pedestrians and cyclists it is the middle of their box. Euro NCAP counts from the side from
    which a person comes: 0.75 here is 25 % for a person who comes from the right.
    """
    share = impact.share_of_front(episode.rollout, _slices.collision(episode.rollout))
    if share is None:
        raise NotMeasurable("the contact was not at the AV's front")
    return share


@metric("m/s", better="higher")
def person_impact_speed(episode: Episode) -> float:
    """Of hits of a pedestrian or cyclist: the AV's speed at the last step before the contact."""
    contact = _slices.collision(episode.rollout)
    if episode.rollout.tracks.kinds[_other(episode, contact)] not in PEOPLE:
        raise NotMeasurable("the opponent is neither a pedestrian nor a cyclist")
    return _speed_mps(episode, contact)


@metric("1", better="higher")
def pedestrian_fatality_risk(episode: Episode) -> float:
    """Of pedestrians hit by the front of an AV that is a car: risk that an adult dies, by the AV's
    speed at the last step before the contact (Rosen and Sander 2009; indicative).

    There is none for cyclists: the coefficients that are quoted of the one curve found (Nie, Li and
    Yang 2015) do not give the 50 % at 67.6 km/h of its own abstract.
    """
    rollout, contact = episode.rollout, _slices.collision(episode.rollout)
    tracks, av = rollout.tracks, rollout.tracks.row(contact.first_id)
    if tracks.kinds[_other(episode, contact)] != "pedestrian":
        raise NotMeasurable("the opponent is not a pedestrian")
    if class_of(tracks.kinds[av], tracks.size_m[av]) != "car":
        raise NotMeasurable("the curve is of cars, and the AV is none")
    if impact.first_touch(rollout, contact).front is None:
        raise NotMeasurable("the curve is of fronts, and the AV's did not hit the pedestrian")
    constant, slope = _FATAL_PEDESTRIAN
    return 1.0 / (1.0 + math.exp(constant - slope * _KMH * _speed_mps(episode, contact)))


def _other(episode: Episode, contact: Contact) -> int:
    return episode.rollout.tracks.row(contact.second_id)


def _speed_mps(episode: Episode, contact: Contact) -> float:
    tracks = episode.rollout.tracks
    return float(tracks.speed_mps[tracks.row(contact.first_id), max(contact.step - 1, 0)])
