"""A planner that sees what is in sight of the AV: no more in its views, and all in a policy's."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene import Command, View
from deepmf_sumo.scene.geometry import sight
from deepmf_sumo.sumo.simulation import simulate
from deepmf_sumo.sumo.simulation.in_sight import InSight

from tests.support.drawn_people import STREET_VIEW, TRUCK, view_at
from tests.support.simulated_worlds import case_of, scene_of, straight_motion, straight_road

EAST, NORTH = 0.0, np.pi / 2


def shown(limited, agent):
    tracks = limited.history
    return tracks.valid[tracks.row(agent)] if agent in tracks.ids else None


def test_who_is_hidden_is_not_in_the_view_and_was_not_there_before():
    """A runner from behind a truck: in the first view of him he has one state, then two, ..."""
    eyes, first = InSight(), None
    for step in range(10, 40):
        view = view_at(STREET_VIEW, step)
        limited = eyes.limited(view)
        row = view.history.row("b")
        seen = sight.visible(view.history, -1, 0, view.road)[row]
        there = shown(limited, "b")
        assert (there is not None) == seen
        assert {"av", "o0"} <= {*limited.history.ids}
        if seen and first is None:
            first = step
        if first is not None and seen:
            assert there.sum() == min(step - first + 1, 11)
            absent = limited.history.position_m[limited.history.row("b")][~there]
            assert not absent.any()
    assert first is not None
    assert first > 12


def test_where_nobody_is_hidden_the_view_is_the_same():
    view = view_at(STREET_VIEW, 45)
    everyone = replace(view, history=view.history.select([0, 1]))
    assert InSight().limited(everyone) is everyone


class Looks:
    """Keeps its views, and holds its speed."""

    model = None

    def __init__(self):
        self.views: list[View] = []

    def reset(self, case, rng):
        self.views.clear()

    def act(self, view):
        self.views.append(view)
        return Command(kind="speed", speed_mps=8.0)


class Watches:
    """A policy that attacks nobody and keeps its views."""

    period_steps = 5

    def __init__(self):
        self.views: list[View] = []

    def reset(self, view, rng):
        self.views.append(view)
        return ()

    def plan(self, view):
        self.views.append(view)
        return {}


@pytest.fixture(scope="module")
def dart(tmp_path_factory):
    """A child walks out from behind a truck that is parked at the lane."""
    motions = {
        "av": straight_motion(60.0, 0.0, EAST, 8.0),
        "truck": straight_motion(80.0, -3.6, EAST, 0.0),
        "child": straight_motion(87.0, -8.0, NORTH, 1.6),
    }
    kinds = {"child": "pedestrian"}
    scene = scene_of(straight_road(), motions, kinds=kinds)
    sizes = np.array([{"truck": TRUCK, "child": (0.5, 0.5, 1.2)}.get(name, (4.8, 2.0, 1.5))
                      for name in scene.tracks.ids])  # fmt: skip
    scene = replace(scene, tracks=replace(scene.tracks, size_m=sizes))
    return case_of(scene, tmp_path_factory.mktemp("dart"))


@pytest.mark.sumo
def test_planners_see_what_is_in_sight_and_policies_see_everybody(dart):
    planner, policy = Looks(), Watches()
    simulate(replace(dart, in_sight=True), planner, policy, rng=np.random.default_rng(0))
    there = ["child" in view.history.ids for view in planner.views]
    assert not there[0]
    assert any(there)
    assert all("child" in view.history.ids for view in policy.views)
    whole = Looks()
    simulate(dart, whole, None, rng=np.random.default_rng(0))
    assert all("child" in view.history.ids for view in whole.views)
