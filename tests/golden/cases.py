"""The golden runs: what is run, as specs and commands of `deepmf-sumo`."""

from pathlib import Path
from typing import Any, Final

import yaml

NETWORK_RUNS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "none": ("cut_in", {"adversary": {"name": "none"}}),
    "paper": (
        "cut_in",
        {
            "adversary": {
                "name": "deepmf",
                "version": "G",
                "tried_opponents": 1,
                "goal_candidates": 0,
                "reactions": 6,
            }
        },
    ),
    "likeliest": ("cut_in", {"adversary": {"name": "deepmf", "rule": "likeliest"}}),
    "sampled": ("left_turn_across_path", {"adversary": {"name": "deepmf", "opponent": "sample"}}),
    "sector": ("merge_from_ramp", {"adversary": {"name": "deepmf", "sector": "left"}}),
    "fair": ("left_turn_across_path", {"adversary": {"name": "deepmf", "fair": True}}),
    "lawful": (
        "minor_road_crossing",
        {"adversary": {"name": "deepmf", "opponent": "crosser", "lawful": True}},
    ),
    "lawful-and-fair": (
        "minor_road_crossing",
        {
            "adversary": {
                "name": "deepmf",
                "opponent": "crosser",
                "lawful": True,
                "fair": True,
                "version": "S2",
            }
        },
    ),
    "pushed": ("leader_brakes", {"adversary": {"name": "deepmf", "aggressiveness": 0.9}}),
    "unconditional": (
        "u_turn",
        {"adversary": {"name": "deepmf", "opponent": "turner", "conditional": False}},
    ),
    "rule": ("cut_in", {"adversary": {"name": "rule", "rounds": 2}}),
    "cat": ("roundabout_entry", {"adversary": {"name": "cat", "rounds": 2}}),
    "art": ("cut_in", {"adversary": {"name": "art", "restarts": 2, "iterations": 10}}),
    "strive": (
        "cut_in",
        {
            "adversary": {
                "name": "strive",
                "match_iterations": 5,
                "iterations": 20,
                "solution_iterations": 5,
                "rounds": 2,
            }
        },
    ),
    "king": ("cut_in", {"adversary": {"name": "king", "iterations": 20}}),
    "diffscene": ("cut_in", {"adversary": {"name": "diffscene", "samples": 8}}),
    "brs": ("cut_in", {"adversary": {"name": "brs"}}),
    "bga": (
        "cut_in",
        {"adversary": {"name": "bga", "population": 4}, "budget": {"simulations": 8}},
    ),
    "bbo": ("cut_in", {"adversary": {"name": "bbo", "drawn": 4}, "budget": {"simulations": 8}}),
    "blind": ("side_road_pull_out", {"planner": "constant_velocity"}),
    "sumo-drives": ("bus_stop_pull_out", {"planner": "sumo"}),
    "in-turn": (
        "late_exit",
        {"opponents": "in_turn", "duration_s": 40.0, "adversary": {"name": "deepmf"}},
    ),
}
"""Name: (a spec of `scenarios/`, what differs from it). DeepMF keeps the spec's opponent unless the
case names one. Cases with an adversary of their own are specs of version 1: they show that these
keep their meaning. Those with the spec's adversary have the spec's version."""

LATER: Final = {"source": {"recording": "../../out/late", "scenes": {"first": 3}}}
RECORDED_RUNS: Final[dict[str, dict[str, Any]]] = {
    "log-deepmf": {"planner": "idm", "adversary": {"name": "deepmf", "rule": "likeliest"}},
    "log-replay": {"planner": "replay", "adversary": "deepmf"},
    "log-none": {
        "planner": {"name": "idm", "perception": "corridor"},
        "adversary": {"name": "none"},
    },
    "late-replay": {"planner": "replay", "adversary": "deepmf", **LATER},
    "late-idm": {"planner": "idm", "adversary": {"name": "rule"}, **LATER},
    "log-sumo-traffic": {"planner": "idm", "adversary": "deepmf", "traffic": "sumo"},
}
"""On scenes recorded from `sumo_nets/four_way`."""

PLAN: Final = """version: 1
name: golden
source:
  - {network: sumo_nets/arterial/cut_in.sumocfg, start_s: 9.0, av: {vehicle: av}}
  - {network: sumo_nets/arterial/u_turn.sumocfg, start_s: 19.5, av: {vehicle: av}}
duration_s: 6.0
planners: {lane: {name: idm, perception: lane}, straight: constant_velocity}
methods:
  none: none
  DeepMF: {adversary: {name: deepmf, version: S2}}
  rule: {adversary: {name: rule}}
tables: {baseline: DeepMF, compared: [none, rule]}
"""

