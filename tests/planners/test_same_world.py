"""A planner behind a door drives in the same world as the same planner in the process."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.planners import idm
from deepmf_sumo.planners.perception import nearest_in_corridor
from deepmf_sumo.planners.remote import client, serve
from deepmf_sumo.scene import (
    Boundary,
    Command,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    SignalState,
    StopSign,
    View,
)
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support import rollout_doubles, two_levels
from tests.support.predictor_doubles import straight_tracks


def told(road):
    """The road as a remote planner has it."""
    case = replace(rollout_doubles.case_of(), road=road)
    return serve.case_of(serve.read(client.reset_message(case, road=True))).road


def same(a, b, where="road"):
    """Every field of every part, whatever fields there will be."""
    if is_dataclass(a):
        assert type(a) is type(b), where
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, dict):
        assert list(a) == list(b), where
        for key in a:
            same(a[key], b[key], f"{where}[{key}]")
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for number, (one, other) in enumerate(zip(a, b, strict=True)):
            same(one, other, f"{where}[{number}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        assert a.shape == b.shape, where
        assert a.tobytes() == b.tobytes(), where
    else:
        assert a == b, where


def full_road():
    """A road in which every field of every part has a value of its own."""
    line = np.array([[0.0, 1 / 3], [10.0, 0.0], [20.0, 1e-9]])
    rise = np.array([0.0, 4.0, 8.0])
    lane = Lane(
        id="a",
        kind="freeway",
        centre_m=line,
        z_m=rise,
        interpolating=True,
        width_m=3.1,
        speed_limit_mps=13.9,
        next=("b",),
        previous=("c",),
        left=(
            Neighbour(lane_id="b", self_start=0, self_end=1, other_start=1, other_end=2),
            Neighbour(lane_id="b", self_start=1, self_end=2, other_start=0, other_end=1),
        ),
        right=(Neighbour(lane_id="c", self_start=0, self_end=2, other_start=0, other_end=2),),
        left_boundaries=(Boundary(start=0, end=2, feature_id="l", kind=7),),
        right_boundaries=(Boundary(start=1, end=2, feature_id="e", kind=2),),
        gives_way_to=("c",),
    )
    bare = Lane(id="b", kind="unknown", centre_m=line[:1], z_m=rise[1:2])
    return RoadMap(
        lanes={"a": lane, "b": bare, "c": replace(bare, id="c")},
        lines=(Polyline(id="l", kind=7, points_m=line, z_m=rise),),
        edges=(Polyline(id="e", kind=2, points_m=line + 5, z_m=rise + 1),),
        polygons=(Polygon(id="p", kind="crosswalk", points_m=line, z_m=rise - 1),),
        stop_signs=(StopSign(id="s", position_m=line[0], z_m=2.5, lane_ids=("a",)),),
        buildings=(Polygon(id="h", kind="building", points_m=line + 20, z_m=rise - 2),),
        footways=(
            Polygon(id="f", kind="footway", points_m=line + 7, z_m=rise),
            Polygon(id="t", kind="track", points_m=line + 8, z_m=rise),
        ),
        water=(Polygon(id="w", kind="water", points_m=line + 40, z_m=rise - 3),),
    )


def test_the_whole_road_arrives():
    road = full_road()
    defaults = {"interpolating", "width_m", "speed_limit_mps"}
    for field in fields(RoadMap):  # the road above says something in each field
        assert getattr(road, field.name), field.name
    for field in fields(Lane):
        assert getattr(road.lanes["a"], field.name) is not None
        if field.name not in defaults | {"id", "kind"}:
            assert len(getattr(road.lanes["a"], field.name)), field.name
    same(road, told(road))


@pytest.mark.parametrize("footways", [None, ()])
def test_no_footways_and_unknown_footways_are_told_apart(footways):
    assert told(replace(full_road(), footways=footways)).footways == footways


def test_the_whole_view_arrives():
    history = straight_tracks({"av": (1 / 3, 0, 0, 10), "b": (60, 0, 1.1, 7)})
    view = View(
        step=10, dt_s=0.1, av_id="av", history=history, road=full_road(),
        signals={"a": SignalState.STOP}, steps_left=70, av_path_m=np.array([[0.0, 1 / 3]]),
        av_recorded_steps=7,
    )  # fmt: skip
    bare = View(step=0, dt_s=0.0, av_id="", history=None, road=None, signals={}, steps_left=0)
    for field in fields(View):  # and something else than by default
        assert getattr(view, field.name) is not getattr(bare, field.name), field.name
    same(view, serve.view_of(serve.read(client.view_message("e", view, 11)), view.road), "view")


def bridge():
    """A road to the east, and one to the north 8 m above it."""
    east, north = np.arange(0.0, 201.0, 5.0), np.arange(-100.0, 101.0, 5.0)
    below = Lane(
        id="below", kind="street", centre_m=np.c_[east, 0 * east], z_m=0 * east, width_m=3.5
    )
    above = Lane(
        id="above", kind="street", centre_m=np.c_[0 * north + 60, north], z_m=0 * north + 8,
        width_m=3.5,
    )  # fmt: skip
    return RoadMap(lanes={"below": below, "above": above})


@pytest.mark.parametrize(("height_m", "leads"), [(0.0, True), (8.0, False)])
def test_a_car_on_the_bridge_is_no_leader_on_either_side_of_the_door(height_m, leads):
    road = bridge()
    history = straight_tracks({"av": (30, 0, 0, 10), "b": (60, 0, np.pi / 2, 10)})
    z_m = np.repeat(np.array([0.0, height_m])[:, None], history.steps, axis=1)
    path = np.c_[np.arange(33.0, 150.0, 2.0), np.zeros(59)]
    view = View(
        step=10, dt_s=0.1, av_id="av", history=replace(history, z_m=z_m), road=road, signals={},
        steps_left=80, av_path_m=path,
    )  # fmt: skip
    beyond = serve.view_of(serve.read(client.view_message("e", view, 11)), told(road))
    inside, outside = (nearest_in_corridor(one, path, 0.2) for one in (view, beyond))
    assert inside == outside
    assert (inside is not None) == leads


class Behind:
    """A connection to a planner that answers in this process."""

    def __init__(self, name, settings):
        self._answerer = serve.Answerer(name, settings)

    def ask(self, path, message, limit_s, what):
        """The answer."""
        return self._answerer.answer(message)

    def close(self):
        """Nothing is open."""


class Nervous:
    """Drives at a random speed."""

    model = None
    Settings = plugins.Settings

    @staticmethod
    def build(settings):
        """The planner."""
        return Nervous()

    def reset(self, case, rng):
        """Keep the generator."""
        self._rng = rng

    def act(self, view):
        """Some speed near that of the present."""
        row = view.history.row(view.av_id)
        speed = view.history.speed_mps[row, -1] + self._rng.normal(scale=0.05)
        return Command(kind="speed", speed_mps=max(float(speed), 0.0))


def remote(name, settings=None):
    """The planner behind messages."""
    connect = lambda: Behind(name, settings or {})  # noqa: E731
    return client.RemotePlanner(name, client.RemoteSettings(), connect)


@pytest.mark.sumo
def test_both_drive_alike_below_a_bridge(tmp_path):
    case = network_case(two_levels.build(tmp_path), 1.0, "av", 60, seed=5)
    inside = [idm.build(idm.Settings(perception="corridor")), Nervous()]
    outside = [
        remote("idm", {"perception": "corridor"}),
        remote("tests.planners.test_same_world:Nervous"),
    ]
    for one, other in zip(inside, outside, strict=True):
        # the attack's random numbers are not the planner's
        a = simulate(case, one, None, rng=np.random.default_rng(1)).tracks
        b = simulate(case, other, None, rng=np.random.default_rng(2)).tracks
        same(a, b, "tracks")
