"""Who can be seen from the AV: drawn scenes, and shapely as an independent oracle."""

import time

import numpy as np
import pytest
import shapely

from deepmf_sumo.scene import Polygon, RoadMap, Tracks
from deepmf_sumo.scene.geometry import boxes, sight

CAR, TRUCK = (4.7, 2.0, 1.5), (12.0, 2.9, 3.3)
ADULT, CHILD, RIDER = (0.5, 0.5, 1.75), (0.4, 0.4, 1.1), (1.8, 0.8, 1.75)
OPEN = RoadMap(lanes={})
AV = ("av", "vehicle", CAR, 0.0, 0.0)


def tracks_of(*agents):
    """One step of agents: id, kind, size, x, y, and heading and ground where they are not 0."""
    full = [(*one, *(0.0, 0.0)[len(one) - 5 :]) for one in agents]
    return Tracks(
        ids=tuple(one[0] for one in full),
        kinds=tuple(one[1] for one in full),
        size_m=np.array([one[2] for one in full], float),
        position_m=np.array([[one[3:5]] for one in full], float),
        z_m=np.array([[one[6]] for one in full], float),
        heading_rad=np.array([[one[5]] for one in full], float),
        velocity_mps=np.zeros((len(full), 1, 2)),
        valid=np.ones((len(full), 1), bool),
    )


def shares(*agents, road=OPEN):
    found = tracks_of(AV, *agents)
    return dict(zip(found.ids, sight.shares(found, 0, 0, road), strict=True))


def block(x, y, length=20.0, width=10.0):
    corners = boxes.corners(np.array([x, y]), np.array(0.0), np.array([length, width]))
    return RoadMap(lanes={}, buildings=(
        Polygon(id="house", kind="building", points_m=corners, z_m=np.zeros(4)),
    ))  # fmt: skip


def test_the_eye_is_behind_the_windscreen():
    """Of a car of 4.7 m: 1.88 m behind the front, at 1.2 m; of a truck 2 m and 2.33 m."""
    eye = sight.Eye.of(np.array([10.0, 5.0]), np.pi / 2, np.array(CAR), 3.0)
    np.testing.assert_allclose(eye.position_m, [10.0, 5.0 + 4.7 / 2 - 1.88], atol=1e-9)
    assert eye.z_m == pytest.approx(4.2)
    eye = sight.Eye.of(np.zeros(2), 0.0, np.array(TRUCK), 0.0)
    np.testing.assert_allclose(eye.position_m, [4.0, 0.0])
    assert eye.z_m == 2.33


def test_nothing_hides_who_stands_in_the_open_or_in_front():
    person = ("p", "pedestrian", ADULT, 20.0, 3.0)
    assert shares(person) == {"av": 1.0, "p": 1.0}
    assert shares(person, ("t", "vehicle", TRUCK, 40.0, 6.0))["p"] == 1.0
    assert shares(person, ("t", "vehicle", TRUCK, 12.0, 10.0))["p"] == 1.0
    assert shares(person, ("q", "pedestrian", ADULT, 10.0, 1.5))["p"] == 1.0


def test_a_truck_hides_an_adult_and_a_car_hides_a_child():
    truck, car = ("t", "vehicle", TRUCK, 14.0, 3.0), ("t", "vehicle", CAR, 14.0, 3.0)
    adult, child = ("p", "pedestrian", ADULT, 24.0, 5.0), ("p", "pedestrian", CHILD, 24.0, 5.0)
    assert shares(truck, adult)["p"] == 0.0
    assert shares(truck, child)["p"] == 0.0
    assert shares(car, child)["p"] == 0.0


@pytest.mark.parametrize(("nearer_m", "hidden"), [(6.0, False), (6.1, True)])
def test_the_head_of_an_adult_shows_over_a_car_near_him(nearer_m, hidden):
    """By hand: 20 m away the line rises from 1.2 m to 1.63 m and is at 1.5 m after 13.95 m.

    A car across the way that begins before that hides the head, however short the rest is.
    """
    eye_m = 4.7 / 2 - 0.4 * 4.7
    adult = ("p", "pedestrian", (0.02, 0.5, 1.75), eye_m + 20.01, 0.0)
    car = ("c", "vehicle", (4.7, 2.0, 1.5), eye_m + 20.0 - nearer_m + 1.0, 0.0, np.pi / 2)
    assert shares(adult, car)["p"] == (0.0 if hidden else 1.0)


