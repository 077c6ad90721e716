"""Changed networks: read by sumolib, built again by netconvert from the patch, and run by SUMO."""

import importlib.util
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import sumolib

from deepmf_sumo.cli import main
from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.roadcheck.countermeasures import building, document
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

pytestmark = pytest.mark.sumo
ROOT = Path(__file__).resolve().parents[3]

CHANGES = """version: 1
changes:
  - {signal: signal6, yellow_s: 3, all_red_s: 2}
  - {signal: left1, protected_left_s: 8, yellow_s: 5}
  - {edge: stop8_west_in, limit_kmh: 50}
"""
REBUILT = """version: 1
changes:
  - {edge: merge3_lane, ending_lane_m: 90}
  - {junction: stop8_mid, control: priority_stop}
"""


PLACES = ("merge3", "signal5", "signal6", "left1", "stop1", "stop8")


@pytest.fixture(scope="module")
def hazards(tmp_path_factory, starts_sumo):
    """Those of the forty places that the tests change or try to."""
    file = ROOT / "studies" / "hazards" / "build.py"
    spec = importlib.util.spec_from_file_location("hazards_to_change", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    some = [place for place in module.places() if place.name in PLACES]
    module.places = lambda: some
    return module.build(tmp_path_factory.mktemp("hazards"))


@pytest.fixture(scope="module")
def changed(hazards, tmp_path_factory):
    """The network with CHANGES."""
    return built(hazards, CHANGES, tmp_path_factory.mktemp("changed"))


def built(config, text, folder):
    file = folder / "changes.yaml"
    file.write_text(text)
    return building.build(config, document.load(file), folder / "out")


def net(config, **more):
    return sumolib.net.readNet(str(read_configuration(config).net), **more)


def lengths(config):
    return {edge.getID(): edge.getLength() for edge in net(config).getEdges()}


def cycle(file, name):
    [program] = [one for one in ET.parse(file).iter("tlLogic") if one.get("id") == name]
    return " ".join(f"{float(one.get('duration')):g}:{one.get('state')}" for one in program)


def runs_in_sumo(config):
    command = [sumo_tools.program("sumo"), "-c", config, "--no-step-log", "--end", "3"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    return done.returncode == 0


def test_programs_and_limits_change_and_nothing_else(hazards, changed):
    assert changed.before == hazards
    after = read_configuration(changed.after).net
    assert cycle(after, "signal6") == "10:GGrr 3:yyrr 2:rrrr 10:rrGG 3:rryy 2:rrrr"
    assert cycle(after, "left1") == "10:GGr 5:yyr 2:rrr 8:rrG 5:rry 2:rrr"
    limited = net(changed.after).getEdge("stop8_west_in")
    assert limited.getSpeed() == pytest.approx(50 / 3.6, abs=0.01)
    old, new = (elements(read_configuration(one).net) for one in (hazards, changed.after))
    assert {one for one in old ^ new if one[0] != "phase"} == {
        one for one in old ^ new if ("id", "stop8_west_in_0") in one[1]
    }
    assert len(old - new) < 10
    assert changed.junctions == ("left1_mid", "signal6_mid")
    assert changed.edges == ("stop8_west_in",)
    assert runs_in_sumo(changed.after)


ADDITIONAL = """<additional>
  <include href="speeds.add.xml"/>
  <tlLogic id="signal6" type="static" programID="other" offset="0">{phases}</tlLogic>
  <inductionLoop id="d" lane="stop8_west_in_0" pos="5" period="1" file="loops.xml"/>
</additional>"""
SPEEDS = """<additional>
  <variableSpeedSign id="v" lanes="stop8_west_in_0"><step time="0" speed="7"/></variableSpeedSign>
</additional>"""


def test_files_to_be_read_are_found_and_files_to_be_written_stay_beside(hazards, tmp_path):
    own = tmp_path / "own"
    own.mkdir()
    given = read_configuration(hazards).net
    [program] = [one for one in ET.parse(given).iter("tlLogic") if one.get("id") == "signal6"]
    phases = "".join(ET.tostring(one, "unicode") for one in program)
    (own / "more.add.xml").write_text(ADDITIONAL.format(phases=phases))
    (own / "speeds.add.xml").write_text(SPEEDS)
    (own / "loops.xml").write_text("of an earlier run")
    config = own / "c.sumocfg"
    config.write_text(
        f'<configuration><net-file value="{given}"/><additional-files value="more.add.xml"/>'
        "</configuration>"
    )
    found = built(config, CHANGES, tmp_path)
    assert runs_in_sumo(found.after)
    assert (own / "loops.xml").read_text() == "of an earlier run"
    assert (found.after.parent / "loops.xml").read_text().count("<interval") > 0
    [included] = ET.parse(found.after.parent / "more.add.xml").iter("include")
    assert Path(included.get("href")) == own / "speeds.add.xml"


def elements(file):
    """Tags and attributes of all that is in a file."""
    return {(one.tag, tuple(sorted(one.attrib.items()))) for one in ET.parse(file).iter()}


def test_netconvert_makes_the_same_of_the_patch(hazards, changed, tmp_path):
    patches = ["-i", changed.patch / "patch.tll.xml", "-e", changed.patch / "patch.edg.xml"]
    patched = tmp_path / "patched.net.xml"
    given = read_configuration(hazards).net
    sumo_tools.run("netconvert", "-s", str(given), *map(str, patches), "-o", str(patched))
    after = read_configuration(changed.after).net
    for name in ("signal6", "left1", "signal5"):
        assert cycle(patched, name) == cycle(after, name)
    speeds = [
        sumolib.net.readNet(str(one)).getEdge("stop8_west_in").getSpeed()
        for one in (patched, after)
    ]
    assert speeds[0] == speeds[1]


def test_lengths_and_right_of_way_are_built_by_netconvert(hazards, tmp_path):
    found = built(hazards, REBUILT, tmp_path)
    assert found.before != hazards
    before = lengths(found.before)
    assert before == lengths(hazards)
    changed = {
        name: length for name, length in lengths(found.after).items()
        if abs(length - before[name]) > 0.05
    }  # fmt: skip
    assert changed.keys() == {"merge3_lane", "merge3_out"}
    assert changed["merge3_lane"] == pytest.approx(90, abs=1)
    types = [net(one).getNode("stop8_mid").getType() for one in (found.before, found.after)]
    assert types == ["unregulated", "priority_stop"]
    assert found.edges == ("merge3_in", "merge3_lane", "merge3_ramp")
    assert runs_in_sumo(found.before)
    assert runs_in_sumo(found.after)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("{signal: signal66, yellow_s: 3}", "no signal 'signal66' is in .*mean 'signal6"),
        ("{edge: nowhere, limit_kmh: 50}", "no edge 'nowhere'"),
        ("{edge: merge3_lane, ending_lane_m: 300}", "must be above its length .* at most 95.5 m"),
        ("{edge: merge3_in, ending_lane_m: 200}", "leads into one other edge with fewer lanes"),
        ("{signal: signal6, yellow_s: 12}", "would leave 3 s"),
        ("{signal: signal5, yellow_s: 1}", "nothing changes: .*stays as it is.*ask for more"),
        ("{junction: stop1_mid, control: priority_stop}", "nothing changes: junction"),
    ],
)
def test_changes_that_cannot_be_made_are_one_sentence(hazards, tmp_path, change, told):
    with pytest.raises(UsageError, match=told):
        built(hazards, f"version: 1\nchanges: [{change}]\n", tmp_path)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("version: 1\nchanges: []\n", "changes"),
        ("version: 1\nchanges: [{yellow_s: 3}]\n", "must name one of signal, edge and junction"),
        ("version: 1\nchanges: [{signal: a, limit_kmh: 5}]\n", "'limit_kmh' does not go with"),
        ("version: 1\nchanges: [{signal: a}]\n", "needs one of yellow_s"),
        ("version: 1\nchanges: [{signal: a, yelow_s: 3}]\n", "yelow_s.*mean 'yellow_s'"),
        ("version: 1\nchanges: [{edge: a, limit_kmh: 5, limit_mps: 2}]\n", "limit_mps or as"),
        ("version: 1\nchanges: [{junction: a, control: police}]\n", "control"),
    ],
)
def test_files_that_are_wrong_are_refused(tmp_path, text, told):
    file = tmp_path / "changes.yaml"
    file.write_text(text)
    with pytest.raises(SpecError, match=told):
        document.load(file)


