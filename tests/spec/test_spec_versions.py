"""Versions of specs and plans: which rule DeepMF has where none is said, and what is recorded."""

import copy
import json
import sys
import types
from pathlib import Path

import pytest
import yaml

from deepmf_sumo import plugins, spec
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.errors import SpecError
from deepmf_sumo.results import result
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.plans import entries, plan

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def write(tmp_path):
    (tmp_path / "tiny.sumocfg").write_text("<configuration/>")

    def write(version: object = None, adversary: object = None) -> Path:
        values = {
            "version": version,
            "name": "versions",
            "source": {"network": "tiny.sumocfg", "av": {"vehicle": "av"}},
            "adversary": adversary,
        }
        path = tmp_path / "spec.yaml"
        given = {key: value for key, value in values.items() if value is not None}
        path.write_text(yaml.safe_dump(given))
        return path

    return write


def settings_of(loaded: spec.Spec) -> Settings:
    choice = loaded.adversary
    return plugins.settings("adversaries", choice.name, choice.settings)


RULES = {
    "no adversary": (None, "expected", "likeliest"),
    "name alone": ("deepmf", "expected", "likeliest"),
    "version of the paper": ("S2", "expected", "likeliest"),
    "other keys": ({"name": "deepmf", "fair": True, "tries": 3}, "expected", "likeliest"),
    "goal": ({"goal": "finding", "tries": 3}, "expected", "likeliest"),
    "form said": ({"name": "deepmf", "form": "extended"}, "expected", "likeliest"),
    "rule said": ({"name": "deepmf", "rule": "expected"}, "expected", "expected"),
    "other rule": ({"name": "deepmf", "rule": "pair"}, "pair", "pair"),
    "as published": ({"name": "deepmf", "form": "paper"}, "expected", "expected"),
}


@pytest.mark.parametrize(("adversary", "first", "second"), copy.deepcopy(RULES).values(), ids=RULES)
def test_the_rule_where_none_is_said(write, adversary, first, second):
    assert settings_of(spec.load(write(1, adversary))).rule == first
    assert settings_of(spec.load(write(2, adversary))).rule == second
    if isinstance(adversary, dict) and adversary.pop("fair", False):
        adversary["constraints"] = ["fair"]
    assert settings_of(spec.load(write(3, adversary))).rule == second


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_aggressiveness_takes_the_place_of_a_rule_in_both(write, level):
    both = [spec.load(write(one, {"aggressiveness": level})) for one in (1, 2)]
    assert settings_of(both[0]) == settings_of(both[1])


def test_a_spec_of_version_1_is_recorded_without_keys_of_later_ones(write, tmp_path):
    adversary = {"name": "deepmf", "version": "S2", "likelihood_weight": 0.1}
    assert spec.load(write(1, adversary)).resolved() == {
        "version": 1,
        "name": "versions",
        "source": {
            "network": str((tmp_path / "tiny.sumocfg").resolve()),
            "start_s": 0.0,
            "av": {"vehicle": "av"},
            "sumo_options": [],
        },
        "duration_s": 8.0,
        "traffic": "sumo",
        "planner": {"name": "idm"},
        "adversary": {
            "name": "deepmf",
            "form": {"preset": "extended", "likelihood_weight": 0.1},
            "period_s": 2.0,
        },
        "budget": {"simulations": None, "seconds": None},
        "weights": "open",
        "seed": 0,
        "expect": {
            "av_collision": None, "outcome": None, "max_contact_speed_mps": None, "metrics": {},
        },
    }  # fmt: skip


def test_random_numbers_and_names_of_runs_are_the_same_in_both(write, tmp_path):
    [one], [two] = (tasks.plan([spec.load(write(each))], tmp_path) for each in (1, 2))
    assert (one.run_id, one.entropy()) == (two.run_id, two.entropy())


def test_a_run_of_version_2_records_the_rule_that_held(write, tmp_path):
    [task] = tasks.plan([spec.load(write(2))], tmp_path)
    assert task.resolved()["adversary"] == {"name": "deepmf", "rule": "likeliest"}
    assert result.unfinished(task, "failed", "")["settings"]["adversary"]["rule"] == "likeliest"


@pytest.mark.parametrize("adversary", ["S1", {"form": "paper"}, {"aggressiveness": 0.5}, "bga"])
@pytest.mark.parametrize("version", [1, 2, 3])
def test_what_a_run_records_reads_back_to_equal_settings(write, tmp_path, version, adversary):
    loaded = spec.load(write(version, adversary))
    again = tmp_path / "again.yaml"
    again.write_text(yaml.safe_dump(loaded.resolved()))
    assert spec.load(again) == loaded
    assert settings_of(spec.load(again)) == settings_of(loaded)


