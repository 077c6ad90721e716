"""Profiles: what a spec means where it says nothing, and that it means the same at every door."""

import inspect
from pathlib import Path

import click
import pytest
import yaml

from deepmf_sumo import api, plugins, spec
from deepmf_sumo.cli import attack as attack_command
from deepmf_sumo.cli import main
from deepmf_sumo.cli._sweep import options as sweep_options
from deepmf_sumo.deepmf.settings import Form, Settings
from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.live import attacker
from deepmf_sumo.spec import profiles, tasks
from deepmf_sumo.study import plans
from deepmf_sumo.study.plans import entries, plan

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "sumo_nets" / "four_way" / "four_way.sumocfg"
FAIR = ("clean", "fair", "no_rear_end", "with_traffic")
ON_NETWORK = {"network": str(CONFIG), "start_s": 40.0, "av": {"vehicle": "av"}}


def written(folder, **values):
    file = folder / "spec.yaml"
    keys = {"version": 3, "name": "one", "source": ON_NETWORK}
    file.write_text(yaml.safe_dump({**keys, **values}))
    return file


def settings_of(loaded):
    return plugins.settings("adversaries", loaded.adversary.name, loaded.adversary.settings)


def refusal(error):
    return str(error.value)


# What a profile stands for


@pytest.mark.parametrize(
    ("profile", "constraints", "form", "rule"),
    [
        (None, FAIR, "extended", "likeliest"),
        ("fair", FAIR, "extended", "likeliest"),
        ("any", (), "extended", "likeliest"),
        ("lawful", ("lawful",), "extended", "likeliest"),
        ("paper", (), "paper", "expected"),
    ],
)
def test_what_each_profile_stands_for(tmp_path, profile, constraints, form, rule):
    loaded = spec.load(written(tmp_path, **({} if profile is None else {"profile": profile})))
    found = settings_of(loaded)
    assert (found.constraints, found.form.preset, found.rule) == (constraints, form, rule)
    assert loaded.profile == (profile or "fair")
    assert loaded.resolved()["profile"] == loaded.profile


@pytest.mark.parametrize("profile", list(profiles.PROFILES))
@pytest.mark.parametrize(
    "adversary", ["S2", "none", "bga", {"name": "deepmf", "opponent": "b"}, {"version": "G"}]
)
def test_a_resolved_spec_reads_back_to_itself(tmp_path, profile, adversary):
    loaded = spec.load(written(tmp_path, profile=profile, adversary=adversary, duration_s=30.0))
    again = tmp_path / "again.yaml"
    again.write_text(yaml.safe_dump(loaded.resolved()))
    assert spec.load(again) == loaded
    assert spec.load(again).resolved() == loaded.resolved()


@pytest.mark.parametrize(
    ("adversary", "expected"),
    [
        ({"constraints": []}, ()),
        ({"constraints": ["on_road", "clean", "on_road"]}, ("clean", "on_road")),
        ({"sector": "front"}, FAIR),
        ({"sector": "rear"}, ("clean", "with_traffic")),  # a ram
        ({"goal": "finding"}, FAIR),
        ({"form": "paper"}, ()),
        ({"rule": "pair"}, FAIR),
        ({"aggressiveness": 0.5}, FAIR),
    ],
)
def test_what_the_spec_states_wins_over_its_profile(tmp_path, adversary, expected):
    loaded = spec.load(written(tmp_path, adversary={"name": "deepmf", **adversary}))
    found = settings_of(loaded)
    assert found.constraints == expected
    for key, value in adversary.items():
        if key != "constraints":
            assert getattr(found, key) == (Form(preset=value) if key == "form" else value)


def test_the_published_form_is_the_profile_paper(tmp_path):
    for profile in ("fair", "any", "paper"):
        found = spec.load(written(tmp_path, profile=profile, adversary={"form": "paper"}))
        assert (found.profile, settings_of(found).form.preset) == ("paper", "paper")
    contradiction = written(tmp_path, profile="paper", adversary={"form": "extended"})
    with pytest.raises(SpecError, match=r"adversary\.form': contradicts the profile paper"):
        spec.load(contradiction)


