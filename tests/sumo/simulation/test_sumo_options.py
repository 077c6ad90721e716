"""A configuration means what SUMO takes it for: each spelling is given to SUMO itself, too."""

import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import sumo

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.roadcheck.countermeasures.building import build as changed
from deepmf_sumo.roadcheck.countermeasures.document import Change
from deepmf_sumo.sumo.simulation import sumo_options
from deepmf_sumo.sumo.simulation.files_read import files_read
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

from tests.support.tiny_network import build

SUMO = Path(sumo.SUMO_HOME) / "bin" / "sumo"
NET, ROUTES = "a b.net.xml", "r.rou.xml"
SPELLINGS = {
    "encoded": '<net-file value="a%20b.net.xml"/><route-files value="r%2Erou.xml"/>',
    "plain": '<net-file value="a b.net.xml"/><route-files value="r.rou.xml"/>',
    "short names": '<n value="a b.net.xml"/><r value="r.rou.xml"/>',
    "synonyms": '<net value="a b.net.xml"/><routes value="r.rou.xml"/>',
    "v": '<input><net-file v="a b.net.xml"/><route-files v="r.rou.xml"/></input>',
    "text": "<net-file>a b.net.xml</net-file><route-files>r.rou.xml</route-files>",
    "deep": '<x><y><net-file value="a b.net.xml"/><route-files value="r.rou.xml"/></y></x>',
    "spaces": '<net-file value=" a b.net.xml "/><route-files value=" r.rou.xml "/>',
    "variable": '<net-file value="${HERE}/a%20b.net.xml"/><route-files value="r${NOT}.rou.xml"/>',
    "home": '<net-file value="~/a b.net.xml"/><route-files value="~/r.rou.xml"/>',
    "a dollar": '<net-file value="$HERE.net.xml"/><route-files value="r.rou.xml"/>',
    "percent": '<net-file value="c%25.net.xml"/><route-files value="r.rou.xml"/>',
}
_OPTION = re.compile(r'<([\w.-]+) value="[^"]*"(?: synonymes="([^"]*)")?.*? type="([A-Z\[\]]+)"')
NETS = {"a dollar": "$HERE.net.xml", "percent": "c%.net.xml"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    build(tmp_path)
    for net in (NET, *NETS.values()):
        shutil.copy(tmp_path / "tiny.net.xml", tmp_path / net)
    shutil.copy(tmp_path / "tiny.rou.xml", tmp_path / ROUTES)
    monkeypatch.setenv("HERE", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("NOT", raising=False)
    return tmp_path


def written(folder, body):
    config = folder / "x.sumocfg"
    config.write_text(f"<configuration>{body}</configuration>")
    return config


def loaded(config, *options):
    """What SUMO opened, by its own words; None if it refused."""
    command = [str(SUMO), "-c", config.name, *options, "-v", "--no-step-log"]
    done = subprocess.run(command, cwd=config.parent, capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else None


@pytest.mark.sumo
@pytest.mark.parametrize("spelling", SPELLINGS)
def test_sumo_and_we_read_the_same(spelling, folder):
    config = written(folder, SPELLINGS[spelling] + '<end value="0:00:02"/>')
    said = loaded(config)
    assert said is not None
    assert "ended at time: 2.00" in said
    found = read_configuration(config)
    assert found.net == folder / NETS.get(spelling, NET)
    assert found.routes == (folder / ROUTES,)
    assert found.end_s == 2.0
    assert set(files_read(config, {})) == {config, found.net, folder / ROUTES}


@pytest.mark.sumo
@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1:00:00", 3600), ("1:0:0:5", 86405), ("1e1", 10), ("3.", 3), ("9:9:1:0:0:5", None),
     ("2:5", None), ("0.5h", None), ("nan", None)],
)  # fmt: skip
def test_times_are_those_of_sumo(text, seconds, folder):
    config = written(folder, f'<net-file value="tiny.net.xml"/><begin value="{text}"/>')
    said = loaded(config, "--end", "86406")
    if seconds is None:
        assert said is None
        with pytest.raises(SimulationError, match=f"has begin '{text}', which is not a time"):
            read_configuration(config)
    else:
        assert f"started with time: {seconds}.00" in said
        assert read_configuration(config).begin_s == seconds


@pytest.mark.sumo
def test_names_of_options_are_those_of_sumo(tmp_path):
    """By SUMO's own list of its options with their synonyms and kinds."""
    template = tmp_path / "all.xml"
    command = [str(SUMO), "--save-template", str(template), "--save-commented"]
    subprocess.run(command, check=True, capture_output=True)
    writes = {"save-template", "save-schema", "log", "message-log"}
    writes |= {"error-log", "save-configuration", "netstate-dump", "save-state.prefix"}
    writes |= {"pedestrian.jupedsim.wkt", "pedestrian.jupedsim.py"}
    listed = _OPTION.findall(template.read_text("utf-8"))  # the file is not well-formed XML
    assert len(listed) > 300
    for option, synonyms, kind in listed:
        if kind == "FILE" and "output" not in option:
            reads = sumo_options.names_files(option)
            assert reads != (option in writes | {"save-state.files"}), option
        names = set(synonyms.split())
        known = {name for name in names if sumo_options.long_name(name) == option}
        if sumo_options.names_files(option) and not option.startswith(("gui", "alt")):
            assert known == names, option  # each of its names is understood
        else:
            assert not {name for name in names if sumo_options.long_name(name) != name} - known


def test_a_comma_in_a_folder_is_refused_with_what_to_do(tmp_path):
    folder = tmp_path / "Nr 5, 6"
    folder.mkdir()
    with pytest.raises(SimulationError, match=r"has a comma in its path.*rename the folder"):
        read_configuration(build(folder))


@pytest.mark.sumo
def test_a_changed_configuration_is_read_by_sumo(folder):
    """`try` writes the same files under absolute names, in a folder with a percent sign."""
    config = written(folder, SPELLINGS["text"] + '<end value="2"/>')
    edge = next(one.get("id") for one in ET.parse(folder / NET).iter("edge") if one.get("from"))
    out = folder / "100%25 more"
    after = changed(config, [Change(edge=edge, limit_mps=3.0)], out).after
    assert loaded(after) is not None
    assert read_configuration(after).routes == (folder / ROUTES,)
    assert read_configuration(after).net.parent.samefile(after.parent)


@pytest.mark.parametrize(
    ("text", "what"),
    [("<net>" + "<edge/>" * 9, "<net>, which is a network"), ("<routes/>", "which is demand")],
)
def test_a_network_in_place_of_a_configuration_is_refused_with_what_to_write(tmp_path, text, what):
    file = tmp_path / "my.net.xml"
    file.write_text(text)  # the rest is not read: a network may be large
    with pytest.raises(SimulationError, match=rf"contains .*{what}; name a \.sumocfg"):
        read_configuration(file)
