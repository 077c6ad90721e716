"""The files that SUMO reads, against what the operating system says that it opens."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import sumo

from deepmf_sumo.sumo.simulation import sumo_options
from deepmf_sumo.sumo.simulation.files_read import SHOWN, files_read, is_read

SUMO = Path(sumo.SUMO_HOME) / "bin" / "sumo"
CONFIG = """<configuration>
  <net-file v="tiny.net.xml"/>
  <input><r>tiny.rou.xml</r><additional value="a.add.xml, ${KIND}.add.xml"/></input>
  <weights value="w.xml"/>
  <device.fcd-replay.file value="replay.xml"/>
  <tripinfo value="trips.xml"/>
  <log-file value="sumo.log"/>
  <device.ssm.file value="ssm.xml"/>
  <device.toc.file value="toc.xml"/>
  <gui-settings-file value="view.xml"/>
  <end value="2"/>
</configuration>"""
FILES = {
    "a.add.xml": '<additional><include href="sub/inc.add.xml"/></additional>',
    "sub/inc.add.xml": """<additional>
        <variableSpeedSign id="v" lanes="ab_0" file='vss.xml'/></additional>""",
    "sub/vss.xml": "<additional/>",
    "b.add.xml": """<additional>
        <calibrator id="c" edge="ab" pos="0" file="cal.xml" output="calibrated.xml"/>
        <inductionLoop id="i" lane="ab_0" pos="1" period="10" file="loop.xml"/></additional>""",
    "cal.xml": "<additional/>",
    "w.xml": "<meandata/>",
    "replay.xml": "<fcd-export/>",
    "view.xml": "<viewsettings/>",
    "loop.xml": "of an earlier run",
    "trips.xml": "of an earlier run",
    "sumo.log": "of an earlier run",
    "ssm.xml": "of an earlier run",
    "toc.xml": "of an earlier run",
    "beside.xml": "<additional/>",
}


@pytest.fixture
def folder(tiny, tmp_path, monkeypatch):
    monkeypatch.setenv("KIND", "b")
    made = Path(shutil.copytree(tiny, tmp_path / "made"))
    (made / "sub").mkdir()
    for name, text in {**FILES, "tiny.sumocfg": CONFIG}.items():
        (made / name).write_text(text)
    return made


@pytest.mark.sumo
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_what_sumo_opens_is_what_it_is_said_to_read(folder):
    told = {path.resolve() for path in files_read(folder / "tiny.sumocfg", {})}
    environment = {**os.environ, "SUMO_HOME": sumo.SUMO_HOME}
    command = ["strace", "-f", "-o", "calls", "-e", "trace=open,openat"]
    subprocess.run(
        [*command, SUMO, "-c", "tiny.sumocfg"], cwd=folder, check=True, env=environment,
        capture_output=True,
    )  # fmt: skip
    calls = (folder / "calls").read_text()
    opened = re.findall(r'"([^"]+)", O_RDONLY[^=]*= \d', calls)
    ours = {(folder / name).resolve() for name in opened}
    assert {path for path in ours if folder in path.parents} == told


def test_what_sumo_writes_and_what_is_shown_is_not_read():
    written = {"log-file", "save-state.files", "tripinfo-output", "fcd-output", "netstate-dump"}
    assert not any(map(is_read, written | SHOWN))
    assert all(map(is_read, ("net-file", "load-state", "phemlight-path", "weight-files")))
    assert all(map(sumo_options.names_files, SHOWN))


def test_options_beside_it_replace_its_own(folder):
    beside = {"additional-files": str(folder / "beside.xml"), "fcd-output": str(folder / "cal.xml")}
    names = {path.name for path in files_read(folder / "tiny.sumocfg", beside)}
    assert "beside.xml" in names
    assert names.isdisjoint({"a.add.xml", "inc.add.xml", "cal.xml"})


def test_a_name_across_two_pieces_of_a_large_file_is_found(folder):
    filler = f"<!-- {'x' * 2**20} -->"
    for cut in (1, 5, 20, 40):
        text = f'{filler[:-cut]}--><include href="cal.xml"/><!-- {filler}'
        (folder / "a.add.xml").write_text(f"<additional>{text}</additional>")
        names = {path.name for path in files_read(folder / "tiny.sumocfg", {})}
        assert "cal.xml" in names


@pytest.mark.parametrize("text", ["", "<configuration", "<c><net-file value='no.xml'/></c>"])
def test_what_cannot_be_read_is_left_to_the_run(folder, text):
    (folder / "tiny.sumocfg").write_text(text)
    assert files_read(folder / "tiny.sumocfg", {}) == [folder / "tiny.sumocfg"]
    assert files_read(folder / "no.sumocfg", {}) == []


def test_files_that_name_each_other_end(folder):
    (folder / "a.add.xml").write_text('<additional><include href="sub/inc.add.xml"/></additional>')
    (folder / "sub/inc.add.xml").write_text('<a><include href="../a.add.xml"/></a>')
    names = [path.name for path in files_read(folder / "tiny.sumocfg", {})]
    assert names.count("a.add.xml") == 1
