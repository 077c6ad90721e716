"""``deepmf-sumo attack`` for minutes: opponents take turns."""

import csv

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.study.moments import documents, spec_of


@pytest.mark.parametrize(
    ("keys", "sets", "expected"),
    [
        ({"duration_s": 16.0}, (), "in_turn"),
        ({}, ("duration_s=16.0",), "in_turn"),
        ({"duration_s": 16.0}, ("adversary=bbo",), "one"),
        ({"duration_s": 16.0}, ("opponents=one",), "one"),
        ({"duration_s": 16.0}, ("adversary.opponent=truck1",), "one"),
        ({"duration_s": 16.0}, ("adversary.opponent=sample",), "in_turn"),
        ({"duration_s": 16.0}, ("adversary=none",), "in_turn"),
        ({"duration_s": 16.0, "opponents": "one"}, (), "one"),
        ({"duration_s": 15.0}, (), "one"),
        ({"duration_s": 4.0, "opponents": "in_turn"}, (), "in_turn"),
    ],
)
def test_long_attacks_are_in_turn_unless_something_else_is_asked_for(tiny, keys, sets, expected):
    [document] = documents([tiny / "tiny.sumocfg"], keys, sets)
    assert spec_of(document).opponents == expected


def test_turns_have_a_table(tiny, tmp_path):
    out = tmp_path / "out"
    asked = [
        "--set",
        "opponents=in_turn",
        "--set",
        "duration_s=1",
        "--moments",
        "1",
        "--no-pictures",
    ]
    command = ["attack", str(tiny / "tiny.sumocfg"), "--out", str(out), *asked]
    assert main.run([*command, "--set", "adversary=none"]) == 0
    with (out / "runs.csv").open() as table:
        (row,) = csv.DictReader(table)
    assert (row["turns"], row["turn_hits"]) == ("0", "0")
    assert (out / "turns.csv").read_text().startswith("run_id,spec,scene,")


def test_a_search_for_one_attack_takes_no_turns(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    asked = ["--set", "adversary=bbo", "--set", "opponents=in_turn", "--set", "duration_s=20"]
    assert main.run(["attack", str(tiny / "tiny.sumocfg"), "--out", str(out), *asked]) == 2
    assert "bbo looks for one attack" in capsys.readouterr().err
