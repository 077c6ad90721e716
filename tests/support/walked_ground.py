"""The invariant of every rollout: people whom we move are where people can be.

Those are the attackers among them, and the made ones, after the start. `off_ground` draws the
ground anew, with shapely, from what the map says; heights do not count here. Who is elsewhere at
first, because a test put it there, is judged from when it comes onto the ground.
"""

from collections.abc import Iterator

import numpy as np
import shapely

from deepmf_sumo.scene import Driver, RoadMap, Rollout
from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord

SLACK_M = 0.05
SEEN_M = 60.0
"""Around the people: the rest of the map is not drawn."""


def use(patch) -> None:
    """Check each rollout, as `continuity.use` does."""
    rollout = EpisodeRecord.rollout

    def checked(record, *given, **more):
        made = rollout(record, *given, **more)
        off = [*off_ground(made, record._road)]
        assert not off, "\n".join(off)
        return made

    patch.setattr(EpisodeRecord, "rollout", checked)


def off_ground(rollout: Rollout, road: RoadMap) -> Iterator[str]:
    """Who is where nobody can be, one sentence for each person."""
    tracks = rollout.tracks
    for row, name in enumerate(tracks.ids):
        if tracks.kinds[row] not in {"pedestrian", "cyclist"}:
            continue
        moved = (rollout.driver[row] == Driver.POLICY) | name.startswith("made_")
        steps = np.flatnonzero(moved & tracks.valid[row])
        steps = steps[steps > rollout.now]
        if not len(steps) or not road.lanes:
            continue
        places = shapely.points(tracks.position_m[row, steps])
        on_it = shapely.intersects(ground(road, shapely.MultiPoint(places)), places)
        off = steps[np.maximum.accumulate(on_it) & ~on_it]
        if len(off):
            yield (
                f"{name} is where nobody can be at {len(off)} steps, first at {off[0]}: "
                f"{tracks.position_m[row, off[0]].round(2).tolist()}"
            )


def ground(road: RoadMap, around: shapely.Geometry) -> shapely.Geometry:
    """The ground near a place."""
    left, low, right, high = around.bounds
    seen = shapely.box(left - SEEN_M, low - SEEN_M, right + SEEN_M, high + SEEN_M)
    lanes = [
        shapely.LineString(one.centre_m).buffer((one.width_m or 3.7) / 2)
        for one in road.lanes.values()
        if len(one.centre_m) > 1 and shapely.LineString(one.centre_m).intersects(seen)
    ]
    edges = [shapely.LineString(one.points_m) for one in road.edges if len(one.points_m) > 1]
    edges = [one for one in edges if one.intersects(seen)]
    open_m = 10.0 if road.footways is None else 2.0
    beside = shapely.union_all([one.buffer(open_m) for one in [*lanes, *edges]])
    barred = shapely.union_all([_area(one) for one in (*road.buildings, *road.water)])
    walked = [_area(one).buffer(0.1) for one in (*road.polygons, *(road.footways or ()))]
    found = shapely.union_all([beside.difference(barred), *lanes, *walked])
    return found.buffer(SLACK_M)


def _area(polygon) -> shapely.Geometry:
    points = polygon.points_m
    return shapely.make_valid(shapely.Polygon(points)) if len(points) > 2 else shapely.Point()
