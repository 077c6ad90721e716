"""Flaws planted in networks of others: each changes what it says, and nothing else."""

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

HERE = Path(__file__).resolve()
FOLDER = HERE.parents[2] / "studies" / "hazards"
NETS = HERE.parents[2] / "sumo_nets"
sys.path.insert(0, str(FOLDER))
import flaws  # noqa: E402
import plant as planting  # noqa: E402
import real  # noqa: E402

CASES = {
    "no_yellow": ("four_way", "four_way.sumocfg"),
    "fast_approach": ("four_way", "four_way.sumocfg"),
    "permissive_left": ("four_way", "four_way.sumocfg"),
    "no_priority": ("arterial", "arterial.sumocfg"),
}


@pytest.fixture(scope="module", params=CASES)
def planted(request, tmp_path_factory, starts_sumo):
    net, config = CASES[request.param]
    out = tmp_path_factory.mktemp("planted") / request.param
    place = planting.plant(NETS / net / config, request.param, 1, out, least=3)
    return NETS / net / config, out, place


def _net(folder):
    (file,) = folder.glob("*.net.xml")
    return ET.parse(file).getroot()


def _plain(element):
    """Tag, attributes and children, without blanks and comments."""
    children = [_plain(one) for one in element if isinstance(one.tag, str)]
    return element.tag, dict(element.attrib), children


def _differences(one, other):
    """Elements that differ by themselves, and those that only one of the trees has."""
    if len(list(one)) != len(list(other)):
        return [(one, other)]
    mine = [(one, other)] if one.attrib != other.attrib else []
    return mine + [pair for two in zip(one, other, strict=True) for pair in _differences(*two)]


def _fcd(config, out):
    program = planting.SUMO
    subprocess.run(
        [program, "-c", config, "--end", "100", "--no-step-log", "--no-warnings",
         "--fcd-output", out, "--fcd-output.attributes", "x,y,speed,lane"],
        check=True, capture_output=True,
    )  # fmt: skip
    return [_plain(step) for step in ET.parse(out).getroot()]


@pytest.mark.sumo
def test_the_sound_network_is_the_original_and_behaves_as_it(planted, tmp_path):
    original, out, place = planted
    sound = out / "sound" / original.name
    assert _plain(_net(out / "sound")) == _plain(_net(original.parent))
    assert _fcd(sound, tmp_path / "a.xml") == _fcd(original, tmp_path / "b.xml")
    assert json.loads((out / "place.json").read_text()) == place


@pytest.mark.sumo
def test_sumo_runs_the_flawed_network(planted, tmp_path):
    original, out, _ = planted
    steps = _fcd(out / "flawed" / original.name, tmp_path / "a.xml")
    assert sum(len(vehicles) for _, _, vehicles in steps) > 100


@pytest.mark.sumo
def test_only_the_network_differs_and_there_only_the_place(planted):
    _, out, place = planted
    names = sorted(one.name for one in (out / "sound").iterdir())
    assert names == sorted(one.name for one in (out / "flawed").iterdir())
    unlike = [
        name
        for name in names
        if (out / "sound" / name).read_bytes() != (out / "flawed" / name).read_bytes()
    ]
    assert [name.endswith(".net.xml") for name in unlike] == [True]
    found = _differences(_net(out / "sound"), _net(out / "flawed"))
    tags = {one.tag for one, _ in found}
    expected = {
        "no_yellow": {"tlLogic"},
        "fast_approach": {"lane"},
        "permissive_left": {"phase"},
        "no_priority": {"request", "connection", "junction"},
    }
    assert tags == expected[place["flaw"]]


@pytest.mark.sumo
def test_the_flaw_is_what_it_says(planted):
    _, out, place = planted
    net = _net(out / "flawed")
    (junction,) = [one for one in net.iter("junction") if one.get("id") == place["junction"]]
    {
        "no_yellow": _has_no_yellow,
        "fast_approach": _is_fast,
        "permissive_left": _is_permissive,
        "no_priority": _has_no_priority,
    }[place["flaw"]](net, _net(out / "sound"), junction, place)


def _cycle_s(net):
    (program,) = net.iter("tlLogic")
    return sum(float(phase.get("duration")) for phase in program)


