"""A policy drives SUMO's bicycles: cars react off the cycle lane, and they return to theirs."""

from functools import partial

import libsumo
import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import trajectory
from deepmf_sumo.planners import sumo
from deepmf_sumo.scene import HISTORY_STEPS, Driver
from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.vehicle_control import Takeover, move

from tests.support import pavements

NOW = HISTORY_STEPS - 1
CYCLE_LANE_Y_M, LANE_Y_M = 192.85, 195.2
ALONE = ["--step-length", "0.1", "--no-warnings", "--no-step-log", "--collision.action", "none"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, starts_sumo):
    return tmp_path_factory.mktemp("cycle_lane")


def bike(name="b", pos=90.0):
    return pavements.car(name, "wm me", 1, pos, speed=4.0, kind="bike")


def swerves(first_x_m, seconds=4.0):
    """4 m/s east, from the cycle lane into the lane beside it within 1.5 s."""
    steps = np.arange(1, round(seconds * 10) + 1)
    share = np.clip(steps / 15, 0.0, 1.0)
    y = CYCLE_LANE_Y_M + (LANE_Y_M - CYCLE_LANE_Y_M) * share**2 * (3 - 2 * share)
    x = first_x_m + 0.4 * steps
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    return np.column_stack([x, y, heading])


@pytest.mark.parametrize(
    "options", [(), ("--lateral-resolution", "0.8"), ("--lanechange.duration", "3")]
)
@pytest.mark.parametrize("stop", ["", '<stop lane="me_1" endPos="100" duration="5"/>'])
@pytest.mark.parametrize("seen", [True, False])
def test_a_car_does_not_drive_through_a_bicycle_on_its_lane(folder, seen, options, stop):
    """Without the takeover's keepRoute it does: SUMO has a bicycle there on no lane."""
    demand = bike().replace("</vehicle>", f"{stop}</vehicle>")
    blocks = pavements.car("beside", "wm me", 3, 30, 4.0)
    pavements.build(folder, demand, blocks, pavements.car("car", "wm me", 2, 40, 12.0))
    net, rou = folder / "pavements.net.xml", folder / "pavements.rou.xml"
    libsumo.start(["sumo", "-n", str(net), "-r", str(rou), *ALONE, *options])
    gaps, lanes = [], []
    try:
        takeover = Takeover(libsumo, [], footways=partial(footways_of, net))
        libsumo.simulationStep()
        x_m, _ = libsumo.vehicle.getPosition("b")
        for step, (x, y, heading) in enumerate(swerves(x_m, seconds=9.0)):
            pose = Pose(x_m=x - 0.8, y_m=y, heading_rad=heading, speed_mps=4.0)
            if seen:
                takeover.place(step, "b", pose, 1.6)
            else:
                move(libsumo, "b", pose, 1.6, 5.0)
            libsumo.simulationStep()
            takeover.after_step()
            lanes.append(libsumo.vehicle.getLaneID("b"))
            car = libsumo.vehicle.getPosition("car")
            if abs(car[1] - y) < 1.2 and car[0] - 5.0 < x:
                gaps.append(x - 1.6 - car[0])
    finally:
        libsumo.close()
    assert (lanes[-1] == "wm_2") is seen
    assert bool(min(gaps, default=9.0) > 0.0) is seen


@pytest.fixture(scope="module")
def swerved(folder):
    config = pavements.build(folder, bike(), pavements.car("av", "wm me", 3, 20, 8.0))
    poses = swerves(90.0 + 2.0 * 4.0 - 1.0).tolist()
    policy = trajectory.TrajectoryPolicy(
        plugins.settings("adversaries", "trajectory", {"agent": "b", "poses": poses})
    )
    case = network_case(config, 2.0, "av", 130, seed=0)
    return simulate(case, sumo.build(sumo.Settings()), policy, rng=np.random.default_rng(0))


def test_a_cyclist_goes_back_to_its_own_lane_before_sumo_has_it(swerved):
    tracks, row = swerved.tracks, swerved.tracks.row("b")
    assert tracks.kinds[row] == "cyclist"
    driven = np.flatnonzero(swerved.driver[row] == Driver.POLICY)
    y = tracks.position_m[row, :, 1]
    assert y.max() == pytest.approx(LANE_Y_M, abs=0.3)
    assert y[driven[-1]] == pytest.approx(CYCLE_LANE_Y_M, abs=0.2)
    assert (swerved.driver[row, driven[-1] + 1 :] == Driver.SUMO).all()
    told = [event.kind for event in swerved.events if event.agent_id == "b"]
    assert told == ["plan_ended", "handed_back"]


def test_sumo_rides_on_along_the_route(swerved):
    tracks, row = swerved.tracks, swerved.tracks.row("b")
    assert tracks.valid[row].all()
    assert tracks.speed_mps[row, -1] > 3.0
    assert np.diff(tracks.position_m[row, NOW:, 0]).min() > 0.0
