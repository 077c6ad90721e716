import itertools

import numpy as np
import pytest

from deepmf_sumo.scene import Lane
from deepmf_sumo.scene.readers.raw import lane_links


def lane(name, *points, kind="street", z=0.0):
    xy = np.array(points, float)
    along = np.concatenate(
        [np.linspace(a, b, 40, endpoint=False) for a, b in itertools.pairwise(xy)] + [xy[-1:]]
    )
    return Lane(id=name, kind=kind, centre_m=along, z_m=np.full(len(along), z))


STRAIGHT = lane("a", (0, 0), (50, 0))


@pytest.mark.parametrize(
    ("other", "follows"),
    [
        (lane("b", (50, 0), (80, 0)), True),
        (lane("b", (50.25, 0), (80, 0)), True),
        (lane("b", (50.4, 0), (80, 0)), False),
        (lane("b", (50, 0), (80, 20)), True),
        (lane("b", (50, 0), (80, 40)), False),
        (lane("b", (50, 0), (20, 0.1)), False),
        (lane("b", (50, 0), (80, 0), z=1.4), True),
        (lane("b", (50, 0), (80, 0), z=1.6), False),
        (lane("b", (50, 0), (80, 0), kind="bike"), False),
    ],
)
def test_a_lane_follows_where_it_starts_ahead(other, follows):
    assert lane_links.connections([STRAIGHT, other]) == ([("a", "b")] if follows else [])


def test_a_lane_with_one_point_follows_and_is_followed():
    point = Lane(id="p", kind="street", centre_m=np.array([[50.0, 0]]), z_m=np.zeros(1))
    after = lane("b", (50, 0), (80, 0))
    found = set(lane_links.connections([STRAIGHT, point, after]))
    assert found == {("a", "p"), ("p", "b"), ("a", "b")}


def test_a_closed_lane_does_not_follow_itself():
    ring = lane("r", (0, 0), (10, 0), (10, 10), (0, 10), (0, 0))
    assert lane_links.connections([ring]) == []


def test_parallel_lanes_are_neighbours_over_their_common_piece():
    left = lane("l", (20, 3.5), (70, 3.5))
    found = lane_links.neighbours([STRAIGHT, left])
    assert set(found.left) == {"a"}
    assert set(found.right) == {"l"}
    (one,) = found.left["a"]
    assert one.lane_id == "l"
    assert STRAIGHT.centre_m[one.self_start, 0] == pytest.approx(20, abs=1.3)
    assert STRAIGHT.centre_m[one.self_end, 0] == pytest.approx(50, abs=1.3)
    assert (one.other_start, left.centre_m[one.other_end, 0]) == (0, pytest.approx(50, abs=1.3))


@pytest.mark.parametrize(
    "other",
    [
        lane("o", (50, 3.5), (0, 3.5)),  # oncoming
        lane("o", (0, 7), (50, 7)),  # too far away
        lane("o", (0, 1), (50, 1)),  # on the same lane
        lane("o", (0, 3.5), (50, 3.5), z=5),  # on a bridge
        lane("o", (0, 3.5), (50, 3.5), kind="bike"),
        lane("o", (25, -25), (25, 25)),  # crossing
        lane("o", (52, 3.5), (90, 3.5)),  # ahead
    ],
)
def test_others_are_no_neighbours(other):
    found = lane_links.neighbours([STRAIGHT, other])
    assert not found.left
    assert not found.right


def test_only_the_next_lane_is_a_neighbour():
    lanes = [lane(str(index), (0, 2.6 * index), (50, 2.6 * index)) for index in range(3)]
    found = lane_links.neighbours(lanes)
    assert [one.lane_id for one in found.left["0"]] == ["1"]
    assert [one.lane_id for one in found.right["2"]] == ["1"]


def test_no_lanes_have_no_links():
    assert lane_links.linked([]) == {}
