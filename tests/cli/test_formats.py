"""Results for programs and documents: --format json, csv and md."""

import csv
import io
import json

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.training import evaluation
from deepmf_sumo.training.evaluation.table import Evaluation, Figure, Key

from tests.support import gate_doubles
from tests.support.recordings_by_hand import scenario, shard
from tests.support.risk_doubles import Attacks, eastward


def told(capsys, *arguments, code=0):
    """What a command prints; nothing else may be on standard output."""
    assert main.run([str(one) for one in arguments]) == code
    return capsys.readouterr().out


def rows(text):
    return list(csv.DictReader(io.StringIO(text)))


@pytest.fixture
def attacks(tmp_path):
    runs = Attacks(tmp_path / "out")
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    return tmp_path / "out"


def test_scenes(tmp_path, capsys):
    data = shard(tmp_path / "data.tfrecord", scenario())
    [row] = json.loads(told(capsys, "data", "list", data, "--format", "json"))
    assert (row["scene"], row["status"], row["vehicles"]) == ("abc123", "ok", 2)
    [line] = rows(told(capsys, "data", "list", data, "--format", "csv"))
    assert line == {name: str(value) for name, value in row.items()}
    table = told(capsys, "data", "list", data, "--format", "md").splitlines()
    assert table[0].startswith("| file | record | scene |")
    assert len(table) == 3


def test_comparisons(attacks, tmp_path, capsys):
    both = ("compare", attacks, attacks)
    found = json.loads(told(capsys, *both, "--format", "json"))
    assert {"quantity", "a", "b", "difference", "state"} <= found[0].keys()
    lines = rows(told(capsys, *both, "--format", "csv", "--out", tmp_path / "both"))
    assert [line["quantity"] for line in lines] == [one["quantity"] for one in found]
    assert (tmp_path / "both" / "differences.csv").is_file()
    assert told(capsys, *both, "--format", "md").startswith("## deepmf-sumo compare\n")


def test_verdicts(tmp_path, capsys):
    runs = [gate_doubles.result("a", seed, hit=seed < 2) for seed in range(5)]
    out = gate_doubles.write_folder(tmp_path / "out", runs)
    file = tmp_path / "t.yaml"
    file.write_text("version: 1\nmax_av_collision_rate: 0.1\n")
    check = ("check", out, "-t", file, "--format")
    found = json.loads(told(capsys, *check, "json", code=1))
    [rate] = [one for one in found if one["quantity"] == "max_av_collision_rate"]
    assert (rate["kind"], rate["value"], rate["allowed"], rate["state"]) == (
        "threshold", 0.4, 0.1, "broken",
    )  # fmt: skip
    assert len(rows(told(capsys, *check, "csv", code=1))) == len(found)
    assert told(capsys, *check, "md", code=1).startswith("## deepmf-sumo: failed\n")


def test_figures_of_networks(tmp_path, capsys, monkeypatch):
    key = Key("marginal", "min_fde", 8.0, 6)
    found = Evaluation(
        data=["x"], weights="open", scenes=1, attacked_scenes=0, refused=0, refusals=[],
        labelled_objects=2, modes=[6], clusters="none", figures={key: Figure(4.5)},
    )  # fmt: skip
    monkeypatch.setattr(evaluation, "run", lambda *_, **__: found)
    evaluate = ("evaluate", tmp_path, "--format")
    assert Evaluation.from_record(json.loads(told(capsys, *evaluate, "json"))) == found
    [line] = rows(told(capsys, *evaluate, "csv"))
    assert (line["network"], line["quantity"], line["modes"], line["value"]) == (
        "marginal", "min_fde", "6", "4.5",
    )  # fmt: skip
    assert "| marginal | min_fde | 8 | 6 |" in told(capsys, *evaluate, "md")


@pytest.mark.sumo
def test_results(tiny, tmp_path, capsys):
    from tests.support import tiny_network

    out = tmp_path / "out"
    path = tiny_network.spec(tiny, "shown")
    told(capsys, "run", path, "--out", out, "--no-pictures")
    [row] = json.loads(told(capsys, "show", out, "--format", "json"))
    assert (row["spec"], row["runs"], row["hits"]) == ("shown", 1, 0)
    [line] = rows(told(capsys, "show", out, "--format", "csv"))
    assert line["spec"] == "shown"
    assert told(capsys, "show", out, "--format", "md").splitlines()[0].startswith("| folder | spec")