def _has_no_yellow(net, sound, _junction, _place):
    states = [one.get("state") for one in net.iter("phase")]
    durations = [one.get("duration") for one in net.iter("phase")]
    kept = [one.get("state") for one in sound.iter("phase") if set(one.get("state")) <= {*"rGg"}]
    assert states == [one for one in kept if "G" in one]
    assert durations[:2] == ["38", "37"]  # 33 and 32 s of green, 3 of yellow, 2 of all red
    assert _cycle_s(net) == _cycle_s(sound)


def _is_fast(net, sound, junction, place):
    old = {lane.get("id"): lane for lane in sound.iter("lane")}
    for lane in net.iter("lane"):
        factor = float(lane.get("speed")) / float(old[lane.get("id")].get("speed"))
        assert factor == pytest.approx(
            1.6 if lane.get("id") in place["changed"]["lanes"] else 1.0, rel=1e-3
        )
    assert set(junction.get("incLanes").split()) <= set(place["changed"]["lanes"])


def _is_permissive(net, sound, _junction, place):
    changed = place["changed"]["signals"]
    for new, old in zip(net.iter("phase"), sound.iter("phase"), strict=True):
        for index, (now, was) in enumerate(zip(new.get("state"), old.get("state"), strict=True)):
            assert now == was or (index in changed and was == "r" and now in "gy")
    states = [one.get("state") for one in net.iter("phase")]
    assert any(one[changed[0]] == "g" for one in states)
    assert any(one[changed[0]] == "G" for one in states)


def _has_no_priority(net, sound, junction, _place):
    assert {bit for one in junction for bit in one.get("response")} == {"0"}
    (before,) = [one for one in sound.iter("junction") if one.get("id") == junction.get("id")]
    assert [one.get("foes") for one in before] == [one.get("foes") for one in junction]
    lanes = set(junction.get("incLanes").split())
    own = [c for c in net.iter("connection") if f"{c.get('from')}_{c.get('fromLane')}" in lanes]
    assert {one.get("state") for one in own} == {"M"}


@pytest.mark.sumo
def test_the_same_arguments_give_the_same_bytes(planted, tmp_path):
    original, out, place = planted
    planting.plant(original, place["flaw"], 1, tmp_path / "again", least=3)
    for file in sorted(one for one in out.rglob("*") if one.is_file()):
        assert file.read_bytes() == (tmp_path / "again" / file.relative_to(out)).read_bytes()


