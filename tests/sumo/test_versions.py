"""The user's own SUMO: where it is looked for, and five versions of it at work.

`pytest -m slow -s tests/sumo/test_versions.py` installs each version into a folder of its own
(environment variable DEEPMF_SUMO_TEST_VERSIONS: where they stay for the next time).
"""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.sumo import installed
from deepmf_sumo.sumo.network import sumo_tools

VERSIONS = ("1.20.0", "1.22.0", "1.24.0", "1.26.0", "1.28.0")
PACKAGES = ("libsumo", "eclipse-sumo", "sumolib", "traci")
CLIENT = """
import sys, traci
traci.init(int(sys.argv[1]), numRetries=60)
for _ in range(30):
    traci.simulationStep()
print(traci.getVersion()[1], traci.vehicle.getIDCount())
traci.close()
"""


def laid_out(folder, *places):
    for place in places:
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).touch()
    return folder


@pytest.mark.parametrize("place", ["home/tools/libsumo/_libsumo.so", "libsumo/_libsumo.pyd"])
def test_a_sumo_of_ones_own_has_a_libsumo_in_it_or_beside_it(tmp_path, monkeypatch, place):
    home = laid_out(tmp_path, "home/bin/sumo", place) / "home"
    assert installed.reason(home) == ""
    monkeypatch.setenv("SUMO_HOME", str(home))
    assert installed.own() == home == sumo_tools.home()
    assert sumo_tools.program("sumo") == home / "bin" / "sumo"
    assert sumo_tools.environment()["SUMO_HOME"] == str(home)


def test_what_is_no_sumo_is_not_used(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    for home in (tmp_path, tmp_path / "nowhere", installed.package()):
        monkeypatch.setenv("SUMO_HOME", str(home))
        assert installed.own() is None
        assert sumo_tools.home() == installed.package()
    assert installed.reason(tmp_path) == "has no libsumo in its folder 'tools'"


@pytest.mark.sumo
def test_what_libsumo_itself_sets_is_no_sumo_of_ones_own():
    code = (
        "import libsumo, os; from deepmf_sumo.sumo import installed;"
        " from deepmf_sumo.sumo.network import sumo_tools;"
        " assert 'SUMO_HOME' in os.environ and installed.own() is None, os.environ;"
        " print(sumo_tools.program('sumo'))"
    )
    env = {name: value for name, value in os.environ.items() if name != "SUMO_HOME"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.splitlines()[-1]).parent.parent == installed.package()


def test_modules_come_from_it(tmp_path, monkeypatch):
    home = laid_out(tmp_path, "tools/libsumo/_libsumo.so", "tools/traci/__init__.py")
    (home / "tools" / "sumolib").mkdir()
    (home / "tools" / "sumolib" / "__init__.py").write_text("place = 'own'")
    monkeypatch.setenv("SUMO_HOME", str(home))
    for name in ("sumolib", "traci"):
        assert str(home) in installed._Finder.find_spec(name).origin
    assert installed._Finder.find_spec("numpy") is None
    monkeypatch.delenv("SUMO_HOME")
    assert installed._Finder.find_spec("traci") is None


@pytest.mark.parametrize(
    ("text", "old"),
    [
        ("SUMO 1.19.0", True),
        ("SUMO 1.20.0", False),
        ("SUMO 1.100.0", False),
        ("v1_28_0+0123", False),
    ],
)
def test_a_version_before_the_oldest_is_refused(text, old):
    library = SimpleNamespace(getVersion=lambda: (20, text))
    if not old:
        installed.check(library)
        return
    with pytest.raises(SimulationError, match=r"SUMO 1\.19\.0 .* too old: 1\.20 or newer"):
        installed.check(library)


@pytest.mark.parametrize(
    "arguments", [["--sumo-home", "DIR", "doctor"], ["doctor", "--sumo-home=DIR"]]
)
def test_the_option_refuses_what_is_no_sumo(tmp_path, capsys, arguments):
    given = [one.replace("DIR", str(tmp_path)) for one in arguments]
    (tmp_path / "tools").mkdir()
    assert main.run(given) == 2
    assert f"{tmp_path} has no libsumo in its folder 'tools'" in capsys.readouterr().err


def home_of(version, tmp_path):
    """The folder of a version, installed where it is not yet."""
    place = Path(os.environ.get("DEEPMF_SUMO_TEST_VERSIONS", tmp_path)) / f"sumo-{version}"
    if not place.is_dir():
        wanted = [f"{name}=={version}" for name in PACKAGES]
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", place]
        done = subprocess.run([*pip, *wanted], check=False, capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"cannot be installed here: {done.stderr[-300:]}")
    return place / "sumo"


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("version", VERSIONS)
def test_versions_run_attack_and_serve(version, tmp_path):
    home = home_of(version, tmp_path)
    env = {**os.environ, "DEEPMF_SUMO_HOME": str(tmp_path / "home")}
    env.pop("SUMO_HOME", None)

    def command(*arguments):
        return [sys.executable, "-m", "deepmf_sumo.cli.main", "--sumo-home", home, *arguments]

    def done(out, *arguments):
        line = command(*arguments, "--no-pictures", "--out", out)
        ended = subprocess.run(line, env=env, check=False, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr + ended.stdout
        assert json.loads((out / "manifest.json").read_text())["packages"]["libsumo"] == version
        with (out / "runs.csv").open(newline="") as table:
            [row] = csv.DictReader(table)
        assert row["status"] == "ok"
        print(version, arguments[0], row["outcome"], row.get("min_ttc", ""))
        return row

    assert done(tmp_path / "run", "run", "scenarios/cut_in.yaml")["outcome"] == "av_opponent"
    done(tmp_path / "attack", "attack", "suite/four_way.sumocfg", "-n", "1", "--tries", "1")
    line = command("serve", "suite/four_way.sumocfg", "--av", "flow_e_n.0", "--port", "0")
    line += ["--out", tmp_path / "live"]
    with subprocess.Popen(line, env=env, stdout=-3, stderr=subprocess.PIPE, text=True) as served:
        port = re.search(r"(?:port |localhost:)(\d+)", served.stderr.readline())[1]
        talk = [sys.executable, "-c", CLIENT, port]
        client = subprocess.run(talk, check=False, capture_output=True, text=True, timeout=200)
        said = served.stderr.read()
    assert client.returncode == 0, client.stderr + said
    assert f"SUMO {version}" in client.stdout
    assert served.returncode == 0, said
