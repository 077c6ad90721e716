"""`check --same-attacks`: a blind planner, one that sees, and the same attacks on both."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

from deepmf_sumo.cli import main
from deepmf_sumo.errors import UsageError
from deepmf_sumo.results.gate import SameAttacks
from deepmf_sumo.study.same_attacks import repeated

from tests.support import tiny_network


@pytest.fixture(scope="module")
def folders(tmp_path_factory, starts_sumo):
    """Result folders of five runs each: a planner that is blind, and one that follows."""
    folder = tmp_path_factory.mktemp("same")
    config = tiny_network.build(folder, lanes=1)
    for name in ("blind", "seeing"):
        values = {
            "version": 2,
            "name": "brakes",
            "source": {"network": str(config), "start_s": 1.0, "av": {"vehicle": "av"}},
            "duration_s": 8.0,
            "planner": "constant_velocity" if name == "blind" else "idm",
            "adversary": {"name": "trajectory", "agent": "leader", "poses": brakes()},
        }
        files = [folder / f"{name}-{number}.yaml" for number in range(5)]
        for number, file in enumerate(files):  # seeds of one spec would be one unit
            file.write_text(yaml.safe_dump(values | {"name": f"brakes {number}", "seed": 1}))
        out = ["--out", str(folder / name), "--no-pictures", "--jobs", "2"]
        assert run("run", *files, *out) == 0
    return folder


def brakes():
    """Poses of the leader: from 8 m/s to a stop, on the one lane of the road."""
    x, speed, poses = 68.0 - 2.5, 8.0, []
    for _ in range(90):
        speed = max(0.0, speed - 0.4)
        x += 0.1 * speed
        poses.append([x, -1.6, 0.0])
    return poses


def run(*arguments):
    return main.run([str(one) for one in arguments])


def test_hits_of_the_blind_planner_are_its_own(folders, tmp_path, capsys):
    junit = tmp_path / "junit.xml"
    arguments = ["--same-attacks", folders / "repeated", "--jobs", "2", "--junit", junit]
    code = run("check", folders / "blind", "--baseline", folders / "seeing", *arguments)
    shown = " ".join(capsys.readouterr().out.split())
    assert code == 1
    assert "same attacks: 5 hits, of which the baseline's planner avoids 5" in shown
    assert "0 hits of the baseline, of which this planner avoids 0" in shown
    assert "probability by chance: 0.031" in shown
    cases = ET.parse(junit).getroot().iter("testcase")
    (case,) = (one for one in cases if one.get("name") == "same attacks")
    assert case.find("failure") is not None


def test_the_other_way_round_it_is_better_and_the_runs_are_kept(folders, capsys):
    before = {one: one.stat().st_mtime_ns for one in (folders / "back").glob("runs/*/result.json")}
    for _ in range(2):
        arguments = ["--same-attacks", folders / "back", "--jobs", "2", "--format", "json"]
        run("check", folders / "seeing", "--baseline", folders / "blind", *arguments)
        rows = json.loads(capsys.readouterr().out)
        (row,) = (one for one in rows if one["kind"] == "same attacks")
        assert (row["value"], row["was"], row["state"]) == (0, 5, "better")
        now = {one: one.stat().st_mtime_ns for one in (folders / "back").glob("runs/*/result.json")}
        assert len(now) == 10
        assert not before or now == before
        before = now


def test_a_planner_has_no_hits_of_its_own_against_itself(folders):
    same = repeated(folders / "blind", folders / "blind", folders / "itself", 0.95, jobs=2)
    assert (same.hits, same.baseline_hits, same.own, same.baseline_own) == (5, 5, (), ())
    assert not same.unrepeated
    assert (same.chance, same.state) == (1.0, "cannot tell")


@pytest.mark.parametrize(
    ("own", "baseline_own", "chance", "state"),
    [(5, 0, 1 / 32, "worse"), (4, 0, 1 / 16, "cannot tell"), (7, 1, 9 / 256, "worse"),
     (1, 7, 255 / 256, "better"), (0, 0, 1.0, "cannot tell")],
)  # fmt: skip
def test_the_sign_test_by_hand(own, baseline_own, chance, state):
    same = SameAttacks(
        folder=Path(), hits=9, baseline_hits=9, own=tuple(f"a{n}--m--0" for n in range(own)),
        baseline_own=tuple(f"b{n}--m--0" for n in range(baseline_own)), unrepeated=(), level=0.05,
    )  # fmt: skip
    assert same.chance == pytest.approx(chance)
    assert same.state == state


def test_own_hits_with_several_seeds_of_one_spec_are_one():
    """Eight seeds of one spec, and one spec in which each planner has one: not 9 against 1."""
    same = SameAttacks(
        folder=Path(), hits=9, baseline_hits=9,
        own=(*(f"a--m--{seed}" for seed in range(8)), "c--m--0"),
        baseline_own=("c--m--1",), unrepeated=(), level=0.05,
    )  # fmt: skip
    assert (same.chance, same.state) == (0.5, "cannot tell")


def test_it_needs_two_result_folders(folders, tmp_path, capsys):
    with pytest.raises(UsageError, match="file of --write-baseline"):
        repeated(folders / "blind", folders / "blind-0.yaml", tmp_path / "out", 0.95)
    for results in ("blind", "seeing"):
        with pytest.raises(UsageError, match="holds the results themselves"):
            repeated(folders / "blind", folders / "seeing", folders / results, 0.95)
    arguments = ["--same-attacks", tmp_path / "out", "--write-baseline", tmp_path / "new.json"]
    assert run("check", folders / "blind", *arguments) == 2
    assert "--same-attacks repeats hits of a baseline" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
