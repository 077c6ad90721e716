import struct
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.judge.hits import hit_of
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.report.map_layers import junctions
from deepmf_sumo.report.picture import _title, came_from, draw, happened
from deepmf_sumo.scene import Contact, Lane, RoadMap, SignalState
from deepmf_sumo.scene.geometry import polylines

from tests.support.drawn_people import Drawn, episode
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
    assert happened(SimpleNamespace(conflict=conflict, side=side, turned=turned)) == words


def test_a_title_has_the_lights_in_mind_as_the_report_has():
    """The opponent runs a red light where its lane, without lights, has priority over the AV's."""

    def lane(name, points, **named):
        line = np.array(points, float)
        return Lane(id=name, kind="street", centre_m=line, z_m=np.zeros(len(line)), width_m=3.5,
                    **named)  # fmt: skip

    angle = np.linspace(0, np.pi / 2, 15)
    bend = np.column_stack([10 - 10 * np.cos(angle), 10 * np.sin(angle) - 10])
    main, side = [[-200, 0], [10, 0], [200, 0]], [[0, -200], *bend, [200, 0]]
    road = RoadMap(lanes={one.id: one for one in (
        lane("west", [[-200, 0], [-10, 0]], next=("in1",)),
        lane("in1", [[-10, 0], [10, 0]], interpolating=True, previous=("west",), next=("east",)),
        lane("south", [[0, -200], [0, -10]], next=("in2",)),
        lane("in2", bend, interpolating=True, previous=("south",), next=("east",),
             gives_way_to=("in1",)),
        lane("east", [[10, 0], [200, 0]], previous=("in1", "in2")),
    )})  # fmt: skip

    def along(line, speed, begin_m):
        gone_m = begin_m + speed * (np.arange(91) - 10) * 0.1
        place, heading = polylines.points_at(np.array(line, float), gone_m)
        return np.column_stack([place, np.unwrap(heading)])

    av = along(side, 7.0, 176.0)
    told = set()
    for ahead_m in range(-12, 13):
        opponent = Drawn(along(main, 9.0, 168.0 + ahead_m), "vehicle", (4.8, 2.0, 1.5))
        one = episode(av, opponent, road=road)
        simulated = one.rollout.tracks.steps - 1 - one.rollout.now
        lights = ({"in1": SignalState.STOP, "in2": SignalState.GO},) * simulated
        rollout = replace(one.rollout, signals=lights)
        hit = hit_of(Episode(rollout, one.case)) if rollout.contacts else None
        if hit is None or hit.conflict != "merging":
            continue
        assert (hit.ran_red, hit.turned) == (True, "opponent")
        told.add(_title(rollout, one.case, rollout.contacts[0]).partition(":")[0])
    assert told == {"Merging, opponent from the left"}


@pytest.mark.parametrize(
    ("noun", "side", "words"),
    [
        ("pedestrian", "left", "Pedestrian from the left"),
        ("bicycle", "ahead", "Bicycle from ahead"),
    ],
)
def test_the_title_of_a_hit_by_a_person_has_no_lanes(noun, side, words):
    assert came_from(noun, side) == words
