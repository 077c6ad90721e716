import struct
import time

import numpy as np
import pytest
import shapely

from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.report.map_layers import junctions
from deepmf_sumo.report.picture import came_from, draw, happened
from deepmf_sumo.scene import Contact, Lane, RoadMap

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

PATHS = {
    "av": straight(0, 0, 10),
    "b": straight(-8, 3.5, 12),
    "c": straight(20, 3.5, 8),
    "$x^{": straight(30, 0, 8),
}


@pytest.fixture(scope="module")
def plan():
    view = view_of({name: (*path[10], 10.0) for name, path in PATHS.items()})
    policy = build(Settings(form={"candidates": 8, "reactions": 3}), Doubles())
    policy.reset(view, np.random.default_rng(0))
    return plan_of(policy, view)


def size(path):
    return struct.unpack(">II", path.read_bytes()[16:24])


def test_same_bytes_in_time(plan, tmp_path):
    rollout = rollout_of(PATHS, contacts=[contact_of()], plans=[plan], opponent_id=plan.agent_id)
    draw(rollout, case_of(PATHS), tmp_path / "warm.png")
    begin = time.perf_counter()
    draw(rollout, case_of(PATHS), tmp_path / "again.png")
    assert time.perf_counter() - begin < 4.0  # 0.3 to 0.7 s on an idle machine
    assert (tmp_path / "warm.png").read_bytes() == (tmp_path / "again.png").read_bytes()
    assert b"Software" not in (tmp_path / "again.png").read_bytes()
    assert min(size(tmp_path / "again.png")) > 700


@pytest.mark.slow_unit
def test_the_attack_shows(plan, tmp_path):
    case = case_of(PATHS)
    pictures = set()
    for contacts in ([], [contact_of()], [contact_of("av_other", second="c")]):
        for plans in ([], [plan]):
            path = tmp_path / "x.png"
            draw(rollout_of(PATHS, contacts=contacts, plans=plans), case, path)
            pictures.add(path.read_bytes())
    assert len(pictures) == 6


def test_nobody_attacks(tmp_path):
    draw(rollout_of({"av": PATHS["av"]}, opponent_id=None), case_of(), tmp_path / "x.png")
    assert size(tmp_path / "x.png")[0] > 700


def test_far_journeys_are_cut_to_their_end(tmp_path):
    far = {"av": straight(0, 0, 300), "b": straight(-8, 3.5, 300)}
    contact: Contact = contact_of(step=90)
    draw(rollout_of(far, contacts=[contact]), case_of(), tmp_path / "x.png")
    assert size(tmp_path / "x.png")[0] > 700


RING = np.arange(0, 6.3, 0.1)


def crossroads():
    """Two roads of one lane that cross at the origin, with a lane of 20 m inside."""

    def lane(name, points, inside):
        line = np.array(points, float)
        return Lane(
            id=name, kind="street", centre_m=line, z_m=np.zeros(len(line)), width_m=4.0,
            interpolating=inside,
        )  # fmt: skip

    return RoadMap(lanes={one.id: one for one in (
        lane("in", [[-50, 0], [-10, 0]], False), lane("over", [[-10, 0], [10, 0]], True),
        lane("across", [[0, -10], [0, 10]], True),
        lane("ring", [[100 + 20 * np.cos(a), 20 * np.sin(a)] for a in RING], True),
    )})  # fmt: skip


def test_junctions_are_filled_and_islands_are_not():
    """A cross of 2 x 20 m x 4 m; gaps of up to 10 m are filled, the middle of a ring is free."""
    cross, ring = sorted((shapely.Polygon(one[0], one[1:]) for one in junctions(crossroads())),
                         key=lambda one: one.centroid.x)  # fmt: skip
    assert cross.contains(shapely.Point(0, 0))
    assert cross.covers(shapely.box(-1.9, -9.8, 1.9, 9.8))
    assert 2 * 80 - 16 <= cross.area < 20 * 20
    assert len(ring.interiors) == 1
    assert not ring.contains(shapely.Point(100, 0))
    assert ring.area == pytest.approx(np.pi * (22**2 - 18**2), rel=0.02)


@pytest.mark.parametrize(
    ("conflict", "side", "turned", "words"),
    [
        ("left turn across path", "ahead", "opponent", "Left turn in front of the AV"),
        ("right turn across path", "ahead", "AV", "Right turn of the AV across the opponent"),
        ("rear-end", "behind", "AV", "Into the AV from behind"),
        ("rear-end", "ahead", "opponent", "Into the vehicle ahead"),
        ("crossing", "left", "", "Crossing, opponent from the left"),
        ("merging", "behind", "AV", "Merging of the AV, opponent from behind"),
        ("lane change", "right", "opponent", "Lane change, opponent from the right"),
        ("head-on", "ahead", "", "Head-on"),
    ],
)
def test_a_title_says_what_happened(conflict, side, turned, words):
    assert happened(conflict, side, turned) == words


@pytest.mark.parametrize(
    ("noun", "side", "words"),
    [
        ("pedestrian", "left", "Pedestrian from the left"),
        ("bicycle", "ahead", "Bicycle from ahead"),
    ],
)
def test_the_title_of_a_hit_by_a_person_has_no_lanes(noun, side, words):
    assert came_from(noun, side) == words