@pytest.mark.parametrize("version", ["2", 4, 0, 2.0, True])
def test_other_versions_are_refused_in_one_sentence(write, version):
    with pytest.raises(SpecError) as refused:
        spec.load(write(version))
    assert str(refused.value).endswith(
        f"key 'version': {version!r}: must be 1, 2 or 3, a number without quotes; a later version"
        " needs a newer deepmf-sumo."
    )


def test_a_weight_of_a_rule_that_does_not_hold_is_refused(write):
    weighted = {"name": "deepmf", "likelihood_weight": 0.1}
    assert settings_of(spec.load(write(1, weighted))).rule == "expected"
    with pytest.raises(SpecError, match=r"key 'adversary\.likelihood_weight.*add rule: expected"):
        spec.load(write(2, weighted))
    newer = {"name": "deepmf", "form": {"likelihood_weight": 0.1}}
    with pytest.raises(SpecError, match=r"adversary\.form\.likelihood_weight.*add rule: expected"):
        spec.load(write(3, newer))
    for one in (write(2, weighted | {"rule": "pair"}), write(3, newer | {"rule": "pair"})):
        assert settings_of(spec.load(one)).form.likelihood_weight == 0.1


EARLIER = {
    "likelihood_weight: 0.1, rule: expected": "form: {likelihood_weight: 0.1}, rule: expected",
    "tried_opponents: 2, comfort_weight: 0": "form: {tried_opponents: 2, comfort_weight: 0}",
    "goal_candidates: 0, candidates: 7": "form: {goal_candidates: 0, candidates: 7}",
    "conditional: false, shortlist: null": "form: {conditional: false, shortlist: null}",
    "form: extended, reactions: 4": "form: {preset: extended, reactions: 4}",
    "form: paper, reactions: 4": "form: {preset: paper, reactions: 4}",
    "fair: true, lawful: false": "constraints: [fair]",
    "goal: avoidable, constraints: [on_road]": "goal: finding, constraints: [clean, fair, on_road]",
    "sector: 4": "sector: rear",
    "keep_tail: false, av_driver: null, sector: left": "sector: left",
}


@pytest.mark.parametrize("earlier", EARLIER)
def test_words_of_versions_1_and_2_keep_their_meaning(write, earlier):
    old, new = (yaml.safe_load(f"{{{text}}}") for text in (earlier, EARLIER[earlier]))
    for version in (1, 2):
        today = spec.load(write(version, new))
        assert settings_of(spec.load(write(version, old))) == settings_of(today)
    assert settings_of(spec.load(write(3, {"constraints": []} | new))) == settings_of(today)


@pytest.mark.parametrize(
    ("earlier", "told"),
    [
        ("reactions: 1", "is of versions 1 and 2; write adversary.form: {reactions: 1}."),
        ("shortlist: null", "is of versions 1 and 2; write adversary.form: {shortlist: null}."),
        ("sector: 7", "is of versions 1 and 2; write adversary.sector: front_right."),
        ("goal: avoidable", "write goal: finding and adversary.constraints: [clean, fair]."),
        ("keep_tail: true", "is of versions 1 and 2; leave it out: nothing takes its place."),
    ],
)  # fmt: skip
def test_version_3_says_what_to_write_in_place_of_earlier_words(write, earlier, told):
    file = write(3, yaml.safe_load(f"{{{earlier}}}") | {"constraints": []})
    with pytest.raises(SpecError) as refused:
        spec.load(file)
    assert str(refused.value).endswith(told)


@pytest.mark.parametrize("gone", ["keep_tail: true", "av_driver: human"])
def test_what_has_no_meaning_any_more_is_refused_with_the_version_that_knows_it(write, gone):
    with pytest.raises(SpecError, match=r"is gone; leave it out, or run the spec with .* 0\.1\."):
        spec.load(write(2, yaml.safe_load(f"{{{gone}}}")))


def test_an_unknown_number_of_the_form_is_told_with_the_nearest(write):
    with pytest.raises(SpecError, match=r"'adversary\.form\.reaction': .*Did you mean 'reactions'"):
        spec.load(write(3, {"form": {"reaction": 4}}))