@pytest.mark.parametrize("adversary", ["none", "bga", "brs", "cat", "rule", "king", "strive"])
def test_adversaries_without_such_settings_are_as_they_were(tmp_path, adversary):
    found = [
        spec.load(written(tmp_path, adversary=adversary, **keys))
        for keys in ({}, {"profile": "lawful"}, {"profile": "paper"}, {"version": 2})
    ]
    assert all(one.adversary == found[0].adversary for one in found)
    assert found[0].adversary.settings == {}


@pytest.mark.parametrize("profile", ["fare", "", 3, None, [], ["fair"], {"fair": True}])
def test_an_unknown_profile_is_refused(tmp_path, profile):
    with pytest.raises(SpecError, match="key 'profile'"):
        spec.load(written(tmp_path, profile=profile))


# Turns and moments


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"duration_s": 15.0}, "one"),
        ({"duration_s": 15.1}, "in_turn"),
        ({"duration_s": 30.0, "opponents": "one"}, "one"),
        ({"duration_s": 30.0, "profile": "any"}, "in_turn"),
        ({"duration_s": 30.0, "profile": "paper"}, "one"),
        ({"duration_s": 30.0, "adversary": "none"}, "in_turn"),
        ({"duration_s": 30.0, "adversary": "bga"}, "one"),
        ({"duration_s": 30.0, "adversary": {"opponent": "b"}}, "one"),
        ({"duration_s": 30.0, "adversary": {"tries": 2}}, "one"),
        ({"duration_s": 30.0, "source": {"recording": str(ROOT / "scenarios")}}, "one"),
        ({"duration_s": 30.0, "version": 2}, "one"),
    ],
)
def test_opponents_take_turns_in_long_attacks(tmp_path, keys, expected):
    assert spec.load(written(tmp_path, **keys)).opponents == expected


@pytest.mark.parametrize(
    ("moments", "prefer", "from_s"),
    [
        ({"count": 4}, "both", "settled"),
        ({"count": 4, "prefer": "spread", "from_s": 60.0}, "spread", 60.0),
        ({"count": 4, "from_s": None}, "both", None),
        ({"av": "b"}, "both", None),
        ({"at_s": [30.0]}, "both", None),
        ({"of": "results"}, "spread", None),
    ],
)
def test_moments_of_version_3_are_chosen_as_attack_does(tmp_path, moments, prefer, from_s):
    source = {"network": str(CONFIG), "moments": moments}
    found = spec.load(written(tmp_path, source=source)).source.moments
    assert (found.prefer, found.from_s) == (prefer, from_s)
    older = spec.load(written(tmp_path, source=source, version=2)).source.moments
    assert (older.prefer, older.from_s) == (moments.get("prefer", "spread"), moments.get("from_s"))
    file = tmp_path / "plan.yaml"
    methods = {"methods": {"a": "none"}, "planners": {"idm": "idm"}}
    file.write_text(yaml.safe_dump({"version": 3, "name": "p", "source": source, **methods}))
    assert plan.load(file).plan.source[0].moments == found


# Versions 1 and 2

OLDER = [
    ({}, ()),
    ({"fair": True}, ("fair",)),
    ({"fair": False, "lawful": False, "no_rear_end": False}, ()),
    ({"lawful": True, "no_rear_end": True, "constraints": ["on_road"]},
     ("lawful", "no_rear_end", "on_road")),
    ({"fair": False, "constraints": ["fair"]}, ("fair",)),
    ({"constraints": ["with_traffic", "on_road"]}, ("on_road", "with_traffic")),
]  # fmt: skip


@pytest.mark.parametrize(("adversary", "expected"), OLDER)
@pytest.mark.parametrize("version", [1, 2])
def test_older_specs_keep_their_meaning(tmp_path, version, adversary, expected):
    choice = {"name": "deepmf", **adversary}
    loaded = spec.load(written(tmp_path, version=version, adversary=choice, duration_s=30.0))
    assert settings_of(loaded).constraints == expected
    assert (loaded.profile, loaded.opponents) == ("any", "one")
    assert not {"profile", "opponents"} & loaded.resolved().keys()
    if version == 2:
        assert settings_of(loaded).rule == "likeliest"
        newer = {"name": "deepmf", "constraints": list(expected)}
        same = spec.load(written(tmp_path, profile="any", adversary=newer, opponents="one"))
        assert settings_of(same) == settings_of(loaded)


