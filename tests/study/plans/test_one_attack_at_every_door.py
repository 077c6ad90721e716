"""The default adversary on real networks: the same plans, byte for byte, whatever asks for them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

import deepmf_sumo
from deepmf_sumo.cli import main

from tests.support.same_bytes import differences

NETWORKS = Path(__file__).resolve().parents[3] / "sumo_nets"

ATTACKS = {
    "fair": ("four_way", ["-n", 3], {"moments": 3}),
    "any": ("arterial", ["-n", 2, "--set", "profile=any"], {"moments": 2, "profile": "any"}),
    "in turn": ("roundabout", ["-n", 1, "--set", "duration_s=18"],
                {"moments": 1, "duration_s": 18.0}),
    "lawful": ("highway", ["-n", 2, "--set", "profile=lawful",
                           "--set", "source.moments.prefer=encounters"],
               {"moments": 2, "profile": "lawful", "prefer": "encounters"}),
}  # fmt: skip


def call(*arguments):
    return main.run([str(one) for one in arguments])


@pytest.mark.slow
@pytest.mark.sumo
@pytest.mark.parametrize("case", ATTACKS)
def test_attack_and_its_spec_and_a_program_plan_alike(tmp_path, case):
    network, options, arguments = ATTACKS[case]
    config, file = NETWORKS / network / f"{network}.sumocfg", tmp_path / "saved.yaml"
    attack = ["attack", config, *options, "--seed", 2, "--until", 150]
    assert call(*attack, "--no-pictures", "--set", "sweep.risk=false", "--out", tmp_path / "a") == 0
    assert call(*attack, "--save-spec", file) == 0
    assert call("run", file, "--no-pictures", "--out", tmp_path / "b") == 0
    deepmf_sumo.attack(config, tmp_path / "c", seed=2, until_s=150.0, **arguments)
    assert len(list((tmp_path / "a" / "runs").glob("*/plans.npz"))) == arguments["moments"]
    assert differences(tmp_path / "a", tmp_path / "b") == []
    assert differences(tmp_path / "a", tmp_path / "c") == []
    rows = deepmf_sumo.Results.of(tmp_path / "a").runs
    assert {one.row["profile"] for one in rows} == {yaml.safe_load(file.read_text())["profile"]}


LIVE = """
import sys

import deepmf_sumo
import libsumo

config, out = sys.argv[1:]
libsumo.start(["sumo", "-c", config, "--step-length", "0.1", "--no-step-log", "--no-warnings",
               "--collision.action", "none", "--seed", "2"])
while libsumo.simulation.getTime() < 160.0:
    libsumo.simulationStep()
with deepmf_sumo.Attacker(libsumo, av="flow_s_w.2", trigger="time=162", duration_s=8.0, out=out,
                          sets="seed=2") as attacker:
    for _ in range(70):
        attacker.before_step()
        libsumo.simulationStep()
        attacker.after_step()
"""


@pytest.mark.slow
@pytest.mark.sumo
def test_a_running_simulation_is_attacked_as_a_spec_attacks_it(tmp_path):
    """SUMO drives the AV in both.

    The scores of possible opponents may differ: there other vehicles beyond 80 m are not seen.
    """
    config, file = NETWORKS / "four_way" / "four_way.sumocfg", tmp_path / "spec.yaml"
    source = {"network": str(config), "start_s": 162.0, "av": {"vehicle": "flow_s_w.2"}}
    values = {"version": 3, "name": "offline", "source": source, "planner": "sumo", "seed": 2}
    values["adversary"] = {"name": "deepmf", "goal": "hit"}  # one try, as of what runs already
    file.write_text(yaml.safe_dump(values))
    assert call("run", file, "--no-pictures", "--out", tmp_path / "offline") == 0
    command = [sys.executable, "-c", LIVE, str(config), str(tmp_path / "live")]
    subprocess.run(command, check=True, capture_output=True)
    [one], [other] = (
        list((tmp_path / name / "runs").glob("*/plans.npz")) for name in ("offline", "live")
    )
    plans, live = np.load(one), np.load(other)
    assert plans.files == live.files
    assert "00/candidate_fair" in plans.files
    differ = [key for key in plans.files if plans[key].tobytes() != live[key].tobytes()]
    assert all("/score_" in key for key in differ)
    session = json.loads((tmp_path / "live" / "session.json").read_text())
    result = json.loads(one.with_name("result.json").read_text())
    assert session["profile"] == result["profile"] == "fair"
    assert session["constraints"] == result["constraints"] == [
        "clean", "fair", "no_rear_end", "with_traffic",
    ]  # fmt: skip
