"""Places are apart by distance, wherever borders of cells happen to be."""

import itertools
from dataclasses import asdict, replace

import numpy as np
import pytest

from deepmf_sumo.training.samples import places
from deepmf_sumo.training.samples.places import (
    APART_M,
    CELL_M,
    SceneArea,
    area_of,
    held_out,
    numbered,
)

from tests.support.synthetic import scene


def moved(shift, **more):
    """The scene, moved as a whole."""
    made = scene(**more)
    tracks = replace(made.tracks, position_m=made.tracks.position_m + np.array(shift, float))
    return replace(made, tracks=tracks)


def cells_of(*points):
    return tuple(sorted({(int(x // CELL_M), int(y // CELL_M)) for x, y in points}))


def connected(areas):
    """The same by hand: centres of cells, all pairs, until nothing changes."""
    place = list(range(len(areas)))
    for _ in areas:
        for one, two in itertools.combinations(range(len(areas)), 2):
            if areas[one].frame != areas[two].frame:
                continue
            a, b = (np.array(areas[each].cells) * CELL_M for each in (one, two))
            gap = np.hypot(*(a[:, None] - b[None]).reshape(-1, 2).T).min()
            if gap <= APART_M + np.hypot(CELL_M, CELL_M):
                place = [
                    min(place[one], place[two]) if n in (place[one], place[two]) else n
                    for n in place
                ]
    return place


@pytest.mark.parametrize("seed", range(5))
def test_places_are_the_groups_of_scenes_that_are_near_each_other(seed):
    draws = np.random.default_rng(seed)
    areas = [
        SceneArea(chosen, cells_of(*(draws.uniform(0, 1500, 2) + draws.normal(0, 30, (4, 2)))))
        for chosen in draws.choice(["", "net"], 40)
    ]
    number, expected = numbered(areas), connected(areas)
    assert len(set(number)) == len(set(expected)) > 2
    assert len(set(zip(number.tolist(), expected, strict=True))) == len(set(expected))
    assert number[0] == 0


@pytest.mark.parametrize("x", [499.0, 501.0, 999.5, -0.5])
def test_scenes_a_few_metres_apart_are_of_one_place(x):
    areas = [area_of(moved((x, 0.0))), area_of(moved((x + 2.0, 0.0)))]
    assert numbered(areas).tolist() == [0, 0]


def test_vehicles_of_two_places_are_never_within_100_m():
    extent = scene().tracks
    west, east = (
        extent.position_m[extent.valid][:, 0].min(),
        extent.position_m[extent.valid][:, 0].max(),
    )
    near, far = APART_M - 1.0, APART_M + 3 * CELL_M
    for gap, count in ((near, 1), (far, 2)):
        other = area_of(moved((east - west + gap, 0.0)))
        assert len(set(numbered([area_of(scene()), other]).tolist())) == count


def test_what_lies_between_two_scenes_connects_them():
    row = [SceneArea("", cells_of((120.0 * number, 0.0))) for number in range(9)]
    assert set(numbered(row).tolist()) == {0}
    assert numbered(row[::3]).tolist() == [0, 1, 2]


def test_networks_have_their_own_frames():
    given = scene()
    nets = [
        replace(given, source=replace(given.source, dataset="sumo", file=file))
        for file in ("grid-1-003", "grid-1-004", "town.sumocfg", "a.tfrecord", "b.pkl")
    ]
    assert numbered([area_of(each) for each in nets]).tolist() == [0, 1, 2, 3, 3]


def test_areas_are_kept_in_json():
    area = area_of(scene())
    assert SceneArea.read(asdict(area)) == area


def test_about_one_place_in_ten_is_held_out_in_any_order():
    areas = [SceneArea("", ((50 * (number // 3), 7),)) for number in range(600)]
    samples = np.arange(600) % 4
    kept, is_apart = held_out(areas, samples)
    assert is_apart
    assert 0.05 < kept.mean() < 0.16
    assert (kept.reshape(-1, 3) == kept.reshape(-1, 3)[:, :1]).all()
    order = np.random.default_rng(1).permutation(600)
    again, _ = held_out([areas[row] for row in order], samples[order])
    assert np.array_equal(again, kept[order])


@pytest.mark.parametrize("count", [2, 3, 5, 9])
def test_of_few_places_one_is_held_out_and_never_most_samples(count):
    for start in range(20):
        areas = [SceneArea("", ((50 * (start + number), 0),)) for number in range(count)]
        samples = np.array([100, *[10] * (count - 1)])
        kept, is_apart = held_out(areas, samples)
        assert is_apart
        assert kept.any()
        assert not kept[0] or count > 9
        assert samples[kept].sum() <= samples.sum() / 2


def test_at_most_half_of_the_samples_are_held_out_whatever_is_drawn(monkeypatch):
    monkeypatch.setattr(places, "_draws", lambda areas, _: [0] * len(areas))
    areas = [SceneArea("", ((50 * number, 0),)) for number in range(9)]
    kept, _ = held_out(areas, np.ones(9, int))
    assert kept.sum() == 4


def test_places_without_samples_are_not_what_is_held_out():
    areas = [SceneArea("", ((50 * number, 0),)) for number in range(40)]
    samples = np.zeros(40, int)
    samples[[4, 17]] = 5
    kept, is_apart = held_out(areas, samples)
    assert is_apart
    assert samples[kept].sum() == 5


def test_scenes_of_one_place_are_held_out_one_by_one():
    areas = [SceneArea("", ((0, 0),))] * 20
    kept, is_apart = held_out(areas, np.ones(20, int))
    assert not is_apart
    assert np.flatnonzero(kept).tolist() == [9, 19]
