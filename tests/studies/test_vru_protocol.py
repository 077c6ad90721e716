"""The ten situations meet where the protocol says, by SUMO's own car at its speed."""

import subprocess
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from studies.vru_protocol import build
from studies.vru_protocol.cases import SITUATIONS

pytestmark = pytest.mark.sumo

SUMO = build.NETCONVERT.parent / "sumo"
ONE_OF_EACH = [
    next(one for one in build.cases((situation.name,)) if one.av_kmh == situation.av_kmh[-1])
    for situation in SITUATIONS
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("protocol")
    build.write(out)
    return out


def driven(folder, case):
    """Front bumper (x, y) and angle of the AV by SUMO's trace, where nobody else is on the road."""
    routes = folder / f"{case.name}.rou.xml"
    tree = ET.parse(routes)
    for one in list(tree.getroot()):
        if one.get("id") != "av":
            tree.getroot().remove(one)
    alone = folder / f"{case.name}.alone.rou.xml"
    tree.write(alone)
    trace = folder / f"{case.name}.fcd.xml"
    net = folder / f"{case.situation.road}.net.xml"
    command = [str(SUMO), "-n", str(net), "-r", str(alone), "--step-length", "0.1", "-e", "28"]
    subprocess.run([*command, "--fcd-output", str(trace), "--no-step-log"], check=True)
    return {
        round(float(step.get("time")), 1): (
            np.array([float(car.get("x")), float(car.get("y"))]),
            float(car.get("angle")),
        )
        for step in ET.parse(trace).getroot()
        for car in step
    }


@pytest.mark.parametrize("case", ONE_OF_EACH, ids=lambda one: one.name)
def test_they_meet_six_seconds_after_the_start(folder, case):
    """The middle of the other is beside the AV's front by the share of its width that is named."""
    front, angle = driven(folder, case)[build.START_S + build.MEETING_S]
    ahead = np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    poses = np.load(folder / f"{case.name}.npz")["position_m"]
    there = poses[round(build.MEETING_S / 0.1) - 1] - front
    along, left = there @ ahead, there @ np.array([-ahead[1], ahead[0]])
    from_left = case.situation.from_left and case.situation.motion != "ahead"
    share = 0.5 - left / build.AV_SIZE_M[1] if from_left else 0.5 + left / build.AV_SIZE_M[1]
    assert along == pytest.approx(0.0, abs=0.35)
    assert share == pytest.approx(case.share, abs=0.1)


def test_the_speeds_are_those_of_the_protocol(folder):
    """From rest where it stands, by the path's own differences."""
    for case in build.cases():
        one = case.situation
        poses = np.load(folder / f"{case.name}.npz")["position_m"]
        speed = np.hypot(*np.diff(poses, axis=0).T) / 0.1
        assert speed[-1] == pytest.approx(one.speed_mps, rel=1e-6)
        if one.starts_m and speed[0] == 0.0:
            moved = np.hypot(*(poses - poses[0]).T)
            done = int(np.argmax(speed > one.speed_mps - 1e-6))
            assert moved[done] == pytest.approx(one.starts_m, abs=0.15)


def test_all_networks_and_routes_are_read_by_sumo_without_a_word(folder):
    for case in ONE_OF_EACH:
        command = [
            str(SUMO),
            "-c",
            str(folder / f"{case.name}.sumocfg"),
            "--no-step-log",
            "-e",
            "21",
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stderr.strip() == ""
