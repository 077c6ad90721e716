import random

import numpy as np
import pytest

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import Lane, RoadMap
from deepmf_sumo.sumo.network.lane_graph import lane_graph
from deepmf_sumo.sumo.network.layout import MOST_MOVEMENTS, TooManyMovementsError, layout, movements


class Graph:
    """The part of a lane graph that movements need."""

    def __init__(self, ways, points=()):
        names = sorted({*ways, *(after for each in ways.values() for after in each)})
        self.shapes = dict.fromkeys(names)
        self.following = {name: tuple(ways.get(name, ())) for name in names}
        self.points = points

    def is_point(self, lane_id):
        return lane_id in self.points


def diamonds(count):
    """After each lane the road has two ways, which meet again: 2 to the power of ``count`` ways."""
    ways, at = {"in": ("u0", "d0")}, {"in": np.array([[-50.0, 0.0], [0.0, 0.0]])}
    for n in range(count):
        after = (f"u{n + 1}", f"d{n + 1}") if n < count - 1 else ("out",)
        for side, y in (("u", 2.0), ("d", -2.0)):
            ways[f"{side}{n}"] = after
            at[f"{side}{n}"] = np.array([[6.0 * n, 0], [6.0 * n + 3, y], [6.0 * n + 6, 0]])
    at["out"] = np.array([[6.0 * count, 0.0], [6.0 * count + 50, 0.0]])
    before = {name: tuple(one for one in ways if name in ways[one]) for name in at}
    lanes = {
        name: Lane(
            id=name,
            kind="street",
            centre_m=points,
            z_m=np.zeros(len(points)),
            next=ways.get(name, ()),
            previous=before[name],
            interpolating=name not in {"in", "out"},
        )
        for name, points in at.items()
    }
    return ways, RoadMap(lanes=lanes)


def walked(ways, inside, lane_id, path=()):
    """All ways from a lane on, one lane after the other."""
    if lane_id not in inside:
        return [(path, lane_id)]
    if lane_id in path:
        return []
    return [
        one
        for after in ways.get(lane_id, ())
        for one in walked(ways, inside, after, (*path, lane_id))
    ]


@pytest.mark.parametrize("seed", range(30))
def test_movements_are_all_ways_over_the_lanes_inside(seed):
    chance = random.Random(seed)
    names = [f"l{n:02}" for n in range(12)]
    ways = {name: chance.sample(names, chance.randint(0, 2)) for name in names}
    inside = set(chance.sample(names, 7))
    graph = Graph(ways)
    expected = [
        (origin, path, target)
        for origin in graph.shapes
        if origin not in inside
        for after in ways[origin]
        for path, target in walked(ways, inside, after)
    ]
    found = movements(graph, inside)
    assert sorted((one.origin, one.path, one.target) for one in found) == sorted(expected)


def test_movements_are_counted_before_they_are_listed():
    for count in (11, 12, 300):
        graph = Graph(diamonds(count)[0])
        inside = graph.shapes.keys() - {"in", "out"}
        if 2**count <= MOST_MOVEMENTS:
            assert len(movements(graph, inside)) == 2**count
            continue
        with pytest.raises(TooManyMovementsError) as many:
            movements(graph, inside)
        assert len(many.value.busiest) == 1 + 2 * count // 100


def test_the_lane_with_most_movements_is_the_first_to_become_an_edge():
    ways = {f"in{n}": [f"first{n}"] for n in range(60)}
    ways |= {f"first{n}": ["hub"] for n in range(60)}
    ways |= {"hub": [f"last{n}" for n in range(60)]} | {f"last{n}": [f"out{n}"] for n in range(60)}
    graph = Graph(ways)
    inside = {name for name in graph.shapes if not name.startswith(("in", "out"))}
    with pytest.raises(TooManyMovementsError) as many:
        movements(graph, inside)
    assert "hub" in many.value.busiest
    assert len(movements(graph, inside - {"hub"})) == 120


def test_circles_end():
    names = [f"r{n:02}" for n in range(14)]
    ways = {name: [other for other in names if other != name] for name in names}
    ways |= {"in": ["r00"], "r13": ["out"]}
    graph = Graph(ways)
    with pytest.raises(TooManyMovementsError) as many:
        movements(graph, set(names))
    assert many.value.busiest <= set(names)


def test_circles_without_a_way_out_end():
    names = [f"r{n}" for n in range(10)]
    ways = {name: [other for other in names if other != name] for name in names} | {"in": ["r0"]}
    with pytest.raises(TooManyMovementsError):
        movements(Graph(ways), set(names))


def test_a_chain_of_diamonds_becomes_a_network():
    graph = lane_graph(diamonds(20)[1])
    found = layout(graph, set())
    assert len(found.movements) <= MOST_MOVEMENTS
    lanes = {lane_id for group in found.groups for lane_id in group} | found.inside
    assert lanes == set(graph.shapes)


def test_lanes_of_one_point_alone_are_refused(monkeypatch):
    ways, chain = diamonds(14)
    inside = ways.keys() - {"in"}
    with pytest.raises(TooManyMovementsError) as many:
        movements(Graph(ways, points=inside), inside)
    assert many.value.busiest == set()

    def refused(*_):
        raise many.value

    monkeypatch.setattr("deepmf_sumo.sumo.network.layout.movements", refused)
    with pytest.raises(ConversionError, match="have more than 3000 movements"):
        layout(lane_graph(chain), set())
