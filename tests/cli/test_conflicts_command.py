"""``deepmf-sumo conflicts``: a .sumocfg -> its conflicts and their places."""

import csv
import json
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import sumo

from deepmf_sumo.cli import main
from deepmf_sumo.roadcheck.conflict_places import LISTED, place_columns

from tests.support.foreign_readers import read_trj
from tests.support.risk_doubles import Attacks, eastward

ROUNDABOUT = Path(__file__).resolve().parents[2] / "sumo_nets" / "roundabout" / "roundabout.sumocfg"
FOUR_WAY = ROUNDABOUT.parents[1] / "four_way" / "four_way.sumocfg"


def run(*arguments):
    return main.run(["conflicts", *map(str, arguments)])


def refused(capsys, *arguments, code=2):
    assert run(*arguments) == code
    return capsys.readouterr().err.strip().splitlines()[-1]


def rows(file):
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def test_conflicts_and_places_are_written_and_shown(tmp_path, capsys):
    asked = ROUNDABOUT, "--until", 170, "--from", 100
    assert run(*asked, "--out", tmp_path / "a") == 0
    told = capsys.readouterr().out
    assert "from 100 to 170 s (the traffic goes on): 2 conflicts (0 rear end, 0 lane" in told
    assert "not counted: " in told
    assert "e_enter: from south to north-west (straight, priority)" in told
    found = rows(tmp_path / "a" / "conflicts.csv")
    assert tuple(found[0]) == LISTED
    assert [one["type"] for one in found] == ["crossing", "crossing"]
    assert {one["gives_way"] for one in found} == {"second"}, "those that enter"
    assert all(100 <= float(one["begin_s"]) <= 170 for one in found)
    places = rows(tmp_path / "a" / "places.csv")
    assert tuple(places[0]) == place_columns(beside=False)
    about = json.loads((tmp_path / "a" / "conflicts.json").read_text())
    assert (about["seed"], about["conflicts"], about["until_s"]) == (42, 2, 170.0)

    assert run(*asked, "--out", tmp_path / "b", "--format", "csv") == 0
    told = capsys.readouterr().out
    assert told == (tmp_path / "a" / "conflicts.csv").read_text()
    for name in ("conflicts.csv", "places.csv", "conflicts.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.sumo
def test_the_traffic_as_trajectories_is_where_sumo_s_own_output_has_it(tmp_path, capsys):
    """Read by the format's description, against SUMO's FCD of the same seed."""
    fcd = tmp_path / "fcd.xml"
    asked = ROUNDABOUT, "--until", 60, "--from", 40, "--out", tmp_path / "a", "--trj"
    subprocess.run(
        [f"{sumo.SUMO_HOME}/bin/sumo", "-c", ROUNDABOUT, "--step-length", "0.1", "--end", "60.05",
         "--fcd-output", fcd, "--precision", "6", "--no-step-log", "--no-warnings"],
        check=True, capture_output=True,
    )  # fmt: skip
    assert run(*asked) == 0
    assert "conflicts.json, traffic.trj, road_users.csv" in capsys.readouterr().out
    ids = {int(row["number"]): row for row in rows(tmp_path / "a" / "road_users.csv")}
    _, steps = read_trj((tmp_path / "a" / "traffic.trj").read_bytes())
    assert len(steps) == 201
    seen, speeds = 0, {}
    for moment in ET.parse(fcd).getroot():
        # SUMO writes the state at the end of a step with the time of its begin
        step = round((float(moment.get("time")) + 0.1 - 40.0) / 0.1)
        if not 0 <= step <= 200:
            continue
        found = {ids[one.number]["id"]: one for one in steps[step][1]}
        assert set(found) == {one.get("id") for one in moment}
        for one in moment:
            there = found[one.get("id")]
            assert there.front == pytest.approx(
                (float(one.get("x")), float(one.get("y"))), abs=2e-3
            )
            assert there.length == pytest.approx(float(ids[there.number]["length_m"]), abs=1e-3)
            assert np.hypot(*np.subtract(there.front, there.rear)) == pytest.approx(
                there.length, abs=1e-3
            )
            before = speeds.get((there.number, step - 1))
            if before is not None:
                assert there.acceleration == pytest.approx((there.speed - before) / 0.1, abs=1e-3)
            speeds[there.number, step] = there.speed
            seen += 1
    assert seen > 500


def test_a_folder_that_cannot_be_written_is_told_before_the_simulation(monkeypatch, capsys):
    monkeypatch.setattr("deepmf_sumo.roadcheck.conflicts.observe", None)
    asked = ROUNDABOUT, "--until", 5, "--out", "/proc/self/task/conflicts"
    assert "/proc/self/task/conflicts cannot be written: " in refused(capsys, *asked)


def test_tables_are_replaced_only_when_told(tmp_path, capsys):
    (tmp_path / "conflicts.csv").write_text("mine")
    asked = ROUNDABOUT, "--until", 5, "--out", tmp_path
    assert "conflicts.csv is there already: give --overwrite" in refused(capsys, *asked)
    assert (tmp_path / "conflicts.csv").read_text() == "mine"
    assert run(*asked, "--overwrite") == 0
    assert (tmp_path / "conflicts.csv").read_text() == ",".join(LISTED) + "\n"
    assert "0 conflicts" in capsys.readouterr().out


def test_attacks_beside(tmp_path, capsys):
    runs = Attacks(tmp_path / "results")
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    beside = "--beside", tmp_path / "results"
    assert run(FOUR_WAY, "--until", 70, "--out", tmp_path / "out", *beside) == 0
    told = capsys.readouterr().out
    assert "risk of a hit" in told
    [place, *_] = rows(tmp_path / "out" / "places.csv")
    assert (place["place"], place["attacks"], place["hits"]) == ("w_in", "1", "1")
    assert tuple(place) == place_columns(beside=True)
    line = refused(capsys, ROUNDABOUT, "--out", tmp_path / "other", *beside)
    assert "its attacks are on another network (four_way)" in line
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--from", 50, "--until", 20), "--until 20: must be later than the beginning at 50 s"),
        (("--until", 0), "--until 0: must be later than the beginning at 0 s"),
        (("--from", 400), "--from 400: roundabout.sumocfg ends at 300 s; choose an earlier time"),
        (("--set", "ttc_s=.nan"), "key 'ttc_s'"),
        (("--", "--step-length", "1"), "--step-length cannot be given"),
    ],
)
def test_wrong_options_are_one_sentence(options, told, tmp_path, capsys):
    assert told in refused(capsys, ROUNDABOUT, "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_wrong_files_are_one_sentence(tiny, tmp_path, capsys):
    out = "--out", tmp_path / "out"
    assert "does not exist" in refused(capsys, tmp_path / "none.sumocfg", *out)
    net = tiny / "tiny.net.xml"

    def config(name, net, more=""):
        file = tmp_path / f"{name}.sumocfg"
        inputs = f'<net-file value="{net}"/>{more}'
        file.write_text(f"<configuration><input>{inputs}</input></configuration>")
        return file

    empty = config("empty", net)
    assert "no vehicle drove in" in refused(capsys, empty, "--until", 5, *out, code=3)
    missing = config("missing", tmp_path / "gone.net.xml")
    assert "gone.net.xml', which does not exist" in refused(capsys, missing, *out, code=3)
    (tmp_path / "bare.net.xml").write_text("<net version='1.20'></net>")
    bare = config("bare", tmp_path / "bare.net.xml")
    assert refused(capsys, bare, "--until", 5, *out, code=3).startswith("deepmf-sumo: ")
    (tmp_path / "none.rou.xml").write_text(
        '<routes><vehicle id="a" depart="0" route="x"/></routes>'
    )
    wrong = config("wrong", net, f'<route-files value="{tmp_path / "none.rou.xml"}"/>')
    assert "SUMO refused" in refused(capsys, wrong, *out, code=3)
    assert not (tmp_path / "out").exists()


def test_a_road_without_junctions(tiny, tmp_path, capsys):
    assert run(tiny / "tiny.sumocfg", "--out", tmp_path / "out") == 0
    assert "2 road users from 0 to" in capsys.readouterr().out