LATE: Final = """
import json, pathlib, numpy

for file in sorted(pathlib.Path("out/scenes").rglob("*.npz")):
    arrays = dict(numpy.load(file))
    scene = json.loads(bytes(arrays["description"]))
    late = numpy.arange(len(arrays["tracks_valid"])) % 3 == 1
    late[scene["ids"].index(scene["av_id"])] = False
    arrays["tracks_valid"] = arrays["tracks_valid"].copy()
    arrays["tracks_valid"][late, : scene["now"] + 13] = False
    place = pathlib.Path("out/late") / file.name
    place.parent.mkdir(exist_ok=True)
    numpy.savez(place, **arrays)
"""
"""The recorded scenes with a third of the agents appearing between two plans, 1.3 s after now."""

LIVE: Final = """
import deepmf_sumo, libsumo

libsumo.start(["sumo", "-c", "sumo_nets/four_way/four_way.sumocfg", "--step-length", "0.1",
               "--no-step-log", "--no-warnings", "--collision.action", "none", "--seed", "7"])
while "flow_n_w.1" not in libsumo.vehicle.getIDList():
    libsumo.simulationStep()
with deepmf_sumo.Attacker(libsumo, av="flow_n_w.1", trigger="time=41", out="out/live",
                          duration_s=5.0) as attacker:
    for _ in range(300):
        attacker.before_step()
        libsumo.simulationStep()
        attacker.after_step()
        if "flow_n_w.1" not in libsumo.vehicle.getIDList():
            break
"""

FOUR_WAY: Final = "sumo_nets/four_way/four_way.sumocfg"
COMMANDS: Final[tuple[tuple[str, ...], ...]] = (
    ("data", "record", FOUR_WAY, "--scenes", "3", "--set", "avs=2", "--seed", "3",
     "--out", "out/scenes"),
    ("run", "specs/net", "--out", "out/network", "--scenes", "--set", "sweep.junit=true"),
    ("run", "specs/log", "--out", "out/recorded", "--report"),
    ("attack", FOUR_WAY, "--moments", "3", "--seed", "5", "--until", "120", "--out", "out/attack"),
    ("attack", FOUR_WAY, "--moments", "2", "--set", "source.moments.prefer=encounters", "--set",
     "adversary.opponent=met", "--set", "adversary.version=S2", "--set", "adversary.rule=expected",
     "--until", "120", "--out", "out/met"),
    ("run", "plan.yaml", "--out", "out/benchmark"),
    ("risk", "out/attack", "out/met", "--out", "out/risk"),
    ("compare", "out/attack", "out/met", "--out", "out/compared"),
    ("show", "out/network", "out/recorded", "--format", "csv"),
)  # fmt: skip
"""In this order, in a folder that holds `sumo_nets`, `scenarios`, `specs` and `plan.yaml`.

A version before is asked in its own words: by the list of this name in its own copy of this file.
"""


def write(folder: Path, scenarios: Path) -> None:
    """Write the specs, the plan and the live script into ``folder``."""
    for kind in ("net", "log"):
        (folder / "specs" / kind).mkdir(parents=True)
    for name, (scenario, changes) in NETWORK_RUNS.items():
        spec = yaml.safe_load((scenarios / f"{scenario}.yaml").read_text("utf-8"))
        spec["source"]["network"] = "../" + spec["source"]["network"]
        named = spec["adversary"].get("opponent")
        opponent = {} if named is None else {"opponent": named}
        if "adversary" in changes:
            spec["version"] = 1
            spec.pop("profile", None)
        spec |= {**changes, "name": name}
        if changes.get("adversary", {}).get("name") == "deepmf" and "opponents" not in changes:
            spec["adversary"] = opponent | changes["adversary"]
        (folder / "specs" / "net" / f"{name}.yaml").write_text(yaml.safe_dump(spec), "utf-8")
    for name, changes in RECORDED_RUNS.items():
        spec = {
            "version": 1,
            "name": name,
            "source": {"recording": "../../out/scenes", "scenes": {"first": 2}},
            "duration_s": 8.0,
            "traffic": "log",
            "weights": "open",
            "seed": 0,
            **changes,
        }
        (folder / "specs" / "log" / f"{name}.yaml").write_text(yaml.safe_dump(spec), "utf-8")
    (folder / "plan.yaml").write_text(PLAN, "utf-8")
    (folder / "live.py").write_text(LIVE, "utf-8")
    (folder / "late.py").write_text(LATE, "utf-8")