def test_older_specs_of_the_published_form_are_of_the_profile_paper(tmp_path):
    loaded = spec.load(written(tmp_path, version=1, adversary={"form": "paper"}))
    assert (loaded.profile, settings_of(loaded).rule) == ("paper", "expected")


@pytest.mark.parametrize("version", [1, 2])
def test_a_profile_is_of_version_3(tmp_path, version):
    told = f"profile': is a key of version 3, and this is version {version}"
    with pytest.raises(SpecError, match=told):
        spec.load(written(tmp_path, version=version, profile="fair"))


# One way to state a constraint


@pytest.mark.parametrize("name", ["fair", "lawful", "no_rear_end"])
def test_both_spellings_of_older_specs_are_one_run(tmp_path, name):
    keys = set()
    for adversary in (
        {name: True},
        {"constraints": [name]},
        {"constraints": [name, name]},
        {name: True, "constraints": [name]},
    ):
        file = written(tmp_path, version=2, adversary={"name": "deepmf", **adversary})
        [task] = tasks.plan([spec.load(file)], tmp_path)
        keys.add(task.key)
        assert task.spec.adversary.settings["constraints"] == [name]
        assert name not in task.spec.adversary.settings
    assert len(keys) == 1


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("adversary", [{"no_rear_end": True}, {"constraints": ["no_rear_end"]}])
def test_a_wish_for_the_rear_contradicts_both_spellings(tmp_path, version, adversary):
    choice = {"name": "deepmf", "sector": "rear", **adversary}
    expected = "contradict each other" if version == 2 or "constraints" in adversary else "write"
    with pytest.raises(SpecError, match=expected):
        spec.load(written(tmp_path, version=version, adversary=choice))


@pytest.mark.parametrize(
    ("keys", "switched", "told"),
    [
        ({}, "fair: false", "[clean, no_rear_end, with_traffic]"),
        ({"profile": "any"}, "fair: true", "[fair], or profile: fair"),
        ({"profile": "any"}, "lawful: true", "[lawful], or profile: lawful"),
        ({"profile": "any"}, "no_rear_end: false", "[]"),
        ({}, "constraints: [clean], no_rear_end: true", "[clean, no_rear_end]"),
    ],
)
def test_version_3_says_what_to_write_in_place_of_a_switch(tmp_path, keys, switched, told):
    choice = yaml.safe_load(f"{{name: deepmf, {switched}}}")
    with pytest.raises(SpecError) as error:
        spec.load(written(tmp_path, adversary=choice, **keys))
    assert refusal(error).endswith(f"write adversary.constraints: {told}.")
    assert "is of versions 1 and 2" in refusal(error)


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize(
    "wrong",
    [
        {"fair": "yes"},
        {"lawful": 1},
        {"no_rear_end": None},
        {"fair": [], "goal": "avoidable"},
        {"constraints": "fair"},
        {"constraints": None},
        {"constraints": ["fair", None]},
        {"constraints": ["fair", ["on_road"]], "fair": True},
        {"constraints": [1.5, "fair"]},
        {"constraints": {"fair": True}},
    ],
)
def test_what_is_no_constraint_is_refused(tmp_path, version, wrong):
    with pytest.raises(SpecError, match="adversary"):
        spec.load(written(tmp_path, version=version, adversary={"name": "deepmf", **wrong}))


# Every door


def of_attack(*arguments, monkeypatch, tmp_path):
    """The specs that ``attack`` runs."""
    found = []

    def seen(specs, *_args, **_more):
        found.extend(specs)
        raise UsageError("seen")

    monkeypatch.setattr(plans, "run_specs", seen)
    assert main.run(["attack", *map(str, arguments), "--out", str(tmp_path / "out")]) == 2
    return found


def of_api(monkeypatch, **arguments):
    """The spec that `api.attack` runs."""
    found = []

    def seen(specs, *_args, **_more):
        found.extend(specs)
        raise UsageError("seen")

    monkeypatch.setattr(plans, "run_specs", seen)
    with pytest.raises(UsageError, match="seen"):
        api.attack(CONFIG, **arguments)
    return found[0]


