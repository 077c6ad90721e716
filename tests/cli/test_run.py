import csv
import json
from pathlib import Path

import pytest

from deepmf_sumo.cli import main

from tests.support import tiny_network

ROOT = Path(__file__).resolve().parents[2]


def test_runs_and_prints_a_table(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    path = tiny_network.spec(tiny, "shown")
    arguments = [
        "run",
        path,
        "--out",
        out,
        "--seed",
        3,
        "--no-pictures",
        "--set",
        "sweep.junit=true",
    ]
    assert main.run([str(one) for one in arguments]) == 0
    captured = capsys.readouterr()
    assert "shown--tiny--3" in captured.out
    assert "no contact" in captured.out
    assert "1 of 1 runs" in captured.err
    assert json.loads((out / "summary.json").read_text())["status"] == {"ok": 1}
    assert (out / "junit.xml").exists()
    run = out / "runs" / "shown--tiny--3"
    assert not (run / "picture.png").exists()
    assert json.loads((run / "result.json").read_text())["seed"] == 3


def test_a_broken_expectation_is_exit_code_1(tiny, tmp_path, capsys):
    path = tiny_network.spec(tiny, "wrong", expect="{outcome: av_opponent}")
    assert main.run(["run", str(path), "--out", str(tmp_path / "o"), "--no-pictures"]) == 1
    assert "EXPECTATION BROKEN" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.yaml"], "missing.yaml: cannot be read"),
        (["good.yaml", "--set", "planner.name=imd"], "Did you mean 'idm'?"),
        (["good.yaml", "--set", "sed=1"], "Did you mean 'seed'?"),
        (["good.yaml", "--out", "good.yaml/out"], "cannot be written"),
        (["good.yaml", "-k", "zzz"], "-k zzz leaves none of 1 runs"),
        (["good.yaml", "good.yaml"], "Two runs are called"),
    ],
)
def test_refusals_are_one_line(tiny, monkeypatch, capsys, arguments, message):
    tiny_network.spec(tiny, "good")
    monkeypatch.chdir(tiny)
    assert main.run(["run", *arguments]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in errors if line.startswith("deepmf-sumo: ")]) == 1
    assert message in errors[-1]
    assert not (tiny / "results").exists()


def test_missing_weights_are_exit_code_2_and_cost_no_other_run(tiny, tmp_path, capsys):
    lost = tiny_network.spec(tiny, "no weights", adversary="S1", weights="nix")
    fine = tiny_network.spec(tiny, "needs none")
    out = tmp_path / "out"
    assert main.run(["run", str(lost), str(fine), "--out", str(out), "--no-pictures"]) == 2
    assert "There are no weights 'nix'" in capsys.readouterr().out
    rows = list(csv.DictReader((out / "runs.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["failed", "ok"]
