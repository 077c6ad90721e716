"""The centre line ahead of a vehicle, on networks as others draw them."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.sumo.simulation.av import RouteAhead

POINT = ((20.0, 5.0), (20.0, 5.0))
"""SUMO's own grid6 has lanes of 0.1 m inside junctions that are one point, given twice."""


def api(lane, shapes, links):
    """Of a vehicle at the begin of a lane, to the east."""
    return SimpleNamespace(
        vehicle=SimpleNamespace(
            getLaneID=lambda _: lane, getLanePosition=lambda _: 0.0, getAngle=lambda _: 90.0,
            getLateralLanePosition=lambda _: 0.0, getNextLinks=lambda _: (),
        ),
        lane=SimpleNamespace(
            getShape=shapes.get, getLength=lambda _: 0.1, getLinks=lambda one: links.get(one, ()),
        ),
    )  # fmt: skip


@pytest.mark.parametrize("point", [POINT, POINT[:1]])
def test_a_lane_inside_a_junction_may_be_a_point(point):
    shapes = {":j_0_0": point, "out_0": ((20.0, 5.0), (60.0, 5.0))}
    links = {":j_0_0": [("out_0", True, True, True, "")]}
    line = RouteAhead(api(":j_0_0", shapes, links), "av").centre_line()
    np.testing.assert_allclose(line, [(20.0, 5.0), (60.0, 5.0)])


def test_a_point_with_nothing_behind_it_has_no_line():
    assert RouteAhead(api(":j_0_0", {":j_0_0": POINT}, {}), "av").centre_line() is None
