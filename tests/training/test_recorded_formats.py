"""Training reads what the readers read: TFRecords and ScenarioNet folders, mixed by weight."""

import json
import pickle

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.deepmf.networks import torch_networks

from tests.support import recordings_by_hand as by_hand

pytestmark = pytest.mark.sumo


def test_tfrecords_and_scenarionet_folders_are_trained_on_together(tmp_path):
    shard = tmp_path / "shard.tfrecord-00000-of-00001"
    by_hand.shard(shard, *(by_hand.scenario(name=f"waymo{number}") for number in range(3)))
    folder = tmp_path / "scenarionet"
    folder.mkdir()
    for number in range(2):
        described = by_hand.scenarionet(by_hand.scenario(name=f"net{number}"))
        (folder / f"sd_{number}.pkl").write_bytes(pickle.dumps(described))
    sources = ["--data", f"{shard}=3", "--data", f"{folder}=1"]
    places = ["--out", str(tmp_path / "set"), "--cache", str(tmp_path / "cache")]
    assert main.run(["train", "opponent", "--set", "steps=2", *sources, *places]) == 0
    _, card = torch_networks.read_network(tmp_path / "set", "opponent")
    assert [(one["name"], one["scenes"], one["share"]) for one in card["data"]] == [
        (shard.name, 3, 0.75),
        ("scenarionet", 2, 0.25),
    ]
    assert json.loads((tmp_path / "set/opponent.json").read_text())["refused"] == 0
