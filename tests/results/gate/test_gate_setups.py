"""A verdict needs the same attack on both sides: whatever makes it, and whatever it is called."""

import json
from dataclasses import replace
from typing import Any

import pytest

from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.results import gate, run_sets, setups
from deepmf_sumo.results.gate.thresholds import Thresholds
from deepmf_sumo.results.gate.verdict import text, write_junit

from tests.support import gate_doubles

SPEC = {
    "version": 2, "name": "made up", "duration_s": 8.0, "traffic": "sumo", "opponents": "one",
    "source": {"network": "a.sumocfg", "start_s": 4.0, "av": {"vehicle": "ego"},
               "sumo_options": ["--additional-files", "/home/me/stops.xml"]},
    "planner": {"name": "idm"}, "adversary": {"name": "deepmf"}, "weights": "open", "seed": 0,
    "budget": {"simulations": None, "seconds": None}, "expect": {}, "profile": "fair",
}  # fmt: skip


def run(number=0, *, seed=0, inputs=None, **keys):
    """A run of a spec with these keys, dotted names by ``__``."""
    setup = json.loads(json.dumps(SPEC)) | {"name": f"spec {number}", "seed": seed}
    changes = {}
    for dotted, value in keys.items():
        *path, last = dotted.split("__")
        part = setup
        for name in path:
            part = part[name]
        part[last] = value
    if "adversary" in keys:
        changes["adversary"] = setup["adversary"]["name"]
    shown = gate_doubles.result("a", seed, spec=f"spec {number}", setup=setup, **changes)
    settings = {key: one for key, one in setup["adversary"].items() if key != "name"}
    shown["settings"] = {"planner": {}, "adversary": {"period_s": 1.0} | settings}
    return shown | {"inputs": {"source": "s", **(inputs or {})}}


def folder(path, **keys):
    seed = keys.pop("seed", 0)
    return gate_doubles.write_folder(path, [run(n, seed=seed, **keys) for n in range(6)])


def verdict(tmp_path, new, old=None, **more):
    a = folder(tmp_path / "old", **(old or {}))
    b = folder(tmp_path / "new", **new)
    return gate.check(b, Thresholds(version=1, **more), a)


ATTACKS = {
    "switched off": ({"adversary": {"name": "none"}}, "adversary was 'deepmf' and is 'none'"),
    "rule": ({"adversary": {"name": "deepmf", "rule": "any"}}, "adversary.rule was not said"),
    "constraints": (
        {"adversary": {"name": "deepmf", "constraints": ["fair"]}}, "adversary.constraints",
    ),
    "a default that changed": (
        {"adversary": {"name": "deepmf", "period_s": 2.0}},
        "adversary.period_s was 1.0 and is 2.0 (6 runs)",
    ),
    "weights": ({"weights": "mine"}, "weights was 'open' and is 'mine'"),
    "content of weights": ({"inputs": {"weights": "12345"}}, "weights was 'open' and is 'files 12"),
    "code of the adversary": ({"inputs": {"adversary": "12345"}}, "adversary's files was not said"),
    "profile": ({"profile": "any"}, "profile was 'fair' and is 'any'"),
    "budget": ({"budget__simulations": 9}, "budget.simulations was None and is 9"),
    "duration": ({"duration_s": 4.0}, "duration_s was 8.0 and is 4.0"),
    "opponents": ({"opponents": "in_turn"}, "opponents was 'one' and is 'in_turn'"),
    "only": ({"source__only": ["b"]}, "source.only was not said and is ['b']"),
    "moment": ({"source__start_s": 9.0}, "the moment was ego at 4 s and is ego at 9 s"),
    "a key of tomorrow": ({"weather": "rain"}, "weather was not said and is 'rain'"),
}  # fmt: skip


@pytest.mark.parametrize("case", ATTACKS)
def test_another_attack_is_no_verdict(tmp_path, case):
    changed, told = ATTACKS[case]
    found = verdict(tmp_path, changed)
    [sentence] = found.findings()
    assert told in sentence
    assert found.exit_code == 3
    assert found.comparisons is None
    assert told in text(found)
    write_junit(tmp_path / "junit.xml", found)
    assert 'errors="1"' in (tmp_path / "junit.xml").read_text().splitlines()[1]


@pytest.mark.parametrize("case", [name for name in ATTACKS if name != "moment"])
def test_other_seeds_do_not_hide_another_attack(tmp_path, case):
    """No run has a partner of the same id: the spec's other runs are asked."""
    changed, told = ATTACKS[case]
    found = verdict(tmp_path, {**changed, "seed": 7})
    assert found.exit_code == 3
    assert told in next(found.findings())


