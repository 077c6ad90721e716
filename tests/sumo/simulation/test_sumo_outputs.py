"""What SUMO writes is in one folder, whatever option or file names it."""

import re
import subprocess
from pathlib import PurePosixPath, PureWindowsPath

import pytest
import sumo

from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.sumo.simulation.sumo_outputs import confined, from_anywhere

SUMO = f"{sumo.SUMO_HOME}/bin/sumo"
_READ = re.compile(r"(files?|input-file|load-state|-path|distances)$")
_BY_VEHICLES = ("device.ssm.file", "device.toc.file")
"""Names of files that are options of another type."""


def placed(words, folder):
    """Options that are given beside the words, and the words that stay."""
    found = confined(words, folder)
    own = found.index("--output-prefix")
    return dict(zip(found[own::2], found[own + 1 :: 2], strict=True)), found[:own]


@pytest.mark.parametrize(
    ("words", "kept", "prefix", "suffix"),
    [
        (["-c", "no.sumocfg", "--begin", "-1"], ["-c", "no.sumocfg", "--begin", "-1"], "", ""),
        (["--output-prefix", "run1_", "-n", "a"], ["-n", "a"], "run1_", ""),
        (["--output-prefix=/home/user/x_"], [], "x_", ""),
        (["--output-suffix", r"/../..\../x", "-v"], ["-v"], "", "x"),
        (["--output-prefix", "a/../"], [], "", ""),
    ],
)
def test_a_prefix_is_a_name_in_the_folder(tmp_path, words, kept, prefix, suffix):
    options, found = placed(words, tmp_path)
    assert found == kept
    assert options["--output-prefix"].endswith(f"/..{tmp_path}/{prefix}")
    # SUMO before 1.25 does not know a suffix: none is given where none was asked for
    assert options.get("--output-suffix", "") == suffix


def test_the_way_to_the_folder_begins_at_the_root_of_its_drive():
    up = "../" * 64
    assert from_anywhere(PurePosixPath("/tmp/a b")) == f"{up}tmp/a b"
    assert from_anywhere(PureWindowsPath(r"D:\Users\a\out")) == f"{up}Users/a/out"
    assert from_anywhere(PureWindowsPath(r"\\server\share\out")) == f"{up}out"


@pytest.mark.parametrize(
    "words",
    [
        ["--save-configuration", "x"],
        ["--save-config=x"],
        ["-C", "x"],
        ["-Cx"],
        ["-vC", "x"],
        ["-vSC=x"],
        ["--save-template", "x"],
        ["--save-schema=x"],
    ],
)
def test_what_writes_elsewhere_is_refused_by_name(tmp_path, words):
    with pytest.raises(UsageError, match=r"SUMO's option --(save|C)"):
        confined(["-n", "net.xml", *words], tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "<save-configuration value='x'/>",
        "<save-config v='x'/>",
        "<output><save-template>x</save-template></output>",
        "<C value='x'/>",
        "<gui-settings-file value='view.xml'/>",
    ],
)
@pytest.mark.parametrize("words", [["-c", "{}"], ["-c{}"], ["-vc", "{}"], ["--config={}"], ["{}"]])
def test_a_configuration_that_writes_elsewhere_is_refused(tmp_path, text, words):
    (tmp_path / "view.xml").write_text("<viewsettings><snapshot file='/x.png' time='1'/>")
    file = tmp_path / "a.sumocfg"
    file.write_text(f"<configuration>{text}</configuration>")
    with pytest.raises(SimulationError, match=r"remove (it|that)\."):
        confined([one.format(file) for one in words], tmp_path)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a", "<configuration>", "cannot be read"),
        ("a", "<!DOCTYPE c [<!ENTITY e \"<save-config value='x'/>\">]><c>&e;</c>", "save-config"),
        ("a", '<!DOCTYPE c [<!ENTITY e SYSTEM "more.xml">]><c>&e;</c>', "cannot be read"),
        ("a%20b", None, "cannot be read"),
        ("${HOME}", None, "cannot be read"),
    ],
)
def test_a_configuration_that_sumo_may_read_otherwise_is_refused(tmp_path, name, text, reason):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(SimulationError, match=reason):
        confined(["-c", str(tmp_path / name)], tmp_path)


@pytest.mark.sumo
def test_all_files_that_sumo_can_write_are_in_the_folder(tiny, tmp_path):
    """SUMO's own list of its options says which they are."""
    schema, elsewhere, inside = (tmp_path / name for name in ("schema", "elsewhere", "inside"))
    for folder in (elsewhere, inside):
        folder.mkdir()
    subprocess.run([SUMO, "--save-schema", schema], check=True, capture_output=True)
    files = re.findall(r'name="([\w.-]+)" type="fileOptionType"', schema.read_text())
    outputs = [name for name in files if not _READ.search(name)]
    assert len(outputs) > 35
    options = "".join(
        f'<{name} value="{elsewhere / name}"/>'
        for name in (*outputs, *_BY_VEHICLES)
        if name not in {"elechybrid-output", "gui-testing.setting-output"}  # a folder; sumo-gui's
    )
    (tmp_path / "more.add.xml").write_text(
        f'<additional><edgeData id="e" file="{elsewhere}/edges"/></additional>'
    )
    config = tmp_path / "all.sumocfg"
    config.write_text(
        f'<configuration><net-file value="{tiny}/tiny.net.xml"/>'
        f'<route-files value="{tiny}/tiny.rou.xml"/><additional-files value="more.add.xml"/>'
        f'<save-state.period value="1"/><device.ssm.probability value="1"/>{options}'
        '<output-suffix value="/../../elsewhere/x"/></configuration>'
    )
    command = confined(["-c", str(config), "--end", "2", "--no-warnings"], inside)
    subprocess.run([SUMO, *command], check=True, capture_output=True)
    assert list(elsewhere.iterdir()) == []
    assert len(list(inside.iterdir())) > 30
