"""Vehicles that are taken over in the middle of a lane change."""

import subprocess
import sys

import pytest

from tests.support import tiny_network

EPISODE = """
import sys
import libsumo
from deepmf_sumo.simulation.av import Av, read_pose
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.datatypes import Command
from deepmf_sumo.simulation.vehicle_control import Takeover

config, who, steps_before = sys.argv[1], sys.argv[2], int(sys.argv[3])
libsumo.start(["sumo", "-c", config, "--step-length", "0.1", "--lanechange.duration", "3",
               "--no-step-log", "true", "--no-warnings", "true"])
vehicle = libsumo.vehicle
for _ in range(20):
    libsumo.simulationStep()
vehicle.changeLane("leader", 1, 60.0)
for _ in range(steps_before):
    libsumo.simulationStep()
print(vehicle.getLaneID("leader"), vehicle.getLateralSpeed("leader") != 0)
before = vehicle.getMaxSpeedLat("leader")
length_m = vehicle.getLength("leader")
start = read_pose(libsumo, "leader", length_m)
takeover, av = Takeover(libsumo, []), Av(libsumo, "leader", length_m, start)
for step in range(40):
    across = min(1.6, 0.4 * (step + 1))  # over the border within half a second
    pose = Pose(x_m=start.x_m + 0.8 * (step + 1), y_m=start.y_m + across, heading_rad=0.0,
                speed_mps=8.0)
    if who == "opponent":
        takeover.place(step, "leader", pose, length_m)
    else:
        av.drive(Command(kind="pose", x_m=pose.x_m, y_m=pose.y_m, heading_rad=0.0, speed_mps=8.0))
    libsumo.simulationStep()
    takeover.after_step(step) if who == "opponent" else av.after_step()
print(vehicle.getLaneID("leader"), vehicle.getMaxSpeedLat("leader") == before)
"""


@pytest.mark.parametrize("who", ["opponent", "av"])
@pytest.mark.parametrize("steps_before", [3, 10])
def test_who_is_put_over_the_border_of_its_lane_leaves_sumo_alive(tmp_path, who, steps_before):
    config = tiny_network.build(tmp_path)
    command = [sys.executable, "-c", EPISODE, str(config), who, str(steps_before)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.returncode, done.stderr)
    first, last = [line.split() for line in done.stdout.splitlines() if line.startswith("ab_")]
    assert first == ["ab_0", "True"]  # before its middle
    assert last == ["ab_1", "True"]