SAME = {
    "planner": {"planner": {"name": "mine:Class"}, "inputs": {"planner": "12"}},
    "expectations": {"expect": {"av_collision": False}},
    "place of a file": {"source__sumo_options": ["--additional-files", "/home/you/stops.xml"]},
    "grammar": {"version": 1},
    "seeds and moments": {"seed": 7, "source__start_s": 9.0},
}


@pytest.mark.parametrize("case", SAME)
def test_what_is_compared_may_differ(tmp_path, case):
    found = verdict(tmp_path, SAME[case])
    assert found.apart == []
    assert found.comparisons


def test_weights_of_another_name_and_the_same_content_are_the_same(tmp_path):
    old = {"weights": "theirs", "inputs": {"weights": "12"}}
    assert verdict(tmp_path, {"weights": "mine", "inputs": {"weights": "12"}}, old).apart == []


def test_another_network_is_said(tmp_path):
    found = verdict(tmp_path, {"inputs": {"source": "t"}})
    assert found.apart == []
    assert any("has other content in 6 of 6 pairs" in note for note in found.notes)


def test_another_version_is_no_verdict(tmp_path):
    old = gate_doubles.write_folder(tmp_path / "old", [run()], version="0.0.9")
    new = gate_doubles.write_folder(tmp_path / "new", [run()])
    found = gate.check(new, Thresholds(version=1), old)
    assert found.exit_code == 3
    assert "the version of deepmf-sumo was 0.0.9 and is 0.1.0" in next(found.findings())


def test_a_broken_threshold_is_named_as_well(tmp_path):
    found = verdict(tmp_path, {"weights": "mine"}, min_ttc_p05=9.9)
    assert found.exit_code == 3
    broken = verdict(tmp_path / "more", {"weights": "mine"}, max_collision_rate=0, min_gap_p05=9)
    assert [one.state for one in broken.judgements].count("broken") == 1
    assert len(list(broken.findings())) == 2


def test_an_opponent_of_each_moment_is_no_setting(tmp_path):
    def side(name, seed):
        runs = [run(0, seed=seed + n) for n in range(3)]
        for number, one in enumerate(runs):
            one["settings"]["adversary"]["opponent"] = f"car{seed + number}"
        return gate_doubles.write_folder(tmp_path / name, runs)

    new, old = side("new", 0), side("old", 5)
    assert setups.differences(run_sets.read(new), run_sets.read(old)) == []


def test_a_file_keeps_the_setup(tmp_path):
    old, new = folder(tmp_path / "old"), folder(tmp_path / "new", traffic="log")
    run_sets.write(tmp_path / "base.json", run_sets.read(old))
    stored = run_sets.read(tmp_path / "base.json")
    assert setups.differences(run_sets.read(old), stored) == []
    [told] = setups.differences(run_sets.read(new), stored)
    assert told == "traffic was 'sumo' and is 'log' (6 runs)"


def test_files_of_earlier_versions_are_compared_by_what_they_say(tmp_path):
    old, new = folder(tmp_path / "old"), folder(tmp_path / "new")
    for out in (old, new):
        for file in out.glob("runs/*/result.json"):
            values = json.loads(file.read_text())
            del values["setup"]
            if out == new:
                values["settings"]["adversary"]["rule"] = "any"
            file.write_text(json.dumps(values))
    [told] = setups.differences(run_sets.read(new), run_sets.read(old))
    assert told.startswith("adversary.rule was not said and is 'any'")
    notes = list(setups.notes(run_sets.read(new), run_sets.read(old)))
    assert any("of an earlier version" in note for note in notes)
    assert setups.differences(run_sets.read(old), run_sets.read(old)) == []


def test_runs_that_never_began_belong_to_their_spec(tmp_path):
    """The name has capitals and a bracket, which ids lack; runs of another part do not count."""
    runs = [gate_doubles.result("a", n, spec="Cut in (fast)") for n in range(2)]
    for one in runs:
        one["run_id"] = f"cut-in-fast-1--a--{one['seed']}"
    out = gate_doubles.write_folder(tmp_path / "out", runs, ["cut-in-fast-1--a--2"])
    file = out / "manifest.json"
    lists = {"specs": {"Cut in*": {"max_failed_runs": 0}}, "planners": {"idm lane": {}}}
    wanted = Thresholds.model_validate({"version": 1, **lists, "max_failed_runs": 9})
    known = {
        "spec": "Cut in (fast)", "scene": "a", "network": "crossing", "seed": 2,
        "method": "Cut in (fast)", "planner_label": "idm lane", "part": "main",
    }  # fmt: skip
    manifest = json.loads(file.read_text())
    file.write_text(json.dumps(manifest | {"planned": {"cut-in-fast-1--a--2": known}}))
    found = gate.check(out, wanted)
    assert found.exit_code == 3
    state = {(one.group, one.limit): (one.state, one.runs) for one in found.judgements}
    assert state["spec Cut in*", "max_failed_runs"] == ("unfit", 3)
    runs = run_sets.read(out).runs.set_index("run_id")
    assert runs["planner_label"]["cut-in-fast-1--a--2"] == "idm lane"
    other = {"cut-in-fast-1--a--2": known | {"part": "figures"}}
    file.write_text(json.dumps(manifest | {"planned": other}))
    assert gate.check(out, wanted).exit_code == 0


