"""What a person sees of a map: in pictures and on the page, and who is hidden behind buildings."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from deepmf_sumo.report.drawing import draw_road, square
from deepmf_sumo.report.map_layers import LAYERS
from deepmf_sumo.report.page import document
from deepmf_sumo.report.page.replay import OTHERS_EVERY, replay
from deepmf_sumo.report.page.roads import PageRoads
from deepmf_sumo.scene import Lane, Polygon, Polyline, RoadMap
from deepmf_sumo.scene.geometry import boxes

from tests.report.test_page import javascript, unpacked
from tests.support.rollout_doubles import rollout_of, straight

AREAS = {"water": (-30, 30), "building": (0, 30), "footway": (30, 30), "track": (-30, -30),
         "crosswalk": (20, 0)}  # fmt: skip


def area(kind, x, y, half=4.0):
    """A square around a place."""
    ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + (x, y)
    return Polygon(id=f"{kind} {x} {y}", kind=kind, points_m=ring, z_m=np.zeros(4))


def lane(name, start, end, **more):
    return Lane(
        id=name, kind="street", centre_m=[start, end], z_m=[0, 0], width_m=8.0, **more
    )  # fmt: skip


def everything():
    """A road with a feature of each kind, none on another but on lanes."""
    areas = {kind: area(kind, *place) for kind, place in AREAS.items()}
    return RoadMap(
        lanes={
            "a": lane("a", (-60, 0), (60, 0)),
            "b": lane("b", (0, -32), (0, -28), interpolating=True),
        },
        lines=(Polyline(id="l", kind=1, points_m=[(-60, 20), (60, 20)], z_m=[0, 0]),),
        edges=(Polyline(id="e", kind=1, points_m=[(-60, -20), (60, -20)], z_m=[0, 0]),),
        polygons=(areas["crosswalk"],),
        buildings=(areas["building"],),
        water=(areas["water"],),
        footways=(areas["footway"], areas["track"]),
    )


def pixels(road, side_m=100.0):
    """(1000, 1000, 3) picture of a square around the origin, and a function place -> pixel."""
    figure = Figure(figsize=(10, 10), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    draw_road(axes, road, square(np.zeros(2), side_m), 10.0)
    axes.set(xlim=(-side_m / 2, side_m / 2), ylim=(-side_m / 2, side_m / 2))
    axes.axis("off")
    canvas.draw()
    shown = np.asarray(canvas.buffer_rgba())[..., :3] / 255
    return lambda x, y: shown[round(500 - 10 * y), round(500 + 10 * x)]


def test_every_area_is_in_a_picture_at_its_place_in_its_colour():
    at = pixels(everything())
    fills = {one.name: to_rgb(one.fill.light) for one in LAYERS if one.fill}
    places = {**AREAS, "lane": (-40, 2), "junction": (0.5, -30)}
    found = {
        kind: min(
            np.abs(at(x + dx, y + dy) - fills[kind]).max() for dx in (0, 0.7) for dy in (0, 0.7)
        )
        for kind, (x, y) in places.items()
    }
    assert fills.keys() == found.keys()
    assert max(found.values()) < 0.01, found
    assert (at(-40, 10) == 1).all()  # nothing is there


def test_a_crossing_is_on_the_road_and_the_road_on_a_building():
    """Over a tunnel, and under a bridge, the road must be seen."""
    road = replace(everything(), buildings=(area("building", -40, 0),))
    fills = {one.name: to_rgb(one.fill.light) for one in LAYERS if one.fill}
    at = pixels(road)
    assert np.abs(at(-40, 2) - fills["lane"]).max() < 0.01
    assert np.abs(at(20.2, 1.1) - fills["lane"]).max() > 0.02


class OnRoad:
    """What `PageRoads` asks a run."""

    run_id, scene, source, folder = "r", "s", {"recording": "none"}, None

    def __init__(self, road):
        self._road = road

    def road(self):
        return self._road, ""


def test_the_page_has_what_pictures_have():
    roads = PageRoads()
    roads.add(OnRoad(everything()), np.zeros((1, 2)))
    shapes = unpacked(roads.packed()[0])["shapes"]
    assert {kind for kind, *_ in shapes} == {one.of for one in LAYERS}
    _, width, x, y = next(one for one in shapes if one[0] == "building")
    corners = np.cumsum([x, y], axis=1).T * 0.1 + unpacked(roads.packed()[0])["origin"]
    assert shapely.Polygon(corners).equals(shapely.Polygon(area("building", 0, 30).points_m))
    assert width == 0


def test_the_page_has_a_colour_for_each_layer_in_both_themes():
    sheet = document._map_colours()
    light, dark, media = sheet.split("\n")[:3]
    for one in LAYERS:
        for shade, name in ((one.fill, one.name), (one.edge, f"{one.name}-edge")):
            if shade:
                assert f"--map-{name}:{shade.light};" in light
                assert f"--map-{name}:{shade.dark};" in dark
                assert f"--map-{name}:{shade.dark};" in media


WALL = Polygon(
    id="house", kind="building", points_m=[(20, 5), (40, 5), (40, 15), (20, 15)], z_m=np.zeros(4)
)  # fmt: skip


def test_who_is_behind_a_house_is_hidden_as_long_as_all_lines_to_it_cross_the_house():
    """By shapely, from the middle of the AV's windscreen to all of the box."""
    paths = {"av": straight(0, 0, 10), "b": straight(45, 12, 0.0), "c": straight(-20, 0, 0.0)}
    rollout = rollout_of(paths)
    content = replay(rollout, np.zeros(2), road=RoadMap(lanes={}, buildings=(WALL,)))
    agents = {one["id"]: one for one in content["agents"]}
    assert "unseen" not in agents["c"]
    (span,) = agents["b"]["unseen"]
    house = shapely.Polygon(WALL.points_m)
    box = boxes.corners(np.array([45.0, 12.0]), np.array(0.0), np.array([4.8, 2.0]))
    sample = shapely.points(np.linspace(box.min(axis=0), box.max(axis=0), 9))
    for step in range(rollout.now, rollout.tracks.steps, OTHERS_EVERY):
        eye = shapely.Point(paths["av"][step][0] + 2.4 - 1.92, 0)
        crossed = [house.intersects(shapely.LineString([eye, one])) for one in sample]
        if all(crossed) or not any(crossed):
            assert (span[0] <= step <= span[1]) == all(crossed), step


@pytest.mark.sumo
def test_the_page_knows_who_is_hidden_when():
    agent = json.dumps({"unseen": [[10, 11], [20, 25]]})
    asked = f"[9, 10, 11.9, 12, 25.4, 26].map((step) => isUnseen({agent}, step))"
    found = javascript(["packing", "scene"], asked)
    assert found == [False, True, True, False, True, False]


@pytest.mark.sumo
@pytest.mark.parametrize(
    ("onset", "turns", "begins"),
    [(33, [], 33), (None, [], 10), (None, [{"begin": 2.5, "decisive": True}], 35)],
)
def test_a_replay_begins_where_the_danger_shows(onset, turns, begins):
    scene = json.dumps({"onset": onset, "turns": turns, "now": 10, "dt": 0.1})
    assert javascript(["turns"], f"beginOf({scene})") == begins
