"""``deepmf-sumo screen``: a network -> findings, files and exit codes."""

import csv
import gzip
import json
from pathlib import Path

import pytest

from deepmf_sumo.cli import main, screen
from deepmf_sumo.roadcheck.screening import BESIDE, COLUMNS, GUIDELINES

from tests.support.risk_doubles import Attacks, eastward

NETS = Path(__file__).resolve().parents[2] / "sumo_nets"
FOUR_WAY = NETS / "four_way" / "four_way.net.xml"
RURAL = NETS / "rural" / "rural.net.xml"


def run(*arguments):
    return main.run(["screen", *map(str, arguments)])


def refused(capsys, *arguments):
    assert run(*arguments) == 2
    told = capsys.readouterr()
    assert told.out == ""
    return told.err.strip().splitlines()[-1]


def test_findings_are_shown_the_worst_first(capsys):
    assert run(NETS / "arterial" / "arterial.net.xml") == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("arterial.net.xml, by RiLSA 2010: 1 error, 1 warning (")
    assert told[2].startswith("error     intergreen")
    assert any(line.startswith("warning   permissive_left") for line in told)
    assert any(line.startswith("not judged: 8 x intergreen of foes") for line in told)


def test_a_configuration_and_a_packed_network_are_the_same(tmp_path, capsys):
    packed = tmp_path / "a.net.xml.gz"
    packed.write_bytes(gzip.compress(FOUR_WAY.read_bytes()))
    texts = []
    for file in (FOUR_WAY, FOUR_WAY.with_name("four_way.sumocfg"), packed, FOUR_WAY):
        assert run(file, "--format", "csv") == 0
        texts.append(capsys.readouterr().out)
    assert len(set(texts)) == 1


def test_formats_and_the_file(tmp_path, capsys):
    assert run(FOUR_WAY, "--out", tmp_path / "out", "--format", "json") == 0
    told = capsys.readouterr()
    rows = json.loads(told.out)
    assert tuple(rows[0]) == COLUMNS
    assert "deepmf-sumo: not judged: 16 x intergreen of foes" in told.err
    with (tmp_path / "out" / "screen.csv").open(newline="") as file:
        written = list(csv.DictReader(file))
    assert [row["finding"] for row in written] == [row["finding"] for row in rows]
    assert written[0]["edges"] == " ".join(sorted(written[0]["edges"].split()))
    assert "is there already: give --overwrite" in refused(
        capsys, FOUR_WAY, "--out", tmp_path / "out"
    )
    assert run(FOUR_WAY, "--out", tmp_path / "out", "--overwrite", "--format", "md") == 0
    assert capsys.readouterr().out.startswith("| severity | rule | junction |")


def test_a_network_without_findings(capsys, tmp_path):
    assert run(RURAL, "--fail-on", "warning", "--out", tmp_path) == 0
    assert "0 errors, 0 warnings" in capsys.readouterr().out
    assert (tmp_path / "screen.csv").read_text() == ",".join(COLUMNS) + "\n"


def test_exit_codes_for_continuous_integration(capsys):
    assert run(FOUR_WAY) == 0, "only told"
    assert run(FOUR_WAY, "--fail-on", "error") == 0, "warnings alone"
    assert run(FOUR_WAY, "--fail-on", "warning") == 1
    assert run(NETS / "arterial" / "arterial.net.xml", "--fail-on", "error") == 1
    capsys.readouterr()


def test_attacks_beside(tmp_path, capsys):
    runs = Attacks(tmp_path / "results")
    runs.add("a", av=eastward(x=-5.0), opponent=eastward(x=-15.0), hit=80)
    beside = "--beside", tmp_path / "results"
    assert run(FOUR_WAY, "--out", tmp_path / "out", *beside) == 0
    assert "risk of a hit" in capsys.readouterr().out
    with (tmp_path / "out" / "screen.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == (*COLUMNS, *BESIDE)
    assert {row["junction"] for row in rows} == {"centre"}
    assert {row["hits"] for row in rows} <= {"0", "1"}
    assert "its attacks are on another network" in refused(capsys, RURAL, *beside)


BAD = {
    "empty": ("", "cannot be read as XML"),
    "text": ("hello", "cannot be read as XML"),
    "encoding": ('<?xml version="1.0" encoding="foo"?><net/>', "unknown encoding: foo"),
    "other": ("<routes/>", "contains <routes>: it is neither a network of SUMO nor a .sumocfg"),
    "bare": ("<net/>", "has no <junction>: there is nothing to screen"),
    "cut": ('<net><junction id="a" type="priority"/><edge id="e"', "cannot be read as a SUMO net"),
    "number": (
        (
            '<net><junction id="a"/><edge id="e" from="a" to="a"><lane id="e_0" speed="fast"'
            ' shape="0,0 1,1"/></edge></net>'
        ),
        "speed of <lane> 'e_0' is 'fast', not a number",
    ),
    "shapeless": (
        '<net><junction id="a"/><edge id="e" from="a" to="a"><lane id="e_0"/></edge></net>',
        "the lane 'e_0' has no shape",
    ),
    "laneless": ('<net><junction id="a"/><edge id="e" from="a" to="a"/></net>', "has no <lane>"),
    "nowhere": (
        (
            '<net><junction id="a"/><edge id="e" from="a" to="b"><lane id="e_0" shape="0,0 1,1"/>'
            "</edge></net>"
        ),
        "the edge 'e' is from 'a' to 'b', which are not both junctions",
    ),
    "dangling": (
        (
            '<net><junction id="a"/><edge id="e" from="a" to="a"><lane id="e_0" shape="0,0 1,1"/>'
            '</edge><connection from="e" to="f" fromLane="0" toLane="0"/></net>'
        ),
        "a <connection> names the lane 'f_0'",
    ),
    "phase": (
        '<net><junction id="a"/><tlLogic id="l"><phase state="G" duration="x"/></tlLogic></net>',
        "has a wrong <tlLogic>: duration of <phase>",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_network_is_refused_in_one_sentence(name, tmp_path, capsys):
    text, said = BAD[name]
    file = tmp_path / f"{name}.net.xml"
    file.write_text(text)
    line = refused(capsys, file, "--out", tmp_path / "out")
    assert said in line
    assert line.startswith("deepmf-sumo: ")
    assert not (tmp_path / "out").exists()


def test_the_guidelines_are_those_of_the_command():
    (option,) = [one for one in screen.command.params if one.name == "guideline"]
    assert list(option.type.choices) == list(GUIDELINES)


def test_a_wrong_guideline_and_a_missing_network(tmp_path, capsys):
    assert "'rlsa' is not one of 'rilsa', 'ite'" in refused(capsys, FOUR_WAY, "--guideline", "rlsa")
    config = tmp_path / "a.sumocfg"
    config.write_text('<configuration><input><net-file value="b.net.xml"/></input></configuration>')
    assert "b.net.xml', which does not exist" in refused(capsys, config)
    assert "does not exist" in refused(capsys, tmp_path / "none.net.xml")
