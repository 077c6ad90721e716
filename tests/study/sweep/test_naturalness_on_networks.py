"""What an attack on a network is compared with: the same episode without it."""

import json

import pandas as pd
import pytest
import shapely

import deepmf_sumo

from tests.support import tiny_network


@pytest.mark.sumo
def test_paths_are_compared_with_the_episode_without_attack(tmp_path):
    """As found from the tracks of two runs, by shapely."""
    tiny_network.build(tmp_path)
    specs = [
        tiny_network.spec(
            tmp_path,
            "attacked",
            adversary="{name: brs, opponent: leader}",
            budget="{simulations: 3}",
        ),
        tiny_network.spec(
            tmp_path, "again", adversary="{name: brs, opponent: leader}", budget="{simulations: 3}"
        ),
        tiny_network.spec(tmp_path, "alone", adversary="none"),
    ]
    found = deepmf_sumo.run(specs, out=tmp_path / "out")
    runs = {run.row["spec"]: run for run in found.runs}
    tracks = {
        name: pd.read_csv(run.folder / "tracks.csv.gz").query("id == 'leader'").set_index("time_s")
        for name, run in runs.items()
    }
    driven = tracks["attacked"].query("driver == 'policy'")
    both = [
        shapely.LineString(one.loc[driven.index, ["x_m", "y_m"]].to_numpy())
        for one in (driven, tracks["alone"])
    ]
    metrics = json.loads((runs["attacked"].folder / "result.json").read_text())["metrics"]
    assert metrics["path_hausdorff_cut"]["value"] == pytest.approx(
        shapely.hausdorff_distance(*both), abs=1e-3
    )
    assert metrics["path_hausdorff_cut"]["value"] > 0.1
    # the first of a passage starts SUMO for each episode, the second has it at the moment
    again = json.loads((runs["again"].folder / "result.json").read_text())["metrics"]
    assert again == metrics
    none = json.loads((runs["alone"].folder / "result.json").read_text())["metrics"]
    assert none["path_sspd"]["reason"] == "no vehicle was attacked"
