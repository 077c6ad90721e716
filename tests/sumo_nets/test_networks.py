"""The networks of the repository: rebuilt to the same bytes, and with traffic that flows."""

import importlib.util
import re
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

NETS = Path(__file__).resolve().parents[2] / "sumo_nets"
NAMES = sorted(config.stem for config in NETS.glob("*/*.netccfg"))


def _builder():
    spec = importlib.util.spec_from_file_location("build_nets", NETS / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_there_are_at_least_five_networks():
    assert len(NAMES) >= 5
    for name in NAMES:
        assert (NETS / name / "SOURCE.md").is_file()


@pytest.mark.sumo
@pytest.mark.parametrize("name", NAMES)
def test_the_committed_network_is_what_its_sources_give(name, tmp_path):
    net = _builder().build(NETS / name / f"{name}.netccfg", tmp_path)
    assert net.read_bytes() == (NETS / name / f"{name}.net.xml").read_bytes()
    assert b"generated on" not in net.read_bytes()


@pytest.mark.sumo
@pytest.mark.parametrize("name", NAMES)
def test_traffic_flows_for_300_s_without_teleports_or_collisions(name, tmp_path):
    statistics, summary = tmp_path / "statistics.xml", tmp_path / "summary.xml"
    program = _builder().NETCONVERT.with_name("sumo")
    command = [program, "-c", NETS / name / f"{name}.sumocfg", "--no-step-log"]
    # Ends on, so that a car which waits for two minutes shows up as a teleport.
    command += ["--time-to-teleport", "120", "--statistic-output", statistics]
    done = subprocess.run(
        [*command, "--summary-output", summary], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    root = ET.parse(statistics).getroot()
    assert root.find("teleports").get("total") == "0", done.stderr
    assert root.find("safety").get("collisions") == "0", done.stderr
    running = [int(n) for n in re.findall(r'running="(\d+)"', summary.read_text())]
    busy = running[600:]
    assert 15 <= sum(busy) / len(busy) <= 60, sum(busy) / len(busy)
