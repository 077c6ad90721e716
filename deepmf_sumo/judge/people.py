"""What hits by pedestrians and cyclists are worth: the rules of the ladder that people need.

The rungs are those of `ladder`. What differs from vehicles:

- **Errors of the AV**: it strikes a person who stood on the road, in sight, for 2.5 s; it runs a
  red light; it left the road, and hits somebody there; it hits somebody on a pedestrian crossing,
  unless its light let it go straight on. A
  cyclist who rode on the road has the rights of a vehicle, too. Not giving way at a crossing is
  an error only where the driver of `avoidability.intention` would have: nobody gives way to whom
  nobody could see.
- **Errors of the person**: a pedestrian stepped, a cyclist rode, onto the road where there is no
  crossing, or against a light; a cyclist rode against the traffic. Pedestrians have no direction of
  traffic, and no place is off the road for them: beside it is where they belong.
- **Contrived**: the AV stood or crept; its speed at the impact was below 5 km/h (its own change of
  velocity says nothing: people are light); the person ran into its side or rear; no person moves
  like that; one of the two had touched another before.

What a crossing's light was is inferred from the AV's, see `crossings`.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from deepmf_sumo.judge import impact
from deepmf_sumo.judge.avoidability import intention
from deepmf_sumo.judge.conflict_types import Meeting
from deepmf_sumo.judge.crossings import before_hit, light_let_it_go, on_crossing, on_road, rides
from deepmf_sumo.judge.hits import Hit
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.scene import Ints, RoadMap, Rollout
from deepmf_sumo.scene.geometry import road

LEAST_IMPACT_MPS: Final = 5.0 / 3.6
"""Walking speed: cars that roll against people as slowly push them."""
_RIDING_MPS: Final = 1.0
_MOSTLY: Final = 0.5


def contrived(episode: Episode, hit: Hit) -> Iterator[str]:
    """What makes a hit by a person say little about the AV, besides the reasons of all hits."""
    rollout, contact = episode.rollout, episode.rollout.first("av_opponent")
    assert contact is not None
    if rollout.tracks.speed_mps[hit.meeting.av, max(contact.step - 1, 0)] < LEAST_IMPACT_MPS:
        yield "low_impact_speed"
    face = impact.first_touch(rollout, contact).ran_into
    if face is not None:
        yield "ran_into_rear" if face == "rear" else "ran_into_side"


def stood(episode: Episode, meeting: Meeting, steps: Ints) -> bool:
    """Whether a person who stood at some steps (K) did so on the road, and in sight."""
    rollout, road_map, row = episode.rollout, episode.case.road, meeting.other
    if not intention.on_road(rollout, road_map, row, steps).all():
        return False
    return intention.in_sight_for(rollout, road_map, row, steps)


def av_error(episode: Episode, hit: Hit) -> str | None:
    """What the AV did wrong to a person who did not stand there; empty for nothing.

    None where the rules for vehicles decide.
    """
    if not on_road(episode.case.road, hit.meeting):
        return "left_road" if _left_road(episode.rollout, episode.case.road, hit.meeting) else ""
    if on_crossing(episode.case.road, hit.meeting):
        return "" if light_let_it_go(episode.rollout, hit.meeting) else "took_crossing"
    return None if rides(episode.rollout, episode.case.road, hit.meeting) else ""


def opponent_error(episode: Episode, hit: Hit) -> str | None:
    """What the person did wrong; empty for nothing, None where the rules for vehicles decide."""
    rollout, meeting, road_map = episode.rollout, hit.meeting, episode.case.road
    if not on_road(road_map, meeting):
        return ""
    if on_crossing(road_map, meeting):
        return "crossed_on_red" if light_let_it_go(rollout, meeting) else ""
    if rollout.tracks.kinds[meeting.other] == "pedestrian":
        return "stepped_out"
    if not rides(rollout, road_map, meeting):
        return "rode_out"
    return "rode_against" if _against_traffic(rollout, road_map, meeting) else None


def _left_road(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether the AV was on the road before the hit, and no longer is."""
    steps = before_hit(rollout, meeting)
    tracks, row = rollout.tracks, meeting.av
    there = road.on_road(road_map, tracks.position_m[row, steps], tracks.z_m[row, steps])
    return bool(there.any() and not there[-1])


def _against_traffic(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether a cyclist mostly rode against the direction of its lanes."""
    tracks, row, steps = rollout.tracks, meeting.other, before_hit(rollout, meeting)
    velocity = tracks.velocity_mps[row, steps]
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    against = road.against_traffic(
        road_map, tracks.position_m[row, steps], course, tracks.z_m[row, steps]
    )
    against &= np.hypot(*velocity.T) > _RIDING_MPS
    return bool(len(steps) and against.mean() > _MOSTLY)
