"""Which agents touch a vehicle, and which are in its way."""

import numpy as np
import pytest

from deepmf_sumo.scene import Driver, Lane, RoadMap
from deepmf_sumo.sumo.simulation.frame import Frame, Pose
from deepmf_sumo.sumo.simulation.occupancy import Occupancy


def around(agents, av="av"):
    poses = {
        name: (Pose(x_m=x, y_m=y, heading_rad=0.0, speed_mps=speed, z_m=z), Driver.SUMO)
        for name, (x, y, speed, z) in agents.items()
    }
    size_m = np.tile([4.8, 2.0], (len(agents), 1))
    return Occupancy(frame=Frame.of_poses(poses), size_m=size_m, av_id=av)


AHEAD = [Pose(x_m=0.5 * step, y_m=0.0, heading_rad=0.0, speed_mps=5.0) for step in range(1, 15)]


def test_overlaps_but_with_one():
    agents = {"ov": (0, 0, 0, 0), "av": (0, 0, 0, 0)}
    assert not around(agents).touched("ov")
    assert around(agents, av="").touched("ov")


@pytest.mark.parametrize(
    ("other", "free"),
    [
        ((10.0, 0.0, 0.0, 0.0), False),
        ((10.0, 0.0, 5.0, 0.0), True),  # it drives ahead as fast
        ((10.0, 0.0, 0.0, 6.0), True),  # on the bridge above
        ((10.0, 3.5, 0.0, 0.0), True),
        ((-20.0, 0.0, 25.0, 0.0), False),  # it comes from behind
        ((4.0, 0.0, 0.0, 0.0), True),  # it touches already
    ],
)
def test_what_is_in_the_way(other, free):
    assert around({"ov": (0.0, 0.0, 5.0, 0.0), "other": other}).clear("ov", AHEAD) is free


def test_a_vehicle_of_several_boxes_is_not_in_its_own_way():
    agents = {"ov": (0.0, 0.0, 5.0, 0.0), "ov part 2": (-4.0, 0.0, 5.0, 0.0)}
    assert not around(agents).touched("ov")
    assert around({**agents, "ov part 2": (3.0, 0.0, 0.0, 0.0)}).clear("ov", AHEAD)


def test_nothing_is_in_the_way_of_an_absent_one():
    assert around({"other": (3.0, 0.0, 0.0, 0.0)}).clear("ov", AHEAD)


WAY_M = np.array([[0.0, 0.0], [60.0, 0.0]])


def road(*lanes):
    """Of lanes through points with heights."""
    return RoadMap(
        lanes={
            str(row): Lane(
                id=str(row), kind="street", centre_m=xyz[:, :2], z_m=xyz[:, 2], width_m=3.2
            )
            for row, xyz in enumerate(np.array(one, float) for one in lanes)
        }
    )


CROSSING = road([(-100, 0, 0), (100, 0, 0)], [(15, -110, 0), (15, -30, 6), (15, 30, 6)])


def test_who_reaches_into_its_way():
    agents = {
        "av": (-2.4, 0.0, 5.0, 0.0),
        "ahead": (20.0, 1.8, 0.0, 0.0),  # 2 m wide: from 0.8 m on
        "beside": (10.0, 2.2, 0.0, 0.0),
        "behind": (-12.0, 0.0, 0.0, 0.0),
        "above": (15.0, 0.0, 0.0, 6.0),
        "not asked for": (5.0, 0.0, 0.0, 0.0),
    }
    asked = set(agents) - {"av", "not asked for"}
    found = around(agents).in_its_way("av", WAY_M, asked, CROSSING)
    assert found == {"ahead": pytest.approx(17.6)}


def test_what_is_farther_up_the_slope_is_in_its_way():
    hill = road([(-100, 0, -10), (100, 0, 10)])
    agents = {"av": (-2.4, 0.0, 5.0, -0.24), "ahead": (50.0, 0.0, 0.0, 5.0)}
    assert set(around(agents).in_its_way("av", WAY_M, {"ahead"}, hill)) == {"ahead"}


def test_nobody_is_in_the_way_of_an_absent_one():
    agents = around({"a": (5.0, 0.0, 0.0, 0.0)})
    assert agents.in_its_way("av", WAY_M, {"a"}, CROSSING) == {}
