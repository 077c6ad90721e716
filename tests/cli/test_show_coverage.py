"""``deepmf-sumo show --coverage``: four tables of evidence, as text and as data."""

import json

import pytest

from deepmf_sumo.cli import main

from tests.support.risk_doubles import Attacks, eastward


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A hit from behind and a miss on the four-way network."""
    out = Attacks(tmp_path_factory.mktemp("covered") / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-144.0), hit=30)
    out.add("b", av=eastward(), opponent=eastward(x=-160.0))
    return out.out


def test_the_tables_say_what_was_attacked_and_why_something_was_not(made, capsys):
    assert main.run(["show", str(made), "--coverage"]) == 0
    said = capsys.readouterr().out
    lines = {line.split("  ")[0].strip(): line for line in said.splitlines()}
    assert said.startswith("four_way: 2 attacks")
    assert lines["rear-end"].split()[1:3] == ["2", "1"]
    assert "never: SUMO has none" in lines["weather: rain, snow, fog"]
    assert "no such place in the network" in lines["junction: roundabout"]
    assert "rows do not add up" in said
    for word in ("compliant", "score", "coverage of"):
        assert word not in said.lower()


def test_the_cells_are_data(made, capsys):
    assert main.run(["show", str(made), "--coverage", "--format", "json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    [row] = [one for one in rows if one["name"] == "rear-end"]
    assert (row["table"], row["attacks"], row["hits"], row["reason"]) == ("conflict", 2, 1, "")
    assert row["hit_rate"] == 0.5
    assert row["hit_rate_lo"] < 0.5 < row["hit_rate_hi"]


@pytest.mark.parametrize("more", [["--failures"], ["--all"]])
def test_it_goes_alone(made, more, capsys):
    assert main.run(["show", str(made), "--coverage", *more]) == 2
    assert "goes without" in capsys.readouterr().err
