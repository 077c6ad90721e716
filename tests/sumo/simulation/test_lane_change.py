"""Vehicles taken over in the middle of a lane change, or put on a lane of another class."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import tiny_network

EPISODE = """
import sys
import libsumo
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.shown_motion import read_pose
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.scene import Command
from deepmf_sumo.sumo.simulation.vehicle_control import Takeover

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
takeover, av = Takeover(libsumo, []), SumoAv(libsumo, "leader", length_m, start)
for step in range(40):
    across = min(1.6, 0.4 * (step + 1))  # over the border within half a second
    pose = Pose(x_m=start.x_m + 0.8 * (step + 1), y_m=start.y_m + across, heading_rad=0.0,
                speed_mps=8.0)
    if who == "opponent":
        takeover.place(step, "leader", pose, length_m)
    else:
        av.drive(Command(kind="pose", x_m=pose.x_m, y_m=pose.y_m, heading_rad=0.0, speed_mps=8.0))
    libsumo.simulationStep()
    takeover.after_step() if who == "opponent" else av.after_step()
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


ARTERIAL = Path(__file__).resolve().parents[3] / "sumo_nets" / "arterial" / "arterial.sumocfg"
BUS_LANE = """
import sys
import libsumo
from deepmf_sumo.scene import Command
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.shown_motion import read_pose
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.vehicle_control import Takeover

config, who, *options = sys.argv[1:]
libsumo.start(["sumo", "-c", config, "--seed", "2", "--no-step-log", "true",
               "--no-warnings", "true", *options])
vehicle, car = libsumo.vehicle, "flow_east.0"
while "line_7.0" not in vehicle.getIDList() or vehicle.getLanePosition("line_7.0") < 300:
    libsumo.simulationStep()
takeover, av = Takeover(libsumo, []), SumoAv(libsumo, car, 4.5, read_pose(libsumo, car, 4.5))
path = [(-262.07, -4.07, -.07), (-260.87, -4.21, -.10), (-259.81, -4.46, -.18),
        (-258.92, -4.80, -.27), (-258.21, -5.20, -.38), (-257.64, -5.60, -.47),
        (-257.16, -5.91, -.51), (-256.76, -6.11, -.50), (-256.61, -6.19, -.49),
        (-256.47, -6.25, -.48), (-256.36, -6.30, -.48)]
for step, (x_m, y_m, turned) in enumerate(path + 20 * path[-1:]):
    pose = Pose(x_m=x_m, y_m=y_m, heading_rad=turned, speed_mps=2.0)
    if who == "opponent":
        takeover.place(step, car, pose, 4.5)
    else:
        av.drive(Command(kind="pose", x_m=x_m, y_m=y_m, heading_rad=turned, speed_mps=2.0))
    libsumo.simulationStep()
    takeover.after_step() if who == "opponent" else av.after_step()
    vehicle.getLeader("line_7.0", 100.0)
print("put on", vehicle.getLaneID(car), vehicle.getLeader("line_7.0", 100.0)[0])
if who == "opponent":
    takeover.hand_back(60, car)
else:
    av.drive(Command(kind="sumo"))
libsumo.simulationStep()
print("then on", vehicle.getLaneID(car), vehicle.getVehicleClass(car))
"""


@pytest.mark.parametrize(
    "options",
    [("--lanechange.duration", "3"), ("--lanechange.duration", "0", "--lateral-resolution", "0.8")],
    ids=["duration", "sublane"],
)
@pytest.mark.parametrize("who", ["opponent", "av"])
def test_a_car_that_is_put_on_a_bus_lane_is_seen_there_and_leaves_sumo_alive(who, options):
    command = [sys.executable, "-c", BUS_LANE, str(ARTERIAL), who, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.returncode, done.stderr)
    put, then = [line.split() for line in done.stdout.splitlines() if " on " in line]
    assert put[2:] == ["east_bay_0", "flow_east.0"]  # the bus follows the car
    assert then[3] == "passenger"
    if who == "opponent":
        assert then[2] == "east_bay_1"