def test_published_form_and_likeliest_contradict_each_other_in_both(write):
    for version in (1, 2, 3):
        with pytest.raises(SpecError, match="form 'paper' contradicts rule: 'likeliest'"):
            spec.load(write(version, {"form": "paper", "rule": "likeliest"}))


def test_a_plug_in_that_derives_from_deepmf_keeps_its_own_defaults(write, monkeypatch):
    class Derived(Settings):
        rule: str = "pair"

    module = types.ModuleType("derived_module")
    module.Mine = type("Mine", (), {"Settings": Derived, "build": print})
    monkeypatch.setitem(sys.modules, "derived_module", module)
    for version in (1, 2, 3):
        loaded = spec.load(write(version, "derived_module:Mine"))
        assert loaded.adversary.settings == {}
        assert settings_of(loaded).rule == "pair"


PLAN = """version: {version}
name: versions
source: {{network: tiny.sumocfg, av: {{vehicle: av}}}}
planners: {{lane: {{name: idm, perception: lane}}}}
methods:
  default: S1
  paper: {{adversary: {{name: deepmf, form: paper}}}}
  weighted: {{adversary: {{name: deepmf, rule: expected, form: {{likelihood_weight: 0.1}}}}}}
"""


@pytest.mark.parametrize(("version", "rule"), [(1, "expected"), (2, "likeliest"), (3, "likeliest")])
def test_plans_have_the_versions_of_specs(write, tmp_path, version, rule):
    write()
    file = tmp_path / "plan.yaml"
    file.write_text(PLAN.format(version=version))
    found = entries.entries_of(plan.load(file), tmp_path)
    assert [settings_of(one.specs[0]).rule for one in found] == [rule, "expected", "expected"]
    assert {one.specs[0].version for one in found} == {version}


def test_a_plan_of_another_version_or_with_a_useless_weight_is_refused(write, tmp_path):
    write()
    file = tmp_path / "plan.yaml"
    file.write_text(PLAN.format(version=4))
    with pytest.raises(SpecError, match=r"plan\.yaml:1: key 'version': 4: must be 1, 2 or 3"):
        plan.load(file)
    file.write_text(PLAN.format(version=2).replace("rule: expected, ", ""))
    with pytest.raises(SpecError, match=r"plan\.yaml:8: .*add rule: expected.*'weighted'"):
        entries.entries_of(plan.load(file), tmp_path)


SCENARIOS = sorted((ROOT / "scenarios").glob("*.yaml"))
STUDIES = sorted(
    file for file in (ROOT / "studies").glob("*.yaml") if not file.stem.startswith("ablation")
)


@pytest.mark.parametrize("file", SCENARIOS, ids=lambda file: file.stem)
def test_scenarios_are_of_version_3_and_name_their_profile(file):
    loaded, written = spec.load(file), yaml.safe_load(file.read_text())
    assert (loaded.version, written["profile"]) == (3, "any")
    assert not {"rule", "likelihood_weight"} & set(written["adversary"])
    assert settings_of(loaded).rule == "likeliest"
    assert settings_of(loaded).constraints == ()


@pytest.mark.parametrize("file", STUDIES, ids=lambda file: file.stem)
def test_studies_name_their_profile_and_their_rule(file):
    values = yaml.safe_load(file.read_text())
    # what the default finds is measured as the default is
    profile = "fair" if file.stem in {"findings", "support"} else "any"
    assert (values["version"], values["profile"]) == (3, profile)
    methods = values.get("methods", {"spec": values}).values()
    chosen = [one["adversary"] for one in methods if isinstance(one, dict)]
    ours = [one for one in chosen if isinstance(one, dict) and one["name"] == "deepmf"]
    assert ours or file.stem == "no_attack"
    if profile == "fair":
        return
    assert all("rule" in one or one.get("form") == "paper" for one in ours)


def test_the_schema_knows_all_versions_and_the_default_of_each():
    schema = spec.schema()
    assert schema["properties"]["version"]["enum"] == [1, 2, 3]
    assert schema["properties"]["profile"]["enum"] == ["fair", "any", "lawful", "paper"]
    assert schema["properties"]["profile"]["default"] == "fair"
    rule = schema["$defs"]["adversary.deepmf"]["properties"]["rule"]
    assert (
        rule["default"] == "expected in version 1, likeliest in version 2, likeliest in version 3"
    )
    packed = (ROOT / "deepmf_sumo" / "data" / "spec.schema.json").read_text("utf-8")
    assert json.loads(packed) == schema