@pytest.mark.sumo
@pytest.mark.parametrize("flaw", ["no_priority", "permissive_left"])
def test_without_a_suitable_place_one_sentence_and_exit_code_2(flaw, tmp_path):
    config = NETS / "highway" / "highway.sumocfg"
    command = [sys.executable, FOLDER / "plant.py", config, tmp_path / "out", "--flaw", flaw]
    done = subprocess.run(
        [*command, "--least", "100000"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"has no place for {flaw}" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.sumo
def test_programs_in_additional_files_are_changed_there(tmp_path):
    """SUMO runs the programme that it read last, so that of the additional file counts."""
    source = tmp_path / "source"
    source.mkdir()
    for name in ("four_way.net.xml", "demand.rou.xml", "av.rou.xml"):
        (source / name).write_bytes((NETS / "four_way" / name).read_bytes())
    (source / "types.add.xml").write_bytes((NETS / "vehicle_types.add.xml").read_bytes())
    program = next(_net(source).iter("tlLogic"))
    program.set("programID", "other")
    (source / "lights.add.xml").write_text(
        f"<additional>{ET.tostring(program, 'unicode')}</additional>", "utf-8"
    )
    config = source / "four.sumocfg"
    config.write_text(
        '<configuration><net-file value="four_way.net.xml"/>'
        '<route-files value="demand.rou.xml,av.rou.xml"/>'
        '<additional-files value="types.add.xml,lights.add.xml"/><end value="300"/>'
        "</configuration>",
        "utf-8",
    )
    place = planting.plant(config, "no_yellow", 1, tmp_path / "out", least=3)
    assert set(place["changed"]["programs"]) == {"0", "other"}
    for tree in (
        _net(tmp_path / "out" / "flawed"),
        _parsed(tmp_path / "out/flawed/lights.add.xml"),
    ):
        assert not any(set(one.get("state")) & {*"yY"} for one in tree.iter("phase"))


def _parsed(file):
    return ET.parse(file).getroot()


def _program(*phases, **more):
    program = ET.Element("tlLogic", id="0", programID="0", **more)
    for phase in phases:
        seconds, state = phase.split(":")
        ET.SubElement(program, "phase", duration=seconds, state=state)
    return program


def _junction(states):
    """Two roads that cross at a light, one way each."""
    net = ET.Element("net")
    for name in ("a", "b"):
        edge = ET.SubElement(net, "edge", id=name)
        ET.SubElement(edge, "lane", id=f"{name}_0", speed="10", length="100")
    net.append(states)
    node = ET.SubElement(net, "junction", id="j", type="traffic_light", incLanes="a_0 b_0")
    for index, bits in enumerate(("10", "01")):
        ET.SubElement(node, "request", index=str(index), response=bits, foes=bits)
    for index, name in enumerate(("a", "b")):
        ET.SubElement(
            net, "connection", {"from": name, "to": name.upper(), "fromLane": "0"},
            tl="0", linkIndex=str(index), dir="s",
        )  # fmt: skip
    return flaws.Network(net)


def test_a_cycle_that_begins_with_yellow_keeps_its_time():
    program = _program("3:ry", "20:Gr", "3:yr", "2:rr", "30:rG")
    network = _junction(program)
    (junction,) = network.junctions
    assert set(flaws.FLAWS["no_yellow"].where(network, junction)) == {(0, 1), (1, 0)}
    flaws.FLAWS["no_yellow"].plant(network, junction, (0, 1))
    assert [(one.get("duration"), one.get("state")) for one in program] == [
        ("25", "Gr"), ("33", "rG"),
    ]  # fmt: skip
    assert program.get("offset") == "3"


@pytest.mark.parametrize(
    "program",
    [
        _program("20:Gr", "30:rG"),  # there is no yellow
        _program("3:yr", "10000:rG", "3:ry", "10000:Gr"),  # it never changes
        _program("20:Gr", "3:yr", "30:rG", "3:ry", type="NEMA"),
    ],
)
def test_lights_where_a_missing_yellow_would_show_nothing_are_no_place(program):
    network = _junction(program)
    assert not list(flaws.FLAWS["no_yellow"].where(network, network.junctions[0]))


def test_said_names_what_changed_else_how_many_attacks_would_tell():
    wait = {"quantity": "ttc_s", "state": "cannot tell", "needed": 40}
    more = {"quantity": "min_gap_m", "state": "cannot tell", "needed": 30}
    good = {"quantity": "collision_rate", "state": "better", "needed": None}
    assert real.said([wait, more]) == "cannot tell; about 30 would"
    assert real.said([wait, good]) == "better: collision_rate"
    assert real.said([]) == "cannot tell"


def test_the_table_counts_cases_and_what_has_no_place(tmp_path):
    sides = {
        f"{name}_{key}": value
        for name, rank in (("flawed", 1.0), ("sound", 11.0))
        for key, value in {
            "runs": ["a", "b"], "attacks": 40, "rank": rank, "junctions": 21, "site": rank + 1,
            "sites": 60, "screen": rank if rank == 1 else None, "screen_places": 40,
        }.items()
    }  # fmt: skip
    case = {"network": "town", "flaw": "no_yellow", "seed": 1, "junction": "j", **sides}
    unseen = {**case, "seed": 2, "flawed_rank": None, "flawed_site": None, "changes": []}
    better = {"quantity": "ttc_s", "state": "better", "needed": None}
    text = real.report(tmp_path, [{**case, "changes": [better]}, unseen], ["no place"])
    assert (
        "| town | no_yellow | 1 | j | 2 of 40 | 1 of 21 | 11 of 21 | 2 of 60 | 12 of 60 |"
        " better: ttc_s | 1 of 40 | no finding, 40 others |"
    ) in text
    assert "| town | no_yellow | 2 | j | 2 of 40 | not attacked, 21 others |" in text
    assert "2 cases: the junction is alone on rank 1 in 1, among the first 5% in 1;" in text
    assert "of it is in 1; compare says better in 1." in text
    assert "By screen, 2 cases: a finding at the junction in 2, among the first 5% in 2." in text
    assert text.endswith("No case: no place\n")
    assert (tmp_path / "table.md").read_text("utf-8") == text
