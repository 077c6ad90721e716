"""Specs and plans whose source chooses moments of a network."""

import csv

import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.cli import main
from deepmf_sumo.errors import SpecError
from deepmf_sumo.spec import FromMoments, FromNetwork, tasks
from deepmf_sumo.study import plans

from tests.support import tiny_network
from tests.support.same_bytes import differences

MOMENTS = "{network: tiny.sumocfg, moments: {count: 2}}"
PLAN = """version: 1
name: moments
source: {network: tiny.sumocfg, moments: {count: 2}}
duration_s: 0.5
planners: {lane: idm}
methods: {none: none, again: none}
"""


def call(*arguments):
    return main.run([str(one) for one in arguments])


def rows(file):
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


@pytest.mark.sumo
def test_attack_is_short_for_a_spec_with_moments(tiny, tmp_path, capsys):
    config, file = tiny / "tiny.sumocfg", tmp_path / "attack.yaml"
    attack = ["attack", config, "-n", 1, "--set", "duration_s=0.5"]
    attack += ["--planner", "sumo", "--no-pictures", "--set", "sweep.risk=false"]
    assert call(*attack, "--out", tmp_path / "a", "--", "--scale", 1) == 0
    assert call(*attack, "--save-spec", file, "--out", tmp_path / "no", "--", "--scale", 1) == 0
    assert not (tmp_path / "no").exists()
    written = yaml.safe_load(file.read_text())
    assert written["source"]["moments"] == {"count": 1}
    assert (written["version"], written["seed"], written["duration_s"]) == (3, 23423, 0.5)
    assert written["profile"] == "fair"
    capsys.readouterr()
    assert call("run", file, "--no-pictures", "--out", tmp_path / "b") == 0
    assert "tiny.sumocfg: 2 vehicles from 0 to" in capsys.readouterr().err
    assert differences(tmp_path / "a", tmp_path / "b") == []
    plans = sorted((tmp_path / "a" / "runs").glob("*/plans.npz"))
    assert len(plans) == 1, "the default adversary plans"
    assert (tmp_path / "a" / "moments.csv").read_bytes() == (
        tmp_path / "b" / "moments.csv"
    ).read_bytes()


@pytest.mark.sumo
def test_specs_with_and_without_moments_go_into_one_folder(tiny, tmp_path):
    chosen = tiny_network.spec(tiny, "chosen", source=MOMENTS)
    given = tiny_network.spec(tiny, "given")
    out = tmp_path / "out"
    assert call("run", given, chosen, "--no-pictures", "--out", out) == 0
    ids = [row["run_id"] for row in rows(out / "runs.csv")]
    assert ids[0] == "given--tiny--0"
    assert [row["run_id"] for row in rows(out / "moments.csv")] == ids[1:]
    assert all(one.startswith("chosen--") for one in ids[1:])
    kept = spec.load(out / "runs" / ids[1] / "spec.yaml")
    assert type(kept.source) is FromNetwork


@pytest.mark.sumo
def test_a_plan_has_moments(tiny, tmp_path, capsys):
    file = tiny / "moments.yaml"
    file.write_text(PLAN)
    out = tmp_path / "out"
    assert call("run", file, "--out", out) == 0
    assert "4 runs: 4 ok" in capsys.readouterr().out
    table = rows(out / "runs.csv")
    assert [row["method"] for row in table] == ["none", "none", "again", "again"]
    assert [row["run_id"] for row in rows(out / "moments.csv")] == [row["run_id"] for row in table]
    assert table[0]["scene"] == table[2]["scene"] != table[1]["scene"]
    assert [row["scenes"] for row in rows(out / "table.csv")] == ["2", "2"]
    for part in (1, 2):
        shard = ("--shard", f"{part}/2", "--out", tmp_path / str(part))
        assert call("run", file, "--set", "sweep.figures=false", *shard) == 0
    merged = ("merge", tmp_path / "all", tmp_path / "1", tmp_path / "2")
    assert call(*merged) == 0
    assert differences(out, tmp_path / "all") == []