def test_every_door_means_the_same_attack(tmp_path, monkeypatch):
    """Where nothing is said: a spec, `attack`, a program, a plan; a running simulation once."""
    doors = {
        "spec": spec.load(written(tmp_path)),
        "attack": of_attack(CONFIG, monkeypatch=monkeypatch, tmp_path=tmp_path)[0],
        "api": of_api(monkeypatch),
        "live": attacker.spec_of(attacker.AttackRequest(avs=("ego",))),
    }
    values = {"version": 3, "name": "p", "source": ON_NETWORK, "planners": {"idm": "idm"}}
    file = tmp_path / "plan.yaml"
    file.write_text(yaml.safe_dump({**values, "methods": {"a": {"adversary": "deepmf"}}}))
    [row] = entries.entries_of(plan.load(file), tmp_path)
    doors["plan"] = row.specs[0]
    found = {name: (one.profile, settings_of(one)) for name, one in doors.items()}
    live = Settings(rule="likeliest", constraints=FAIR)
    assert found.pop("live") == ("fair", live)
    assert all(one == found["spec"] for one in found.values())
    searched = {"goal": "finding", "tries": 8}
    assert found["spec"] == ("fair", live.model_copy(update=searched))


@pytest.mark.parametrize("profile", list(profiles.PROFILES))
def test_every_door_takes_a_profile(tmp_path, monkeypatch, profile):
    sets = f"profile={profile}"
    doors = [
        spec.load(written(tmp_path, profile=profile)),
        spec.load(written(tmp_path), [sets]),
        of_attack(CONFIG, "--set", sets, monkeypatch=monkeypatch, tmp_path=tmp_path)[0],
        of_api(monkeypatch, profile=profile),
        of_api(monkeypatch, sets=[sets]),
    ]
    live = attacker.spec_of(attacker.AttackRequest(avs=("ego",), sets=(sets,)))
    values = {"version": 3, "name": "p", "source": ON_NETWORK, "planners": {"idm": "idm"}}
    for keys in (
        {"profile": profile, "methods": {"a": "deepmf"}},
        {"methods": {"a": {"adversary": "deepmf", "profile": profile}}},
    ):
        file = tmp_path / "plan.yaml"
        file.write_text(yaml.safe_dump({**values, **keys}))
        [row] = entries.entries_of(plan.load(file), tmp_path)
        doors.append(row.specs[0])
    assert {one.profile for one in (live, *doors)} == {profile}
    assert all(settings_of(one) == settings_of(doors[0]) for one in doors)
    once = {"goal": "hit", "tries": 1}
    assert settings_of(live) == settings_of(doors[0]).model_copy(update=once)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({}, ("finding", 8)),
        ({"adversary": {"opponent": "b"}}, ("finding", 8)),
        ({"adversary": {"tries": 1}}, ("finding", 1)),
        ({"adversary": {"tries": 9}}, ("finding", 9)),
        ({"adversary": {"goal": "hit"}}, ("hit", 1)),
        ({"adversary": {"goal": "hit", "tries": 3}}, ("hit", 3)),
        ({"adversary": {"constraints": ["on_road"]}}, ("hit", 1)),  # another kind of attack
        ({"adversary": {"sector": "rear"}}, ("hit", 1)),  # a ram is no finding
        ({"adversary": {"sector": "front"}}, ("finding", 8)),
        ({"adversary": "G"}, ("hit", 1)),
        ({"adversary": {"version": "S1"}}, ("hit", 1)),
        ({"duration_s": 30.0}, ("hit", 1)),  # opponents in turn
        ({"duration_s": 30.0, "opponents": "one"}, ("finding", 8)),
        ({"profile": "any"}, ("hit", 1)),
        ({"profile": "lawful"}, ("hit", 1)),
        ({"profile": "paper"}, ("hit", 1)),
        ({"version": 2}, ("hit", 1)),
    ],
)
def test_the_search_for_a_finding_is_the_default(tmp_path, keys, expected):
    """Of one opponent, offline, where the spec means no other attack."""
    found = settings_of(spec.load(written(tmp_path, **keys)))
    assert (found.goal, found.tries) == expected


