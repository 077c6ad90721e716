import multiprocessing
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.network.conversion import key

pytestmark = pytest.mark.sumo


def test_a_net_is_built_once(crossing, tmp_path):
    first = network.cached(crossing, tmp_path)
    stamp = first.file.stat().st_mtime_ns
    again = network.cached(crossing, tmp_path)
    assert again.file == first.file
    assert again.file.stat().st_mtime_ns == stamp
    assert again.pieces == first.pieces
    assert [path.name for path in tmp_path.iterdir()] == [key(crossing)]


def test_a_broken_net_is_built_again(crossing, tmp_path):
    net = network.cached(crossing, tmp_path)
    (net.file.parent / "mapping.json").write_text("{")
    assert network.cached(crossing, tmp_path).pieces == net.pieces


def test_several_processes_share_it(crossing, tmp_path):
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        nets = pool.starmap(network.cached, [(crossing, tmp_path)] * 3)
    assert len({net.file for net in nets}) == 1
    assert [path.name for path in tmp_path.iterdir()] == [key(crossing)]


def test_the_key_depends_on_what_the_net_is_made_of(crossing, scene_of):
    assert key(crossing) == key(replace(crossing, name="another name"))
    other_path = scene_of(crossing.road, path=[(0, 0), (9, 9)], signalled=crossing.signals.lane_ids)
    lane = crossing.road.lanes["in0"]
    moved = replace(lane, centre_m=lane.centre_m + np.array([0.0, 0.001]))
    other_road = replace(crossing.road, lanes={**crossing.road.lanes, "in0": moved})
    keys = {
        key(crossing),
        key(other_path),
        key(replace(crossing, road=other_road)),
        key(scene_of(crossing.road, signalled=["S0"])),
    }
    assert len(keys) == 4