def test_a_truck_hides_the_half_that_is_behind_it():
    """Its far corner at (14, 1) is in line with (20, 1.43), the middle of a box 20 m away."""
    eye_m = 4.7 / 2 - 0.4 * 4.7
    truck = ("t", "vehicle", (4.0, 4.0, 3.3), eye_m + 12.0, 3.0)
    wide = ("p", "cyclist", (0.02, 1.8, 1.75), eye_m + 20.0, 20 / 14)
    assert shares(truck, wide)["p"] == pytest.approx(0.5, abs=1 / sight.COLUMNS)
    found = tracks_of(AV, truck, (*wide[:4], 1.0))
    assert list(sight.visible(found, 0, 0, OPEN)) == [True, True, True]
    found = tracks_of(AV, truck, (*wide[:4], 3.0))
    assert list(sight.visible(found, 0, 0, OPEN)) == [True, True, False]


def test_houses_hide_and_the_one_that_the_eye_is_in_does_not():
    person = ("p", "pedestrian", ADULT, 20.0, 30.0)
    assert shares(person, road=block(10.0, 15.0))["p"] == 0.0
    assert shares(person, road=block(10.0, -15.0))["p"] == 1.0
    assert shares(person, road=block(40.0, 60.0))["p"] == 1.0
    assert shares(person, road=block(0.0, 0.0))["p"] == 1.0  # the AV is below it


def test_what_is_on_a_bridge_does_not_hide_what_is_below():
    person = ("p", "pedestrian", ADULT, 30.0, 0.0)
    above = ("t", "vehicle", TRUCK, 15.0, 0.0, np.pi / 2, 6.0)
    assert shares(person, above)["p"] == 1.0
    assert shares(person, (*above[:6], 0.0))["p"] == 0.0


def test_parts_of_one_vehicle_hide_neither_each_other_nor_what_the_av_pulls():
    tram = ("tram", "other", (10.0, 2.4, 3.4), 20.0, 0.0)
    behind = ("tram part 2", "other", (10.0, 2.4, 3.4), 30.5, 0.0)
    assert shares(tram, behind)["tram part 2"] == 1.0
    own = ("av part 2", "vehicle", TRUCK, -9.0, 0.0)
    person = ("p", "pedestrian", ADULT, -30.0, 0.0)
    found = shares(own, person)
    assert (found["av part 2"], found["p"]) == (1.0, 1.0)


def test_who_has_no_known_height_has_that_of_its_class():
    person = ("p", "pedestrian", (0.5, 0.5, 0.0), 24.0, 0.0)
    assert shares(person, ("t", "vehicle", (12.0, 2.9, 0.0), 14.0, 0.0))["p"] == 0.0
    child = ("p", "pedestrian", CHILD, 24.0, 0.0)
    assert shares(child, ("t", "vehicle", (4.7, 2.0, 0.0), 14.0, 0.0))["p"] == 0.0


def test_who_is_absent_is_not_seen_and_hides_nobody():
    found = tracks_of(AV, ("t", "vehicle", TRUCK, 14.0, 0.0), ("p", "pedestrian", ADULT, 30.0, 0.0))
    there = found.valid.copy()
    there[1] = False
    gone = Tracks(**{**{n: getattr(found, n) for n in found.__slots__}, "valid": there})
    assert list(sight.visible(gone, 0, 0, OPEN)) == [True, False, True]
    assert not sight.visible(gone, 0, 1, OPEN).any()


def _crowd(rng, count, road=OPEN):
    """Vehicles and people at random places, which do not overlap the AV."""
    agents = [AV]
    while len(agents) < count:
        x, y = rng.uniform(-50, 50, 2)
        if np.hypot(x, y) < 9:
            continue
        kind, size = [("vehicle", CAR), ("vehicle", TRUCK), ("pedestrian", ADULT),
                      ("cyclist", RIDER)][rng.integers(4)]  # fmt: skip
        agents.append((f"a{len(agents)}", kind, size, x, y, rng.uniform(-3, 3)))
    return tracks_of(*agents)


