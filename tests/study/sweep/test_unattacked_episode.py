"""What a run is compared with: the same episode without attack, simulated once, and kept."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import deepmf_sumo
from deepmf_sumo import spec
from deepmf_sumo.judge.avoidability.encounter import onset_of
from deepmf_sumo.results.failures import failure_of
from deepmf_sumo.results.stored import DAMAGE
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import episode, fork

from tests.support import simulated_worlds, tiny_network
from tests.support.rollout_doubles import case_of, in_traffic, rollout_of, straight


def braking(x, y, speed, steps=80, brake=4.0):
    """(steps, 3) poses of a car that goes on at a speed for 0.5 s and then brakes."""
    speeds = np.maximum(speed - brake * 0.1 * np.maximum(np.arange(steps) - 5, 0), 0)
    return [[float(at), y, 0.0] for at in x + np.cumsum(0.1 * speeds)]


def on_a_network(folder):
    tiny_network.build(folder)
    return {
        "source": {"network": "tiny.sumocfg", "start_s": 2.0, "av": {"vehicle": "av"}},
        "planner": "constant_velocity",
    }


def in_a_recording(folder):
    """The log stands after 1 s; SUMO, which does not know it, drives on."""
    drive = simulated_worlds.straight_motion
    leader = drive(50.0, 0.0, 0.0, 8.0)
    stops = np.arange(simulated_worlds.STEPS) > simulated_worlds.NOW + 10
    leader[stops, :2], leader[stops, 3] = leader[simulated_worlds.NOW + 10, :2], 0.0
    motions = {"av": drive(20.0, 0.0, 0.0, 8.0), "leader": leader}
    scene = simulated_worlds.scene_of(simulated_worlds.straight_road(), motions)
    npz.write(scene, folder / "made.npz")
    source = {"recording": "made.npz", "scenes": "all"}
    return {"source": source, "traffic": "sumo", "planner": "replay"}


@pytest.mark.sumo
@pytest.mark.parametrize("world", [on_a_network, in_a_recording])
def test_an_attack_is_compared_with_the_same_episode_without_it(world, tmp_path):
    """By hand, from the tracks of two runs: one with the attack, one without."""
    common = {"version": 1, "duration_s": 8.0, **world(tmp_path)}
    start = 75.0 if world is on_a_network else 50.0
    lane = -4.8 if world is on_a_network else 0.0
    poses = braking(start, lane, 8.0)
    adversaries = {
        "attacked": {"name": "trajectory", "agent": "leader", "poses": poses},
        "alone": "none",
    }
    specs = []
    for name, adversary in adversaries.items():
        specs.append(tmp_path / f"{name}.yaml")
        specs[-1].write_text(yaml.safe_dump({**common, "name": name, "adversary": adversary}))
    runs = {run.row["spec"]: run for run in deepmf_sumo.run(specs, out=tmp_path / "out").runs}
    attacked, alone = (
        pd.read_csv(runs[name].folder / "tracks.csv.gz").query("id == 'leader'").set_index("step")
        for name in ("attacked", "alone")
    )
    run = runs["attacked"]
    assert run.outcome == "av_opponent"
    assert run.result["counterfactual"] == "episode"
    kept = run.unattacked()
    assert kept.by == "episode"
    at = alone.index.to_numpy()
    np.testing.assert_allclose(kept.position_m[at], alone[["x_m", "y_m"]], atol=1e-4)
    # SUMO drives on where the attack, and the log of the recording, brake
    moved = (attacked[["x_m", "y_m"]] - alone[["x_m", "y_m"]]).dropna()
    away = np.hypot(moved.x_m, moved.y_m)
    assert away.iloc[-1] > 5.0
    departed = int(away.index[away > 0.5][0])
    rollout, contact = run.rollout, run.contact
    row = rollout.tracks.row("leader")
    assert onset_of(rollout, kept, row, rollout.now, contact.step) <= departed
    failure = failure_of(run)
    onset = contact.step - round(failure.onset_s / rollout.dt_s)
    assert onset == onset_of(rollout, kept, row, rollout.now, contact.step)
    assert not (runs["alone"].folder / "unattacked.npz").exists()
    assert json.loads((runs["alone"].folder / "result.json").read_text())["counterfactual"] is None
    (run.folder / "unattacked.npz").write_bytes(b"not an archive")
    with pytest.raises(DAMAGE):
        run.unattacked()


@pytest.mark.parametrize(
    ("world", "adversary", "simulated"),
    [("log", "bga", 0), ("sumo", "bga", 1), ("net", "bga", 1), ("net", "none", 0)],
)
def test_it_is_one_more_episode_a_run_where_the_traffic_reacts(
    world, adversary, simulated, monkeypatch
):
    calls = []

    def simulate(task, case, policy):
        calls.append(policy)
        return rollout_of({"av": straight(0, 0, 10)}, opponent_id=None)

    monkeypatch.setattr(episode, "_simulated", simulate)
    monkeypatch.setattr(fork, "tried", lambda task, simulate, case: simulate())
    case = in_traffic(case_of()) if world == "net" else replace(case_of(), traffic=world)
    scenario = Path(__file__).parents[3] / "scenarios" / "cut_in.yaml"
    task = Task(run_id="one", spec=spec.load(scenario, [f"adversary={adversary}"]), scene="one")
    found, _ = episode._with_unattacked(task, case)
    assert calls == [None] * simulated
    assert (found.unattacked is not None) == bool(simulated)
