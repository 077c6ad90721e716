"""The runs of a folder are known again by the spec that lies beside them."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.results import result
from deepmf_sumo.results.folder import Store
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep import batch
from deepmf_sumo.study.sweep.inputs import fingerprinted

from tests.support import recordings_by_hand as hand

SCENARIOS = sorted((Path(__file__).parents[3] / "scenarios").glob("*.yaml"))


def again(tmp_path, planned):
    """The tasks as they are read from the specs of their runs' folders."""
    store = Store(tmp_path)
    for task in planned:
        folder = store.runs / task.run_id
        folder.mkdir(parents=True)
        (folder / "spec.yaml").write_text(yaml.safe_dump(task.resolved(), sort_keys=False))
    results = [result.unfinished(task, "failed", "made up") for task in planned]
    return [one for found in results for one in batch._task_of(store, found)]


def keys(found):
    return [task.key for task in fingerprinted(found)[0]]


def test_there_are_scenarios():
    assert len(SCENARIOS) > 5


@pytest.mark.parametrize("file", SCENARIOS, ids=lambda file: file.stem)
def test_a_run_of_a_network_has_its_key_again(tmp_path, file):
    for number, sets in enumerate((["seed=3"], ["adversary=none"], ["planner=constant_velocity"])):
        planned = tasks.plan([spec.load(file, sets)], tmp_path)
        assert keys(again(tmp_path / str(number), planned)) == keys(planned)


@pytest.mark.sumo  # a listing of recordings is kept by several processes
def test_a_run_of_a_recording_has_its_key_again(tmp_path):
    hand.shard(tmp_path / "one.tfrecord", hand.scenario(name="a"), hand.scenario(name="b"))
    (tmp_path / "s.yaml").write_text(
        f"version: 2\nname: x\nsource: {{recording: {tmp_path}/one.tfrecord, scenes: all}}\n"
    )
    planned = tasks.plan([spec.load(tmp_path / "s.yaml")], tmp_path / "cache")
    assert len(planned) == 2
    assert keys(again(tmp_path, planned)) == keys(planned)


def test_a_spec_that_cannot_be_read_any_more_is_no_run(tmp_path):
    planned = tasks.plan([spec.load(SCENARIOS[0])], tmp_path)
    assert len(again(tmp_path, planned)) == 1
    (tmp_path / "runs" / planned[0].run_id / "spec.yaml").write_text("version: 99\n")
    found = {"run_id": planned[0].run_id, "scene": planned[0].scene}
    assert batch._task_of(Store(tmp_path), found) == []


def test_a_run_of_a_moment_that_was_drawn_has_its_key_again(tmp_path):
    draw = tasks.Draw(drawn="promising", draw=3, probability=0.2, pool=60)
    [task] = tasks.plan([spec.load(SCENARIOS[0])], tmp_path)
    assert keys(again(tmp_path, [replace(task, draw=draw)])) == keys([replace(task, draw=draw)])
    assert keys([replace(task, draw=draw)]) != keys([task])
    damaged = {"run_id": task.run_id, "scene": task.scene, "draw": {"drawn": "promising"}}
    assert batch._task_of(Store(tmp_path), damaged) == []