def test_moments_of_a_plan_are_those_of_one_seed(tiny):
    file = tiny / "seeds.yaml"
    file.write_text(PLAN + "seeds: [0, 1]\n")
    with pytest.raises(SpecError, match="key 'seeds': moments are those of one traffic"):
        plans.load(file)


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("{network: tiny.sumocfg, moments: {cuont: 2}}", "source.moments.cuont.* mean 'count'"),
        ("{network: tiny.sumocfg, moments: {}, start_s: 2.0}", "'start_s' does not go with"),
        (
            "{network: tiny.sumocfg, moments: {of: a, av: b}}",
            "moments.av': cannot be given with 'of'",
        ),
        (
            "{network: tiny.sumocfg, moments: {of: a, prefer: encounters}}",
            "moments.prefer': encounters cannot be given with 'of'",
        ),
        ("{recording: ., moments: {}}", "unknown key"),
    ],
)
def test_moments_that_are_refused(tiny, source, told):
    with pytest.raises(SpecError, match=told):
        spec.load(tiny_network.spec(tiny, "refused", source=source))


@pytest.mark.parametrize(
    ("moments", "told"),
    [
        ("{av: laeder}", "source.moments.av laeder: no such vehicle is in the demand of"),
        ("{at_s: [2.55]}", r"source.moments.at_s 2.55: the simulation goes in steps of 0.1 s"),
        ("{of: nothing}", r"source.moments.of .*nothing: .*cannot be read"),
    ],
)
def test_messages_name_the_key(tiny, tmp_path, capsys, moments, told):
    source = f"{{network: tiny.sumocfg, moments: {moments}}}"
    path = tiny_network.spec(tiny, "keys", source=source)
    assert call("run", path, "--out", tmp_path / "out") == 2
    assert told.replace(".*", "") in capsys.readouterr().err or ".*" in told
    assert not (tmp_path / "out").exists()


def test_moments_are_for_run_alone(tiny, tmp_path):
    loaded = spec.load(tiny_network.spec(tiny, "alone", source=MOMENTS))
    assert isinstance(loaded.source, FromMoments)
    assert loaded.resolved()["source"].keys() == {"network", "sumo_options", "moments"}
    with pytest.raises(SpecError, match=r"key 'source\.moments' is for `deepmf-sumo run`"):
        tasks.plan([loaded], tmp_path)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["second.yaml"], "a plan is run by itself"),
        (["-k", "x"], "-k is for specs"),
        (["--without", "nobody"], "the plan has no such method"),
    ],
)
def test_what_a_plan_does_not_go_with(tiny, tmp_path, monkeypatch, capsys, more, told):
    monkeypatch.chdir(tiny)
    for name in ("first.yaml", "second.yaml"):
        (tiny / name).write_text(PLAN)
    assert call("run", "first.yaml", *more, "--out", tmp_path / "out") == 2
    assert told in capsys.readouterr().err
    one = tiny_network.spec(tiny, "one")
    assert call("run", one, "--without", "x", "--out", tmp_path / "out") == 2
    assert "--without is for a plan" in capsys.readouterr().err


@pytest.mark.sumo
def test_moments_of_a_spec_that_is_not_named_stay(tiny, tmp_path):
    first = tiny_network.spec(tiny, "first", source=MOMENTS)
    second = tiny_network.spec(tiny, "second", source=MOMENTS)
    run = ("run", "--no-pictures", "--set", "duration_s=0.5", "--out", tmp_path / "out")
    assert call(*run, first, second) == 0
    before = [rows(tmp_path / "out" / name) for name in ("moments.csv", "flow.csv", "runs.csv")]
    assert call(*run, second, "--resume") == 0
    after = [rows(tmp_path / "out" / name) for name in ("moments.csv", "flow.csv", "runs.csv")]
    for old, new in zip(before, after, strict=True):
        assert sorted(map(repr, old)) == sorted(map(repr, new))
    assert len(after[0]) == 4
