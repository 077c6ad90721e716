"""Futures of people, without trained weights."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.networks.people import People
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, RoadMap
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS

from tests.support.predictor_doubles import straight_road, straight_tracks, view_of

SIZES = {"pedestrian": (0.6, 0.6, 1.75), "cyclist": (1.8, 0.6, 1.75)}


def person(kind, x, y, heading, speed, road=None):
    """A view with an AV far away and a person."""
    tracks = straight_tracks({"av": (-50.0, 0.0, 0.0, 10.0), "p": (x, y, heading, speed)})
    size = np.array([tracks.size_m[0], SIZES[kind]])
    history = replace(tracks, kinds=("vehicle", kind), size_m=size)
    return replace(view_of({"av": (0.0, 0.0, 0.0, 0.0)}, road=road), history=history)


def turned(view, angle, shift):
    """The view turned around the origin and shifted."""
    tracks, road = view.history, view.road
    history = replace(
        tracks,
        position_m=frames.rotate(tracks.position_m, angle) + shift,
        heading_rad=frames.wrap(tracks.heading_rad + angle),
        velocity_mps=frames.rotate(tracks.velocity_mps, angle),
    )
    lanes = {
        name: replace(lane, centre_m=frames.rotate(lane.centre_m, angle) + shift)
        for name, lane in road.lanes.items()
    }
    return replace(view, history=history, road=RoadMap(lanes=lanes))


@pytest.mark.parametrize(
    ("kind", "y", "speed"),
    [("pedestrian", -4.0, 1.4), ("pedestrian", -4.0, 0.0), ("cyclist", 0.5, 3.7)],
)
def test_a_turned_world_has_the_turned_futures(kind, y, speed):
    view = person(kind, 5.0, y, 0.3, speed)
    angle, shift = 2.1, np.array([5e5, -3e6])
    here = People().predict(view, "p")
    there = People().predict(turned(view, angle, shift), "p")
    moved = frames.rotate(here.position_m, angle) + shift
    assert np.abs(there.position_m - moved).max() < 1e-5
    assert there.share == pytest.approx(here.share)
    drawn = here.position_m[::5] + 0.3
    shown = frames.rotate(drawn, angle) + shift
    assert there.log_density(shown) == pytest.approx(here.log_density(drawn), abs=1e-3)


def test_the_density_of_ends_sums_to_one():
    """Of a trajectory known but at the end: the mass over a grid of ends, by the sum."""
    found = People().predict(person("pedestrian", 0.0, -4.0, 0.0, 1.4), "p")
    grid = np.arange(-30.0, 30.0, 0.25)
    ends = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    mass = np.exp(found.end_density(ends - np.array([0.0, 4.0]), 1.0)).sum() * 0.25**2
    assert mass == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("knot", range(5))
def test_the_density_at_a_knot_sums_to_one(knot):
    """Over a grid of places at one knot, where the others are exact: the others' peaks are left."""
    found = People().predict(person("pedestrian", 0.0, -4.0, 0.0, 1.4), "p")
    one = replace(
        found, position_m=found.position_m[:1], heading_rad=found.heading_rad[:1],
        share=np.ones(1), width_m=found.width_m[:1], along_rad=found.along_rad[:1],
    )  # fmt: skip
    grid = np.arange(-12.0, 12.0, 1 / 5) * float(found.width_m[0, knot].max())
    step = float(grid[1] - grid[0])
    offset = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    there = np.repeat(one.position_m, len(offset), 0)
    there[:, [9, 19, 39, 59, 79][knot]] += offset
    mass = np.exp(one.log_density(there)).sum() * step**2
    peak = float(np.exp(one.log_density(one.position_m))[0])
    others = mass / peak  # the integral of this knot's kernel over its own peak
    assert others == pytest.approx(4 * np.prod(found.width_m[0, knot]), rel=0.05)
    assert peak == pytest.approx(1 / np.prod(4 * found.width_m[0].prod(1)))


def test_who_walks_most_likely_walks_on():
    found = People().predict(person("pedestrian", 0.0, -4.0, 0.5, 1.4), "p")
    first = found.position_m[np.argmax(found.share)]
    expected = np.array([0.0, -4.0]) + 1.4 * 8.0 * np.array([np.cos(0.5), np.sin(0.5)])
    assert first[-1] == pytest.approx(expected, abs=1e-6)


def test_who_stands_stays_as_often_as_not():
    found = People().predict(person("pedestrian", 0.0, -4.0, 0.0, 0.0), "p")
    away = np.hypot(*(found.position_m[:, -1] - [0.0, -4.0]).T)
    assert found.share[away < 1e-9].sum() == pytest.approx(0.5)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2, np.pi, -2.0])