def test_both_sides_are_attacked_at_moments_of_both(tiny, tmp_path, capsys):
    file = tmp_path / "slower.yaml"
    file.write_text("version: 1\nchanges: [{edge: ab, limit_mps: 13.5}]\n")
    arguments = ["try", tiny / "tiny.sumocfg", "--change", file, "-n", 2, "--set", "duration_s=1"]
    arguments += ["--set", "source.moments.prefer=both"]  # of the moments that a side chooses
    arguments += ["--no-pictures", "--set", "adversary=none", "--out", tmp_path / "out"]
    arguments = list(map(str, arguments))
    assert main.run([*arguments, "-n", "1"]) == 2
    assert "--moments 1: it takes two" in capsys.readouterr().err
    assert main.run([*arguments, "--set", "sweep.max_minutes=0.0001"]) == 130
    assert not (tmp_path / "out" / "compared").exists()
    assert main.run([*arguments, "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert "edge 'ab': the limit of 13.90 m/s becomes 13.50 m/s" in said
    for side in ("before", "after"):
        for of in ("before", "after"):
            assert (tmp_path / "out" / side / f"at-{of}" / "runs.csv").is_file()
    assert "2 pairs of the same moment and seed" in said
    assert (tmp_path / "out" / "compared" / "comparison.md").is_file()
    assert main.run(arguments) == 2
    assert "has results of an earlier try" in capsys.readouterr().err
