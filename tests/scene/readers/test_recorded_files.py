"""Real recordings, where they are at hand."""

import csv
import time

import numpy as np
import pytest

from deepmf_sumo.scene import readers
from deepmf_sumo.scene.readers import Refusal

pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module")
def index(womd):
    with (womd / "index.csv").open(newline="") as file:
        return {row["scenario_id"]: row for row in csv.DictReader(file)}


def assert_as_indexed(scene, row):
    kinds = scene.tracks.kinds
    assert scene.tracks.steps == int(row["steps"])
    assert kinds.count("vehicle") == int(row["vehicles"]) + 1  # the index leaves out the AV
    assert kinds.count("pedestrian") == int(row["pedestrians"])
    assert kinds.count("cyclist") == int(row["cyclists"])
    assert len(scene.road.lanes) == int(row["lanes"])
    assert len(scene.signals.lane_ids) == int(row["signals"])
    assert list(scene.interest) == row["objects_of_interest"].split(";")[: len(scene.interest)]
    assert scene.tracks.size_m[scene.tracks.row(scene.av_id), :2] == pytest.approx(
        [5.286, 2.332], abs=2e-3
    )


def assert_split(womd, index, split, expected):
    start = time.perf_counter()
    found = list(readers.scenes([womd / split]))
    seconds = (time.perf_counter() - start) / len(found)
    assert len(found) == expected
    assert not [one for one in found if isinstance(one, Refusal)]
    for scene in found:
        assert_as_indexed(scene, index[scene.name])
    assert seconds < 0.5  # about 0.02 on an idle machine; this finds only what is far off
    return found


def test_all_scenes_of_val_are_read(womd, index):
    found = assert_split(womd, index, "val", 80)
    assert all(scene.av_id in scene.interest for scene in found)
    assert all(scene.partner_id for scene in found)


@pytest.mark.slow
def test_all_scenes_of_train_are_read(womd, index):
    assert_split(womd, index, "train", 709)


@pytest.mark.parametrize(
    ("part", "agents", "lanes", "interest", "repairs"),
    [
        ("gpudrive_v1", 21, 15, (), 0),
        ("gpudrive_v3", 36, 12, ("359", "462"), 0),
        ("motion_data", 83, 199, (), 0),
        ("nocturne_early", 11, 64, (), 6),
        ("scenarionet", 7, 94, ("2004", "1058"), 0),
        ("sd_waymo", 44, 62, (), 0),
        ("womd_scenario", 257, 114, ("625", "2694"), 0),
    ],
)
def test_original_files_of_all_formats_are_read(womd, part, agents, lanes, interest, repairs):
    (file,) = (womd / "originals").glob(f"{part}*")
    (scene,) = readers.scenes([file])
    assert scene.tracks.agents == agents
    assert len(scene.road.lanes) == lanes
    assert scene.interest == interest
    assert len(scene.repairs) == repairs
    moving = scene.tracks.valid & (scene.tracks.speed_mps > 3)
    velocity = scene.tracks.velocity_mps[moving]
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    assert np.median(np.cos(scene.tracks.heading_rad[moving] - direction)) > 0.99


@pytest.mark.parametrize(
    ("part", "split"),
    [
        ("gpudrive_v3", "val"),
        ("scenarionet", "train"),
        ("sd_waymo", "train"),
        ("gpudrive_v1", "train"),
    ],
)
def test_an_original_is_the_scene_of_the_shards(womd, index, part, split):
    (file,) = (womd / "originals").glob(f"{part}*")
    (original,) = readers.scenes([file])
    names = [
        name
        for name in index
        if name in {original.name, original.name.replace("gpudrive_v1_degrees_", "json-")}
    ]
    (name,) = names
    twin = readers.scene(womd / split / index[name]["shard"], name)
    rows = [twin.tracks.ids.index(agent) for agent in original.tracks.ids]
    same = twin.tracks.select(rows)
    assert np.array_equal(same.valid, original.tracks.valid)
    # The shards' numbers are rounded to 2^-10 m and 2^-14 rad, m/s; degrees are rounded as such.
    assert np.abs(same.position_m - original.tracks.position_m).max() < 2e-3
    assert np.abs(np.sin(same.heading_rad - original.tracks.heading_rad)).max() < 1e-3
    assert np.abs(same.velocity_mps - original.tracks.velocity_mps).max() < 1e-3
    assert (twin.av_id, twin.interest) == (original.av_id, original.interest)
    kept = [lane for lane in original.road.lanes.values() if lane.id in twin.road.lanes]
    for lane in kept if "v1" not in part else []:
        recorded = twin.road.lanes[lane.id]
        assert np.abs(recorded.centre_m - lane.centre_m).max() < 5e-3
        assert set(recorded.next) <= set(lane.next)


def test_inferred_links_match_recorded_ones(womd, index):
    from deepmf_sumo.scene.readers.raw import lane_links

    recorded = inferred = common = 0
    for scene in readers.scenes([womd / "val" / "val-00000-of-00004.tfrecord.gz"]):
        if index[scene.name]["has_connectivity_original"] == "1":
            lanes = list(scene.road.lanes.values())
            there = {(lane.id, other) for lane in lanes for other in lane.next}
            found = set(lane_links.connections(lanes))
            recorded, inferred = recorded + len(there), inferred + len(found)
            common += len(there & found)
    assert common / recorded > 0.98
    assert common / inferred > 0.92