def _by_shapely(tracks, road):
    """Share of many lines to the outer width of each box that meet no polygon: heights, too."""
    pose = tracks.position_m[:, 0], tracks.heading_rad[:, 0], tracks.size_m
    eye = sight.Eye.of(pose[0][0], pose[1][0], tracks.size_m[0], 0.0)
    hulls = [shapely.Polygon(boxes.corners(p, h, s[:2])) for p, h, s in zip(*pose, strict=True)]
    start = shapely.Point(eye.position_m)
    found = [1.0]
    for row, hull in list(enumerate(hulls))[1:]:
        ring = np.array(hull.exterior.coords)[:-1]
        # the outermost corners are those whose lines from the eye do not cross the box
        free = [p for p in ring if shapely.LineString([start, p]).intersection(hull).length < 1e-9]
        ends = max(((a, b) for a in free for b in free),
                   key=lambda two: _turn(eye, *two))  # fmt: skip
        height = tracks.size_m[row, 2] - 0.12
        share = ((np.arange(90) + 0.5) / 90)[:, None]
        points = ends[0] + share * (ends[1] - ends[0])
        begins = np.broadcast_to(eye.position_m, points.shape)
        lines = shapely.linestrings(np.stack([begins, points], 1))
        met = np.zeros(len(lines), bool)
        for other in range(1, len(hulls)):
            if other != row and tracks.kinds[other] == "vehicle":
                met |= _meets(lines, hulls[other], eye.z_m, height, tracks.size_m[other, 2])
        for house in road.buildings:
            met |= shapely.length(shapely.intersection(lines, shapely.Polygon(house.points_m))) > 0
        found.append(1 - met.mean())
    return np.array(found)


def _turn(eye, one, other):
    a, b = one - eye.position_m, other - eye.position_m
    return abs(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _meets(lines, hull, from_m, to_m, height_m):
    met = []
    for line, inside in zip(lines, shapely.intersection(lines, hull), strict=True):
        at = [
            line.project(shapely.Point(p), normalized=True) for p in shapely.get_coordinates(inside)
        ]
        deep = shapely.length(inside) > 1e-9
        met.append(deep and min(from_m + (to_m - from_m) * one for one in at) < height_m)
    return np.array(met)


@pytest.mark.parametrize("seed", range(3))
def test_it_agrees_with_shapely(seed):
    rng = np.random.default_rng(seed)
    road = block(20.0, 30.0) if seed % 2 else OPEN
    tracks = _crowd(rng, 30)
    found, other = sight.shares(tracks, 0, 0, road), _by_shapely(tracks, road)
    np.testing.assert_allclose(found[1:], other[1:], atol=1.01 / sight.COLUMNS)
    assert {0.0, 1.0} <= set(found)
    assert ((found > 0) & (found < 1)).any()


def test_turning_the_whole_scene_changes_nothing():
    rng = np.random.default_rng(7)
    tracks = _crowd(rng, 60)
    found = sight.shares(tracks, 0, 0, OPEN)
    for angle in (1.0, 2.5, -2.9):
        cos, sin = np.cos(angle), np.sin(angle)
        turned = tracks.position_m @ np.array([[cos, sin], [-sin, cos]]) + 100
        fields = {name: getattr(tracks, name) for name in tracks.__slots__}
        fields |= {"position_m": turned, "heading_rad": tracks.heading_rad + angle}
        np.testing.assert_allclose(sight.shares(Tracks(**fields), 0, 0, OPEN), found, atol=1e-9)


def test_two_hundred_road_users_take_little_time():
    """About 1 ms on an idle machine; the best of many, with room for a busy one."""
    tracks = _crowd(np.random.default_rng(1), 200)
    sight.shares(tracks, 0, 0, OPEN)
    taken = []
    for _ in range(40):
        begin = time.process_time()
        sight.shares(tracks, 0, 0, OPEN)
        taken.append(time.process_time() - begin)
    assert min(taken) < 0.01
