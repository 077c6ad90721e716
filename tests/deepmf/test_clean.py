"""`clean` and `on_road`: candidates stay on the road, and touch nobody before the AV."""

from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import constraints
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.settings import LIMITS
from deepmf_sumo.deepmf.situation import OtherAgents, Situation
from deepmf_sumo.scene.geometry import boxes

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import rollout_of, straight

AGENTS = {"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)}
HALF_M = 2.25
"""Of a lane, and the tolerance of `scene.geometry.road`."""


def reason_of(agents, **values):
    settings = plugins.settings("adversaries", "deepmf", {"opponent": "b", **values})
    made = build(settings, Doubles())
    view = view_of(agents)
    made.reset(view, np.random.default_rng(0))
    return plan_of(made, view).reason


def before_contact(reason):
    steps = np.arange(80)
    return steps <= reason.collision_step.min(axis=1)[:, None]


def test_candidates_that_leave_the_road_before_the_contact_are_not_clean():
    reason = reason_of(AGENTS, constraints=["clean", "fair"])
    clean = reason.allowed["clean"]
    y = reason.candidates.futures.position_m[..., 1]
    off = ((y > 3.5 + HALF_M) | (y < -HALF_M)) & before_contact(reason)
    assert clean.any()
    assert not clean.all()
    assert not clean[off[:, ::3].any(axis=1)].any()
    assert clean[~off.any(axis=1)].all()


def test_hits_off_the_road_are_no_attack():
    reason = reason_of(AGENTS, constraints=["on_road"], form={"shortlist": None})
    y = reason.candidates.futures.position_m[..., 1]
    off = ((y > 3.5 + HALF_M) | (y < -HALF_M)) & before_contact(reason)
    left = off[:, ::3].any(axis=1)
    assert (left & reason.collides.any(axis=1)).any()
    np.testing.assert_array_equal(reason.allowed["on_road"], ~left)
    assert not left[reason.chosen]


def test_the_shortlist_counts_meetings_on_the_road_alone():
    short = reason_of(AGENTS, constraints=["on_road"], form={"shortlist": 8})
    all_of_them = reason_of(AGENTS, constraints=["on_road"], form={"shortlist": None})
    kept = short.allowed["on_road"] & short.collides.any(axis=1)
    meets = all_of_them.allowed["on_road"] & all_of_them.collides.any(axis=1)
    assert len(kept) == 8
    assert kept.sum() == min(meets.sum(), 8)


def test_a_second_against_the_traffic_is_no_attack():
    """All lanes lead to the east."""
    reason = reason_of({"av": (0, 0, 0, 10.0), "b": (60, 3.5, np.pi, 8.0)},
                       constraints=["with_traffic"], form={"shortlist": None})  # fmt: skip
    meets = reason.collides.any(axis=1)
    assert meets.any()
    heading = reason.candidates.futures.heading_rad
    y = reason.candidates.futures.position_m[..., 1]
    wrong = (np.cos(heading) < -0.5) & (y < 3.5 + HALF_M) & (y > -HALF_M) & before_contact(reason)
    lasts = wrong.sum(axis=1) > 10  # the second before is not of the attack
    np.testing.assert_array_equal(reason.allowed["with_traffic"], ~lasts)
    assert not (meets & ~lasts).any()
    assert reason_of(AGENTS, constraints=["with_traffic"]).allowed["with_traffic"].all()


def test_candidates_that_touch_a_third_vehicle_are_not_clean():
    free = reason_of(AGENTS, constraints=["clean"])
    blocked = reason_of(AGENTS | {"c": (10, 3.5, 0, 0.0)}, constraints=["clean"])
    assert blocked.allowed["clean"].sum() < free.allowed["clean"].sum()
    position = blocked.candidates.futures.position_m
    through = (np.hypot(*(position - [10, 3.5]).transpose(2, 0, 1)) < 1.5) & before_contact(blocked)
    assert through.any()
    assert not blocked.allowed["clean"][through[:, ::3].any(axis=1)].any()


def test_what_is_touched_is_found_pair_by_pair():
    """Shapely's polygons, for all candidates, others and steps; one vehicle is touched now."""
    agents = AGENTS | {"c": (10, 3.5, 0, 0), "d": (60, 0.5, 2, 6), "e": (-11, 4.5, 0, 12)}
    agents |= {"f": (900, 0, 0, 5), "g": (3, 3.5, 0, 0)}  # all drive through the last
    own = reason_of(agents, constraints=["clean"]).candidates
    view = view_of(agents)
    situation = Situation.of(view, "b", LIMITS)
    steps = np.arange(0, 80, 8)
    made = SimpleNamespace(forecast=own)
    found = constraints._touches_others(situation, made, steps)
    others = situation.others()
    expected = np.zeros(found.shape, bool)
    for other in range(len(others.size_m)):
        theirs = others.position_m[other, steps], others.heading_rad[other, steps]
        there = shapely.polygons(boxes.corners(*theirs, others.size_m[other]))
        futures = own.futures.position_m[:, steps], own.futures.heading_rad[:, steps]
        here = shapely.polygons(boxes.corners(*futures, situation.size_m))
        hit = shapely.area(shapely.intersection(here, there)) > 1e-9
        expected |= hit & ~hit[:, 0].all()
    np.testing.assert_array_equal(found, expected)
    assert expected[:, 1].all()
    assert expected.any(axis=0).sum() > 3
    assert not expected.all(axis=1).any()


def test_a_vehicle_that_drives_off_the_lanes_may_come_onto_them():
    reason = reason_of({"av": (0, 0, 0, 10.0), "b": (-8, 7.0, -0.2, 12.0)}, constraints=["clean"])
    y = reason.candidates.futures.position_m[..., 1]
    comes = (y[:, 0] > 3.5 + HALF_M) & (np.abs(y[:, 40] - 1.75) < 3.0)
    assert comes.any()
    assert reason.allowed["clean"][comes].any()


def test_others_drive_on_or_as_in_an_earlier_episode():
    view = view_of(AGENTS | {"c": (30, 3.5, 0, 9.0)})
    on = OtherAgents.of(view, {"av", "b"}, None)
    np.testing.assert_allclose(on.position_m[0, 9], [39.0, 3.5])
    stops = straight(30, 3.5, 9, accel=-3)[:41]
    paths = {"av": straight(0, 0, 10)[:41], "b": straight(-8, 3.5, 12)[:41], "c": stops}
    seen = OtherAgents.of(view, {"av", "b"}, rollout_of(paths))
    np.testing.assert_allclose(seen.position_m[0, :30], stops[11:, :2])
    assert seen.valid.all()


@pytest.mark.parametrize("values", [{"constraints": ["clean", "fair"]}, {"constraints": ["clean"]}])
def test_the_choice_is_clean_if_anything_is(values):
    reason = reason_of(AGENTS, **values)
    assert reason.allowed["clean"][reason.chosen]