def test_over_the_road_is_among_the_futures(heading):
    """The road runs along x; its lanes reach from y = -1.75 to 5.25."""
    found = People().predict(person("pedestrian", 20.0, -4.0, heading, 0.0), "p")
    across = np.abs(found.position_m[:, -1, 0] - 20.0) < 0.01
    over = across & (found.position_m[:, -1, 1] > 0.0)
    assert found.share[over].sum() > 0.1


def test_a_cyclist_follows_the_bend_of_its_lane():
    angle = np.linspace(0.0, np.pi / 2, 60)
    centre = np.stack([25.0 * np.sin(angle), 25.0 * (1 - np.cos(angle))], -1)
    road = straight_road()
    lane = replace(road.lanes["0"], centre_m=centre, z_m=np.zeros(60))
    view = person("cyclist", 2.0, -1.0, 0.0, 4.0, RoadMap(lanes={"0": lane}))
    found = People().predict(view, "p")
    radius = np.hypot(*(found.position_m - [0.0, 25.0]).swapaxes(0, -1))  # (80, N)
    beside = np.abs(radius - radius[0]).max(0) < 0.2
    assert found.share[beside].sum() > 0.2  # at every speed


@pytest.mark.parametrize(
    ("kind", "speed"), [("pedestrian", 0.0), ("pedestrian", 1.4), ("cyclist", 4.0)]
)
def test_nobody_moves_faster_than_its_class(kind, speed):
    found = People().predict(person(kind, 5.0, -1.0, 0.0, speed), "p")
    moved = np.hypot(*np.diff(found.position_m, axis=1).swapaxes(0, -1)) / DT_S
    own = ROAD_USERS["bicycle" if kind == "cyclist" else kind].motion
    assert moved.max() <= own.fastest_mps + 1e-6
    gained = np.diff(moved, axis=0) / DT_S
    # chords over the corners of a way are a little shorter than the way
    assert gained.max() <= own.planned.accel + 0.4
    assert gained.min() >= -own.planned.brake - 0.4


def test_modes_are_few_where_few_are_asked_for():
    found = People().predict(person("pedestrian", 0.0, -4.0, 0.0, 1.4), "p")
    for count in (1, 6, 32):
        modes = found.modes(count)
        assert modes.futures.position_m.shape == (count, FUTURE_STEPS, 2)
        assert modes.probability.sum() == pytest.approx(1.0)
        assert (np.diff(modes.probability) <= 1e-7).all()
    ends = found.modes(32).futures.position_m[:, -1]
    apart = np.hypot(*(ends[:, None] - ends).swapaxes(0, -1)) + 10 * np.eye(32)
    assert np.median(apart.min(0)) > 0.5  # they cover where it may be


def test_a_cyclist_near_the_end_of_a_long_lane_goes_on_along_the_next_one():
    """A lane of 400 m to x = 300, then one that leads to the left."""
    road = straight_road(lanes=1)
    first = replace(road.lanes["0"], next=("left",))
    bend = np.linspace(0.0, np.pi / 2, 30)
    centre = np.stack([300 + 20 * np.sin(bend), 20 * (1 - np.cos(bend))], -1)
    left = replace(first, id="left", centre_m=centre, z_m=np.zeros(30), next=())
    view = person("cyclist", 290.0, -1.0, 0.0, 4.0, RoadMap(lanes={"0": first, "left": left}))
    found = People().predict(view, "p")
    turned = np.abs(frames.difference(found.heading_rad[:, 60], 0.0)) > 0.5
    beside = np.hypot(*(found.position_m[:, 60] - [300.0, 20.0]).T) - 21.0
    assert found.share[turned & (np.abs(beside) < 0.5)].sum() > 0.2


@pytest.mark.parametrize(("kind", "y"), [("cyclist", 0.5), ("pedestrian", -4.0)])
def test_a_road_on_another_level_is_not_theirs(kind, y):
    """A bridge along y, 6 m above a road along x: who is below it does not take it."""
    below = straight_road(lanes=1).lanes["0"]
    centre = np.stack([np.zeros(81), np.linspace(-100.0, 300.0, 81)], -1)
    above = replace(below, id="above", centre_m=centre, z_m=np.full(81, 6.0))
    heading = np.pi / 2 if kind == "cyclist" else 0.0  # along the bridge
    both = person(kind, 0.5, y, heading, 1.4, RoadMap(lanes={"0": below, "above": above}))
    alone = replace(both, road=RoadMap(lanes={"0": below}))
    here, there = (People().predict(one, "p") for one in (both, alone))
    assert here.position_m == pytest.approx(there.position_m)
