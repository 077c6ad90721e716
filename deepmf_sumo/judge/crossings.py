"""Where a person was when the AV hit it: on a pedestrian crossing, or riding on the road.

Maps do not show lights of pedestrians. Where the AV passed a green light and went straight on, the
crossing behind it was red; where it turned, it was green, and the AV has to give way.
"""

from typing import Final

import numpy as np
import shapely

from deepmf_sumo.judge.avoidability import intention
from deepmf_sumo.judge.conflict_types import Meeting, Who
from deepmf_sumo.judge.metrics.driving import passed_green
from deepmf_sumo.scene import Ints, RoadMap, Rollout
from deepmf_sumo.scene.geometry import road
from deepmf_sumo.scene.geometry.ground import on_level

CROSSING_M: Final = 1.0
"""So far beside the markings people still use a crossing."""
CAME_S: Final = 3.0
"""Who came onto the road in this time before the hit, came in front of the AV."""

_ALONG: Final = float(np.cos(np.pi / 4))
_MOSTLY: Final = 0.5


def on_crossing(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether the other used a pedestrian crossing, or a metre beside it, at the contact.

    A cyclist who rides along the road only passes it.
    """
    return _crossing(road_map, meeting) is not None and not rides(rollout, road_map, meeting)


def _crossing(road_map: RoadMap, meeting: Meeting) -> str | None:
    """Id of the pedestrian crossing on which, or a metre beside which, the other was."""
    place = shapely.Point(meeting.tracks.position_m[meeting.other, meeting.step])
    z_m = meeting.tracks.z_m[meeting.other, meeting.step]
    found = (
        one.id for one in road_map.polygons
        if one.kind == "crosswalk" and len(one.points_m) > 2
        and shapely.dwithin(shapely.Polygon(one.points_m), place, CROSSING_M)
        and on_level(road_map, z_m, one.z_m.mean())
    )  # fmt: skip
    return next(found, None)


def on_road(road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether the other was on a lane, or half a metre beside it, at the contact.

    Cycle lanes are lanes to cyclists alone.
    """
    tracks, at = meeting.tracks, (meeting.other, [meeting.step])
    bicycles = tracks.kinds[meeting.other] == "cyclist"
    return bool(road.on_road(road_map, tracks.position_m[at], tracks.z_m[at], bicycles=bicycles)[0])


def light_let_it_go(rollout: Rollout, meeting: Meeting) -> bool:
    """Whether the AV passed a green light before the crossing there, and went straight on."""
    if meeting.road is None or meeting.turn_rad(0) != 0.0:
        return False
    place = rollout.tracks.position_m[meeting.av, meeting.step]
    crossing = _crossing(meeting.road, meeting) or ""
    return passed_green(rollout, meeting.road, meeting.av, place, crossing)


def before_hit(rollout: Rollout, meeting: Meeting) -> Ints:
    """(K) steps of the last 3 s before the contact at which the other was there."""
    steps = np.arange(max(meeting.step - round(CAME_S / rollout.dt_s), 0), meeting.step)
    return steps[rollout.tracks.valid[meeting.other, steps]]


def rides(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether the other is a cyclist who rode along the road in the last seconds.

    Either way, but not across: mostly within 45 degrees of a lane there, cycle lanes included, and
    never beside the road.
    """
    tracks, row = rollout.tracks, meeting.other
    if tracks.kinds[row] != "cyclist":
        return False
    steps = before_hit(rollout, meeting)
    if not intention.on_road(rollout, road_map, row, steps, bicycles=True).all():
        return False
    places = tracks.position_m[row, steps], tracks.z_m[row, steps]
    under = road.covering(road_map, *places, bicycles=True)
    turn = tracks.heading_rad[row, steps][under.point] - under.heading_rad
    along = np.zeros(len(steps), bool)
    along[under.point[np.abs(np.cos(turn)) > _ALONG]] = True
    return bool(along.mean() > _MOSTLY) if len(steps) else False


def priority(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> Who | None:
    """Who of AV and person goes first; None where the rules for vehicles decide.

    A person does on a crossing, unless the AV's light let it go on; elsewhere on the road the AV.
    """
    if not on_road(road_map, meeting):
        return ""
    if on_crossing(rollout, road_map, meeting):
        return "AV" if light_let_it_go(rollout, meeting) else "opponent"
    return None if rides(rollout, road_map, meeting) else "AV"