def test_a_spec_without_a_single_result_is_no_verdict_and_no_error(tmp_path):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()], ["cut-in--a--0"])
    file = out / "manifest.json"
    known = {
        "spec": "Cut in", "scene": "a", "network": None, "seed": 0, "method": "Cut in",
        "planner_label": "idm lane", "part": "main",
    }  # fmt: skip
    file.write_text(json.dumps(json.loads(file.read_text()) | {"planned": {"cut-in--a--0": known}}))
    wanted = {"version": 1, "max_failed_runs": 9, "specs": {"Cut in": {"max_failed_runs": 0}}}
    assert gate.check(out, Thresholds.model_validate(wanted)).exit_code == 3


def test_of_an_earlier_manifest_other_runs_say_the_name(tmp_path):
    runs = [gate_doubles.result("a", n, spec="Cut_in") for n in range(2)]
    for one in runs:
        one["run_id"] = f"cut-in--a--{one['seed']}"
    out = gate_doubles.write_folder(tmp_path / "out", runs, ["cut-in--a--2", "other--b--0"])
    found = run_sets.read(out).runs.set_index("run_id")
    names = ["spec", "network", "planner_label", "seed"]
    assert list(found.loc["cut-in--a--2", names]) == ["Cut_in", "crossing", "idm lane", 2]
    assert found["spec"]["other--b--0"] == "other"


def test_the_verdict_says_the_profile(tmp_path):
    found = verdict(tmp_path, {"adversary": {"name": "deepmf", "constraints": ["fair", "on_road"]}})
    assert "; profile fair (fair, on_road)" in text(found)


def test_specs_of_versions_2_and_3_may_be_one_attack():
    """Version 2 says neither its profile nor that there is one opponent."""
    newer = json.loads(json.dumps(SPEC)) | {"version": 3, "profile": "any"}
    older = {key: one for key, one in newer.items() if key not in {"profile", "opponents"}}
    rows = [
        gate_doubles.result("a", setup=setup, profile="any")
        for setup in (newer, older | {"version": 2})
    ]
    first, second = map(setups.setup_of, rows)
    assert setups.differing(first, second) == set()


EARLIER: dict[str, Any] = {
    "version": None, "period_s": 1.0, "opponent": "argmax", "tried_opponents": None,
    "rule": "likeliest", "likelihood_weight": 1.0, "comfort_weight": None, "candidates": 32,
    "goal_candidates": 64, "shortlist": 32, "reactions": 16, "av_driver": None,
    "conditional": True, "accel_mps2": 3.5, "brake_mps2": 5.0, "lateral_mps2": 3.5,
    "keep_tail": False, "sector": None, "aggressiveness": None, "constraints": ["fair"],
}  # fmt: skip
"""What a result of version 0.1 records of DeepMF's settings."""


@pytest.mark.parametrize("kept_in_a_file", [False, True])
def test_settings_in_words_of_an_earlier_version_are_the_same_attack(tmp_path, kept_in_a_file):
    choice = {"name": "deepmf", "rule": "likeliest", "constraints": ["fair"]}
    today = Settings(rule="likeliest", constraints=["fair"]).model_dump(mode="json")
    sides = []
    for name, written in (("old", EARLIER), ("new", today)):
        one = run(adversary=choice)
        one["settings"]["adversary"] = written
        out = gate_doubles.write_folder(tmp_path / name, [one])
        sides.append(run_sets.read(out))
    if kept_in_a_file:
        setup = {f"adversary.{key}": value for key, value in EARLIER.items()}
        [attack] = sides[1].attacks.values()
        others = {key: one for key, one in attack.items() if not key.startswith("adversary.")}
        [digest] = sides[0].attacks
        file = tmp_path / "old.json"
        run_sets.write(file, replace(sides[0], attacks={digest: others | setup}))
        sides[0] = run_sets.read(file)
    assert setups.differences(sides[1], sides[0]) == []
    [old] = sides[0].attacks.values()
    assert (old["adversary.form.reactions"], old["adversary.form.preset"]) == (16, "extended")


def test_a_profile_is_no_part_of_a_search():
    setup = json.loads(json.dumps(SPEC)) | {"adversary": {"name": "bga"}}
    rows = [
        gate_doubles.result("a", adversary="bga", setup=setup | {"profile": profile}, profile="")
        for profile in ("fair", "any")
    ]
    first, second = map(setups.setup_of, rows)
    assert setups.differing(first, second) == set()
