"""Vehicles that a policy drives over street corners, where SUMO 1.28 would crash.

Without the guards 7 of 32 such processes died, cars only under `lanechange.duration`.
"""

import subprocess
import sys

import pytest

from tests.support import pavements

WANDERS = """
import random, sys
from functools import partial
from pathlib import Path
import libsumo, numpy as np
from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.vehicle_control import Takeover
from deepmf_sumo.scene import Command
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.shown_motion import read_pose
net, routes, duration, seed, role = sys.argv[1:]
options = ["--step-length", "0.1", "--no-warnings", "--no-step-log", "--collision.action", "none"]
libsumo.start(["sumo", "-n", net, "-r", routes, "--lanechange.duration", duration, *options])
footways = partial(footways_of, Path(net))
takeover = Takeover(libsumo, [], footways=footways)
libsumo.simulationStep()
av = SumoAv(libsumo, "b", 4.5, read_pose(libsumo, "b", 4.5), None, footways)
middle = np.array([float(one) for one in libsumo.junction.getPosition("m")])
place, heading, draw = middle + [4.0, -12.0], 1.6, random.Random(int(seed))
for step in range(500):
    heading += draw.uniform(-0.2, 0.2)
    place = place + 0.4 * np.array([np.cos(heading), np.sin(heading)])
    if np.abs(place - middle).max() > 15.0:
        heading = float(np.arctan2(*(middle - place)[::-1]))
    pose = Pose(x_m=place[0], y_m=place[1], heading_rad=heading, speed_mps=4.0)
    if role == "av":
        av.drive(Command(kind="pose", x_m=pose.x_m, y_m=pose.y_m, heading_rad=heading))
        libsumo.simulationStep()
        av.after_step()
    else:
        takeover.place(step, "b", pose, 1.6)
        libsumo.simulationStep()
        takeover.after_step()
print(len(libsumo.vehicle.getIDList()))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory, starts_sumo):
    return tmp_path_factory.mktemp("corners")


def wander(folder, kind, duration, seed, role="opponent"):
    """Exit code of a process in which a vehicle wanders over all corners of a junction."""
    lane = 1 if kind == "bike" else 2
    pavements.build(folder, pavements.car("b", "wm me", lane, 90.0, speed=4.0, kind=kind))
    files = folder / "pavements.net.xml", folder / "pavements.rou.xml"
    command = [sys.executable, "-c", WANDERS, *map(str, files), duration, seed, role]
    return subprocess.run(command, capture_output=True, check=False).returncode


@pytest.mark.parametrize("kind", ["bike", "car"])
@pytest.mark.parametrize("duration", ["0", "3"])
def test_sumo_survives_the_corners(folder, kind, duration):
    assert [wander(folder, kind, duration, seed) for seed in "12"] == [0, 0]


def test_an_av_that_its_planner_places_survives_them_too(folder):
    assert [wander(folder, "car", "3", seed, "av") for seed in "4568"] == [0, 0, 0, 0]
