"""What a report says of hits by people: from the drawn hit to the sentence."""

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.judge.causes import cause_of
from deepmf_sumo.judge.hits import Hit, hit_of
from deepmf_sumo.judge.ladder import verdict
from deepmf_sumo.report import failures as words
from deepmf_sumo.results.failures import Failure
from deepmf_sumo.results.findings import Worth
from deepmf_sumo.results.groups import grouped
from deepmf_sumo.results.reader import Run

from tests.judge.test_hits_by_people import AV, RIDER, crossing, far_walker
from tests.judge.test_ladder import STREET
from tests.support.drawn_people import CAR, TRUCK, Drawn, episode, stands, walks
from tests.support.rollout_doubles import straight


def sentence(found):
    hit, told = hit_of(found), verdict(found)
    names = {one.name for one in fields(Hit)} & {one.name for one in fields(Failure)}
    names_of_run = ("run_id", "method", "planner", "scene", "adversary", "version", "outcome")
    values = dict.fromkeys(names_of_run, "a") | {"part": "main", "seed": 0}
    more = {}
    if told.finding:
        cause = asdict(cause_of(found))
        more = {name: cause[name] for name in ("change", "what", "last_moment_s")}
    failure = Failure(
        run=Run(folder=Path("nowhere"), row={}, status="ok", **values),
        kind="hit",
        worth=Worth(rung=told.rung, finding=told.finding, avoided_by=told.avoided_by),
        reasons=told.reasons,
        av_error=told.av_error,
        opponent_error=told.opponent_error,
        **{name: getattr(hit, name) for name in names},
        **more,
    )
    return words.sentence(grouped([failure], 1)[0])


def test_from_behind_a_standing_truck():
    x = 8 * 2.2 + CAR[0] / 2 + 0.25
    person = Drawn(walks(x, -7.7, (9, 3.0), begin=9))
    truck = [Drawn(stands(x - 6.6, -4.1), "vehicle", TRUCK)]
    said = sentence(episode(straight(0, 0, 8), person, truck, road=STREET))
    assert said.startswith(
        "The AV hit a pedestrian who stepped onto the road from behind a standing truck or bus;"
        " it held its speed."
    )


def test_over_the_road_and_on_a_crossing():
    said = sentence(episode(AV, far_walker(58), road=STREET))
    assert said.startswith("The AV hit a pedestrian who stepped onto the road from the left; it")
    said = sentence(episode(AV, far_walker(58), road=crossing(58)))
    assert said.startswith(
        "The AV hit a pedestrian who crossed on a pedestrian crossing from the left; it held"
    )


def test_who_ran_into_the_side_of_the_av_was_not_hit_by_it():
    door = Drawn(walks(29.5, 7.3, (9, 2.0), heading=-np.pi / 2))
    said = sentence(episode(AV, door, road=STREET))
    assert said.startswith("A pedestrian who stepped onto the road from the left ran into the AV;")
    assert "the pedestrian ran into the AV's side" in said


@pytest.mark.parametrize(
    ("y", "degrees", "side"),
    [(-7.0, 155.0, "the right"), (7.0, -155.0, "the left"), (-0.4, 180.0, "ahead")],
)
def test_who_walks_toward_the_av_came_from_the_kerb_where_it_stood(y, degrees, side):
    """It steps off the kerb 7 m beside the middle of the AV's lane, aslant."""
    path = walks(70 if y > -1 else 65, y, (9, 3.3), heading=np.radians(degrees))
    far = -y / np.tan(np.radians(degrees)) if side != "ahead" else 0.0
    path[:, 0] += 60.0 - path[0, 0] - far
    said = sentence(episode(AV, Drawn(path), road=STREET))
    assert f"stepped onto the road from {side}; it" in said


def test_standing_and_beside_the_road():
    said = sentence(episode(AV, Drawn(stands(58, 0)), road=STREET))
    assert said.startswith("The AV held its speed and ran into a pedestrian who stood on the road")
    av = straight(0, 0, 8)
    av[:, 1] = np.interp(np.arange(91), [30, 50], [0, -4.5])
    said = sentence(episode(av, Drawn(walks(44, -6.5, (9, 0.5))), road=STREET))
    assert "left the road and hit a pedestrian there" in said


@pytest.mark.parametrize(
    ("person", "part"),
    [
        (Drawn(straight(25, 0, 4), "cyclist", RIDER), "ran into the bicycle ahead"),
        (Drawn(walks(58, 13.0, (9, 2.6), heading=-np.pi / 2), "cyclist", RIDER),
         "who rode onto the road from the left"),
        (Drawn(straight(80, 0.4, 4, heading=np.pi), "cyclist", RIDER),
         "The bicycle came against the traffic."),
        (Drawn(walks(29.5, 7.3, (9, 2.0), heading=-np.pi / 2)),
         "It is contrived: the pedestrian ran into the AV's side"),
    ],
)  # fmt: skip
def test_words_of_others(person, part):
    assert part in sentence(episode(AV, person, road=STREET))