@pytest.mark.parametrize("version", [1, 2])
def test_the_goal_of_older_specs_has_its_constraints(tmp_path, version):
    choice = {"name": "deepmf", "goal": "avoidable", "constraints": ["no_rear_end"], "tries": 3}
    found = settings_of(spec.load(written(tmp_path, version=version, adversary=choice)))
    assert (found.goal, found.tries) == ("finding", 3)
    assert found.constraints == ("clean", "fair", "no_rear_end")
    choice |= {"goal": "finding", "constraints": list(found.constraints)}
    newer = written(tmp_path, profile="any", adversary=choice)
    assert settings_of(spec.load(newer)) == found.model_copy(update={"rule": "likeliest"})


def test_a_plan_says_opponents_and_turns_as_a_spec(tmp_path):
    file = tmp_path / "plan.yaml"
    values = {"version": 3, "name": "p", "source": ON_NETWORK, "planners": {"idm": "idm"}}
    values |= {"methods": {"a": "deepmf"}, "duration_s": 30.0}
    for keys, expected in (({}, "in_turn"), ({"opponents": "one"}, "one")):
        file.write_text(yaml.safe_dump({**values, **keys, "turns": {"longest_s": 9.0}}))
        [row] = entries.entries_of(plan.load(file), tmp_path)
        assert (row.specs[0].opponents, row.specs[0].turns.longest_s) == (expected, 9.0)


SAVED = {
    "nothing": [],
    "count": ["-n", 3],
    "av": ["--av", "flow_s_w.2"],
    "tries": ["--tries", 1],
    "sets, type": ["--set", "source.moments.av_type=DEFAULT_VEHTYPE"],
    "junctions": ["--junction", "c"],
    "edges": ["--edge", "sc"],
    "sets of moments": ["--set", "source.moments.polygon=area.xml"],
    "at_s": ["--at", 40, "--at", 50],
    "of": ["--moments-of", "earlier"],
    "sets, spread": ["--set", "source.moments.prefer=spread"],
    "sets, encounters": ["--set", "source.moments.prefer=encounters"],
    "from_s": ["--from", 20],
    "until_s": ["--until", 90],
    "sets, longer": ["--set", "duration_s=30"],
    "sets, one opponent": ["--set", "duration_s=30", "--set", "opponents=one"],
    "sets, one try": ["--set", "adversary.tries=1"],
    "sets, promising": ["--set", "source.moments.draw=promising"],
    "sets, any": ["--set", "profile=any", "--set", "adversary.constraints=[on_road]"],
    "sets, from the rear": ["--set", "profile=any", "--set", "adversary.sector=rear"],
    "sets, moments of": ["--set", "source.moments.of=earlier"],
    "planner": ["--planner", "sumo"],
    "seed": ["--seed", 7],
    "sets": ["--set", "adversary=S2", "--set", "adversary.opponent=met"],
    "sets ": ["--set", "profile=lawful", "--set", "planner.perception=corridor"],
    "sets  ": ["--set", "adversary.form=paper"],
    "sets   ": ["--set", "adversary={name: trajectory, agent: b, file: way.json}"],
    "sets    ": ["--set", "weights=./own", "--set", "turns.longest_s=5", "--set", "duration_s=20"],
}


@pytest.mark.parametrize("case", SAVED)
def test_a_saved_spec_is_the_attack(tmp_path, monkeypatch, case):
    """Whatever the options say, and from wherever the spec is run."""
    (tmp_path / "own").mkdir()
    (tmp_path / "specs").mkdir()
    (tmp_path / "area.xml").write_text("<additional/>")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("deepmf_sumo.deepmf.networks.weights.find", Path)
    arguments = [CONFIG, *SAVED[case]]
    [attacked] = of_attack(*arguments, monkeypatch=monkeypatch, tmp_path=tmp_path)
    file = tmp_path / "specs" / "saved.yaml"
    assert main.run(["attack", *map(str, arguments), "--save-spec", str(file)]) == 0
    monkeypatch.chdir("/")
    saved = spec.load(file)
    assert saved == attacked
    assert saved.resolved() == attacked.resolved()
    assert yaml.safe_load(file.read_text())["profile"] == attacked.profile


