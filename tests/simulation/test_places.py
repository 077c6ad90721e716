"""Free places on lanes: who fits where."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.datatypes import Driver
from deepmf_sumo.simulation.frame import Frame, Pose
from deepmf_sumo.simulation.free_positions import FreePositions, Occupancy

from tests.support.predictor_doubles import straight_road

ROAD = straight_road()  # lanes "0" at y = 0 and "1" at y = 3.5, eastwards from x = -100 to 300


def api(allowed=(), disallowed=()):
    lane = SimpleNamespace(
        getAllowed=lambda lane_id: allowed if lane_id == "0" else (),
        getDisallowed=lambda lane_id: disallowed if lane_id == "0" else (),
    )
    vehicle = SimpleNamespace(getVehicleClass=lambda _: "passenger")
    return SimpleNamespace(lane=lane, vehicle=vehicle)


def nearest(agents, sumo=None):
    """For ``ov`` among agents (x, y, heading, speed)."""
    poses = {
        name: (Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed), Driver.SUMO)
        for name, (x, y, heading, speed) in agents.items()
    }
    size_m = np.tile([4.8, 2.0], (len(agents), 1))
    return FreePositions(sumo or api(), ROAD).nearest("ov", Frame.of_poses(poses), size_m, ())


def test_the_middle_of_the_lane_beside():
    place = nearest({"ov": (0, -2.5, 0.1, 8)})
    assert (place.lane_id, place.front_m[1]) == ("0", 0.0)
    assert place.heading_rad == pytest.approx(0.0)
    assert place.moved_m < 4.0
    assert place.speed_mps == pytest.approx(8.0)


@pytest.mark.parametrize("speed", [0.0, 8.0])
def test_nobody_is_in_the_way_of_the_place(speed):
    place = nearest({"ov": (0, -2.5, 0, speed), "there": (1, 0, 0, speed)})
    centre = place.front_m[0] - 2.4
    assert place.lane_id == "1" or abs(centre - 1) > 4.8


def test_nor_will_be_in_two_seconds():
    fast = nearest({"ov": (0, -2.0, 0, 2), "comes": (-18, 0, 0, 20)})
    assert fast.lane_id == "1"
    gone = nearest({"ov": (0, -2.0, 0, 2), "comes": (18, 0, 0, 20)})
    assert gone.lane_id == "0"


@pytest.mark.parametrize("sumo", [api(allowed=("bus",)), api(disallowed=("passenger",))])
def test_lanes_of_others_are_left_alone(sumo):
    assert nearest({"ov": (0, -2.5, 0, 8)}, sumo).lane_id == "1"


def test_none_where_all_lanes_are_far_or_lead_the_other_way():
    assert nearest({"ov": (0, -60, 0, 8)}) is None
    assert nearest({"ov": (0, -1, np.pi, 8)}) is None


def test_lanes_inside_junctions_have_no_places():
    assert (
        FreePositions(api(), ROAD).askew_rad("0", Pose(x_m=0, y_m=0, heading_rad=1, speed_mps=0))
        == 1
    )
    assert (
        FreePositions(api(), ROAD).askew_rad(":j_0", Pose(x_m=0, y_m=0, heading_rad=1, speed_mps=0))
        == 0
    )


def test_overlaps_but_with_one():
    pose = Pose(x_m=0, y_m=0, heading_rad=0, speed_mps=0)
    frame = Frame.of_poses(dict.fromkeys(("ov", "av"), (pose, Driver.SUMO)))
    size_m = np.tile([4.8, 2.0], (2, 1))
    assert not Occupancy(frame=frame, size_m=size_m, av_id="av").touched("ov")
    assert Occupancy(frame=frame, size_m=size_m, av_id="").touched("ov")
