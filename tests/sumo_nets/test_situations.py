"""Every spec's situation exists: at its start the AV and the opponent stand as its name says."""

import json
import math
from pathlib import Path

import pytest
import yaml

from deepmf_sumo import api
from deepmf_sumo.study.sweep import workers

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"

# What the opponent is to the AV at the start, and how far away at most.
SITUATIONS = {
    "bus_stop_pull_out": ("ahead on the right", 80),
    "cut_in": ("ahead on the left", 30),
    "late_exit": ("ahead on the left", 30),
    "leader_brakes": ("ahead", 50),
    "left_turn_across_path": ("oncoming", 70),
    "merge_from_ramp": ("ahead on the right", 30),
    "minor_road_crossing": ("from the right", 60),
    "overtaking_head_on": ("oncoming", 80),
    "rear_end": ("behind", 30),
    "red_light_runner": ("from the right", 70),
    "roundabout_entry": ("from the right", 60),
    "side_road_pull_out": ("from the right", 60),
    "u_turn": ("oncoming", 60),
}

# Who the opponent is where the spec leaves the choice to the attack.
CHOSEN = {"late_exit": "leaver", "minor_road_crossing": "crosser", "u_turn": "turner"}


def probe(task):
    """Write where vehicles are at a moment; libsumo holds one simulation a process."""
    import libsumo

    config, start_s, seed, ids, file = task
    libsumo.start(["sumo", "-c", config, "--seed", seed, "--no-step-log", "--no-warnings"])
    seen = dict.fromkeys(ids, 0)
    while libsumo.simulation.getTime() < start_s - 1e-6:
        libsumo.simulationStep()
        for one in ids:
            seen[one] += one in libsumo.vehicle.getIDList()
    api = libsumo.vehicle
    poses = [
        [*api.getPosition(one), api.getAngle(one), api.getSpeed(one), seen[one]] for one in ids
    ]
    file.write_text(json.dumps(poses))


def _relation(av, other):
    """One of the words of SITUATIONS, from poses [x, y, SUMO's angle, ...]."""
    east, north, heading = other[0] - av[0], other[1] - av[1], math.radians(av[2])
    ahead = east * math.sin(heading) + north * math.cos(heading)
    left = -east * math.cos(heading) + north * math.sin(heading)
    turned = (av[2] - other[2] + 180) % 360 - 180  # counter-clockwise
    if abs(turned) > 135:
        return "oncoming" if ahead > 0 else "gone by"
    if abs(turned) > 45:
        return "from the right" if turned > 0 else "from the left"
    side = " on the left" if left > 2 else " on the right" if left < -2 else ""
    return ("ahead" if ahead > 0 else "behind") + side


def test_every_spec_is_described_here():
    assert sorted(path.stem for path in SCENARIOS.glob("*.yaml")) == sorted(SITUATIONS)


@pytest.mark.sumo
@pytest.mark.parametrize("name", SITUATIONS)
def test_the_opponent_stands_where_the_spec_says(name, tmp_path):
    path = SCENARIOS / f"{name}.yaml"
    assert path.read_text().startswith("# "), "a spec begins with a sentence for the user"
    spec = yaml.safe_load(path.read_text())
    source = spec["source"]
    config = (path.parent / source["network"]).resolve()
    named = spec["adversary"].get("opponent")
    assert (named is None) == (name in CHOSEN)
    ids = [source["av"]["vehicle"], named or CHOSEN[name]]
    file = tmp_path / "poses.json"
    task = (str(config), source["start_s"], str(spec["seed"]), ids, file)
    (ending,) = workers.run(probe, [task], jobs=1, timeout_s=60)
    assert ending.status == "done", ending.reason
    av, opponent = json.loads(file.read_text())
    relation, within = SITUATIONS[name]
    assert _relation(av, opponent) == relation
    assert math.dist(av[:2], opponent[:2]) < within
    assert av[3] > 5
    assert min(av[4], opponent[4]) >= 11, "both need a second of history"


@pytest.mark.sumo
@pytest.mark.parametrize("name", CHOSEN)
def test_the_attack_chooses_the_opponent_of_the_situation(name, tmp_path):
    [run] = api.run(SCENARIOS / f"{name}.yaml", tmp_path / "out").runs
    assert run.hit
    assert run.row["opponent"] == CHOSEN[name]