def test_every_option_of_attack_is_tried():
    @click.command()
    @sweep_options(out="")
    def shared() -> None: ...

    own = {one.name for one in attack_command.command.params} - {one.name for one in shared.params}
    not_of_a_spec = {"configs", "file"}
    tried = {name.strip() for name in SAVED if not name.startswith("sets,")}
    assert own - not_of_a_spec == tried - {"nothing", "sets of moments"}


def test_a_program_says_all_that_the_command_says(tmp_path, monkeypatch):
    (tmp_path / "area.xml").write_text("<additional/>")
    monkeypatch.chdir(tmp_path)
    for options, arguments in (
        (["--set", "source.moments.prefer=encounters"], {"prefer": "encounters"}),
        (["--moments-of", "earlier"], {"moments_of": "earlier"}),
        (["--planner", "sumo"], {"planner": "sumo"}),
        (["--set", "planner={name: idm, perception: corridor}"],
         {"planner": {"name": "idm", "perception": "corridor"}}),
        (["--set", "duration_s=30"], {"duration_s": 30.0}),
        (["--set", "duration_s=30", "--set", "opponents=one"],
         {"duration_s": 30.0, "opponents": "one"}),
        (["--set", "adversary.tries=1"], {"tries": 1}),
        (["--set", "source.moments.draw=promising"], {"draw": "promising"}),
        (["--set", "source.moments.polygon=area.xml", "--at", 40],
         {"polygon": "area.xml", "at_s": [40.0]}),
        (["-n", 3, "--seed", 7, "--from", 5, "--until", 90],
         {"moments": 3, "seed": 7, "from_s": 5.0, "until_s": 90.0}),
    ):  # fmt: skip
        [attacked] = of_attack(CONFIG, *options, monkeypatch=monkeypatch, tmp_path=tmp_path)
        assert of_api(monkeypatch, **arguments) == attacked
    names = set(inspect.signature(api.attack).parameters)
    here = {"count": "moments", "of": "moments_of", "configs": "configs"}
    options = {here.get(one.name, one.name) for one in attack_command.command.params}
    assert options - names == {"file", "formats", "shard"}


def test_a_wrong_attack_is_not_saved(tmp_path, capsys):
    file = tmp_path / "saved.yaml"
    arguments = ["--set", "adversary.constraints=[fare]", "--save-spec", str(file)]
    assert main.run(["attack", str(CONFIG), *arguments]) == 2
    assert "Did you mean 'fair'" in capsys.readouterr().err
    assert not file.exists()


@pytest.mark.parametrize(
    ("sets", "told"),
    [
        ("version=2", "attack is short for specs of version 3"),
        ("source.network=other.sumocfg", "only those of source.moments can be set"),
        ("source.moments.prefer=most", "key 'source.moments.prefer'"),
        ("sweep.figures=false", "sweep.figures is not for this command"),
        ("sweep.timeout=3", "Did you mean 'timeout_s'"),
        ("sweep.timeout_s=-3", "key 'sweep.timeout_s'"),
        ("sweep.memory_mb=.nan", "key 'sweep.memory_mb'"),
    ],
)
def test_what_an_attack_cannot_set(tmp_path, capsys, sets, told):
    out = ["--out", str(tmp_path / "out")]
    assert main.run(["attack", str(CONFIG), "--set", sets, *out]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# What is said of a run


@pytest.mark.parametrize(
    ("meant", "expected"),
    [
        ([], ""),
        ([""], ""),
        (["lawful (lawful)"] * 3, "profile lawful (lawful)"),
        (["any", "paper", "any", ""], "profiles any (2 runs); paper (1 run)"),
    ],
)
def test_the_headline(meant, expected):
    assert profiles.headline(meant) == expected


@pytest.mark.parametrize(
    ("profile", "constraints", "expected"),
    [
        ("fair", FAIR, "fair (clean, fair, no_rear_end, with_traffic)"),
        ("fair", (), "fair (no constraints)"),
        ("any", (), "any"),
        ("any", ("on_road",), "any (on_road)"),
        ("paper", (), "paper"),
        ("", (), ""),
    ],
)
def test_the_profile_of_a_run(profile, constraints, expected):
    assert profiles.described(profile, constraints) == expected