SUITE = Path(__file__).resolve().parents[3] / "suite"
JUNCTION = """
import sys
import libsumo
import numpy as np
from deepmf_sumo.scene import Command
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.shown_motion import read_pose
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.vehicle_control import Takeover

config, who = sys.argv[1:]
libsumo.start(["sumo", "-c", config, "--seed", "102", "--step-length", "0.1",
               "--collision.action", "none", "--no-step-log", "true", "--no-warnings", "true"])
libsumo.simulationStep(174.0)
vehicle, lorry = libsumo.vehicle, "flow_east.19"
takeover, av = Takeover(libsumo, []), SumoAv(libsumo, lorry, 10.0, read_pose(libsumo, lorry, 10.0))
times = np.arange(13, 32) / 10  # from the junction on, and off the road to its right
knots = [0.0, 1.2, 1.3, 1.4, 3.0]
fronts = np.column_stack([np.interp(times - 1.3 + 0.1, knots, column) for column in (
    [10.9, 15.66, 15.86, 16.03, 18.0], [-2.7, -7.42, -7.90, -8.36, -14.0],
    [100.6, 121.1, 123.2, 125.3, 140.0])])
lengths = set()
for step, (x, y, angle) in enumerate(fronts):
    (centre_x, centre_y), heading = frames.from_sumo((x, y), angle, 10.0)
    pose = Pose(x_m=centre_x, y_m=centre_y, heading_rad=float(heading), speed_mps=5.0)
    if who == "opponent":
        takeover.place(step, lorry, pose, 10.0)
    else:
        av.drive(Command(kind="pose", x_m=pose.x_m, y_m=pose.y_m, heading_rad=pose.heading_rad,
                         speed_mps=5.0))
    lengths.add(vehicle.getLength(lorry))
    libsumo.simulationStep()
    takeover.after_step() if who == "opponent" else av.after_step()
print("off the lanes", vehicle.getLaneID(lorry) == "", min(lengths) < 10.0 == max(lengths))
takeover.hand_back(60, lorry) if who == "opponent" else av.drive(Command(kind="sumo"))
print("length", vehicle.getLength(lorry))
"""


@pytest.mark.sumo
@pytest.mark.parametrize("who", ["opponent", "av"])
def test_a_lorry_whose_rear_is_in_a_junction_leaves_the_road_and_sumo_alive(who):
    """A car waits to turn left there, so it looks for all on that junction."""
    command = [sys.executable, "-c", JUNCTION, str(SUITE / "arterial.sumocfg"), who]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.returncode, done.stderr)
    assert "off the lanes True True" in done.stdout
    assert "length 10.0" in done.stdout


OVERTAKES = """
import sys
import libsumo
import numpy as np
from deepmf_sumo.scene import Command
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.shown_motion import read_pose

libsumo.start(["sumo", "-c", sys.argv[1], "--step-length", "0.1", "--no-step-log", "true",
               "--no-warnings", "true"])
vehicle = libsumo.vehicle
vehicle_length = 5.0
for _ in range(20):
    libsumo.simulationStep()
vehicle.setLaneChangeMode("av", 0)
vehicle.setSpeedMode("leader", 0)
vehicle.setSpeed("leader", 3.0)
vehicle.setSpeedMode("av", 0)
vehicle.setSpeed("av", 9.0)
while vehicle.getLanePosition("leader") - vehicle.getLanePosition("av") > 18.0:
    libsumo.simulationStep()
av = SumoAv(libsumo, "av", vehicle_length, read_pose(libsumo, "av", vehicle_length))
av.after_step()
vehicle.changeLane("av", 1, 60.0)
gaps, beside = [], []
for _ in range(60):
    av.drive(Command(kind="sumo"))
    libsumo.simulationStep()
    av.after_step()
    shown, leader = av.pose, read_pose(libsumo, "leader", vehicle_length)
    size = np.array([vehicle_length, 1.8])
    box = [(np.array([one.x_m, one.y_m]), one.heading_rad, size) for one in (shown, leader)]
    gaps.append(float(boxes.gap(*box[0], *box[1])))
    beside.append(shown.x_m > leader.x_m)
print("lane", vehicle.getLaneID("av"), "gap", min(gaps), "overtakes", beside[-1])
"""


@pytest.mark.sumo
def test_an_av_that_changes_lanes_keeps_its_distance_until_it_is_out_of_the_way(tmp_path):
    """It comes from behind, 6 m/s faster; for SUMO it is on the other lane at once."""
    config = tiny_network.build(tmp_path)
    command = [sys.executable, "-c", OVERTAKES, str(config)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.returncode, done.stderr)
    words = next(line.split() for line in done.stdout.splitlines() if line.startswith("lane"))
    assert words[1] == "ab_1"
    assert float(words[3]) > 0.3
    assert words[5] == "True"
