"""Encounters of vehicles at junctions, when nobody attacks."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from deepmf_sumo.study.moments.choice import choose
from deepmf_sumo.study.moments.encounters import NEAR_S, Passages, _apart, encounters, passages
from deepmf_sumo.study.moments.moment import WantedMoments
from deepmf_sumo.study.moments.search import find
from deepmf_sumo.sumo.network.sumo_net import read_net
from deepmf_sumo.sumo.simulation.traffic_survey import DemandVehicle, Sightings, TrafficSurvey

from tests.support.crossing_network import build

EDGES = ("west", "east", "far", "south", "north")
OVER, UP = (0, 1, 2), (3, 4)
IN_M, INSIDE_M = 150.0, 10.0


def drive(ways, *, speed=10.0, permission="passenger", every_s=1.0, lengths=None):
    """Vehicles that come to their first junction at given times, at a constant speed.

    ``ways``: route and time; edges are 150 m long, or as ``lengths`` says, junctions 10 m.
    """
    rows = []
    for vehicle, (route, at_s) in enumerate(ways):
        ends = np.cumsum([(lengths or {}).get(edge, IN_M) + INSIDE_M for edge in route])
        first = ends[0] - INSIDE_M
        for time_s in np.arange(1.0, 61.0, every_s):
            x = first + speed * (time_s - at_s)
            number = int(np.searchsorted(ends, x, "right"))
            if x >= 0 and number < len(route):
                following = route[number + 1] if number + 1 < len(route) else -1
                left = max(0.0, ends[number] - INSIDE_M - x)
                where = (x, 0.0) if route is OVER else (IN_M, x - IN_M)
                rows.append((time_s, vehicle, route[number], following, *where, left))
    rows.sort()
    time_s, vehicle, edge, following, x, y, left = map(np.array, zip(*rows, strict=True))
    return Sightings(
        begin_s=0.0, until_s=60.0, complete=True, persons=False, waiting=0,
        bodies=tuple(
            DemandVehicle(id=f"v{number}", type="t", permission=permission, departed_s=0.0)
            for number in range(len(ways))
        ),
        edges=EDGES, time_s=time_s, vehicle=vehicle, edge=edge, following=following,
        position_m=np.column_stack([x, y]), to_end_m=left, speed_mps=np.full(len(rows), speed),
        parked=np.zeros(len(rows), bool),
        z_m=np.zeros(len(rows)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return build(tmp_path_factory.mktemp("crossing"))


@pytest.fixture(scope="module")
def net(config):
    return read_net(config.parent / "crossing.net.xml")


def kept(seen, rows):
    columns = ("time_s", "vehicle", "edge", "following", "position_m", "to_end_m", "speed_mps")
    return replace(seen, **{name: getattr(seen, name)[rows] for name in (*columns, "parked")})


def test_who_passes_a_junction_is_known_to_half_a_second():
    passed = passages(drive([(OVER, 18.3), (UP, 20.65)]))
    ways = [passed.ways[way] for way in passed.way]
    order = np.argsort(passed.entered_s)
    assert [ways[row] for row in order] == [("west", "east"), ("south", "north"), ("east", "far")]
    assert passed.vehicle[order].tolist() == [0, 1, 0]
    assert passed.entered_s[order] == pytest.approx([18.3, 20.65, 34.3])
    assert passed.left_s[order] == pytest.approx([19.3, 21.65, 35.3], abs=0.5)


def test_who_waits_inside_a_junction_enters_it_when_it_goes_on():
    seen = drive([(UP, 20.3)])
    seen = kept(seen, seen.time_s < 30.0)
    (inside,) = np.flatnonzero(seen.to_end_m == 0.0)
    assert seen.time_s[inside] == 21.0
    many = np.where(np.arange(len(seen.time_s)) == inside, 6, 1)  # it stands there for 5 s
    waits = kept(seen, np.repeat(np.arange(len(many)), many))
    speed = waits.speed_mps * (waits.to_end_m > 0.0)
    time_s = seen.time_s[0] + np.arange(len(speed))
    waits = replace(waits, time_s=time_s, speed_mps=speed)
    ways = {("south", "north")}
    passed = passages(waits, ways)
    assert passed.entered_s == pytest.approx([26.5])
    assert passed.left_s == pytest.approx([26.5])
    assert passages(seen, ways).entered_s == pytest.approx([20.3])
    # where there is no place to wait it is in everybody's way
    assert passages(waits).entered_s == pytest.approx([20.3])
    assert passages(waits).left_s == pytest.approx([26.5])


def test_two_junctions_in_a_second_are_both_passed():
    """The edge between them is 4 m long, and the vehicle is never seen on it."""
    passed = passages(drive([(OVER, 18.3)], speed=30.0, lengths={1: 4.0}))
    assert {passed.ways[way] for way in passed.way} == {("west", "east"), ("east", "far")}
    assert passed.entered_s == pytest.approx([18.3, 18.8], abs=0.5)
    late = passages(drive([(OVER, 18.3)], speed=20.0, lengths={1: 4.0}))
    assert sorted(late.ways[way] for way in late.way) == [("east", "far"), ("west", "east")]


def test_jumps_and_gaps_are_no_passages():
    seen = drive([(OVER, 18.3)])
    jumps = replace(seen, position_m=seen.position_m + 500.0 * (seen.time_s > 18.5)[:, None])
    assert [passages(jumps).ways[way] for way in passages(jumps).way] == [("east", "far")]
    away = kept(seen, (seen.time_s < 17.5) | (seen.time_s > 22.5))
    assert [passages(away).ways[way] for way in passages(away).way] == [("east", "far")]
    inside = kept(seen, seen.time_s > 18.5)
    assert [passages(inside).ways[way] for way in passages(inside).way] == [("east", "far")]


def test_an_attack_looks_for_its_encounter_ahead(net):
    seen = drive([(OVER, 18.3), (UP, 20.3), (OVER, 40.3), (UP, 50.3)])
    met = encounters(seen, net, 16.0)
    rank = {
        (int(vehicle), float(time_s)): (int(rank), apart)
        for vehicle, time_s, rank, apart in zip(
            seen.vehicle, seen.time_s, met.rank, met.apart_s, strict=True
        )
    }
    best = rank[0, 14.0]  # 4.3 s ahead, 1 s from one's leaving to the other's entering
    assert best[0] <= 3
    assert best[1] == pytest.approx(1.0, abs=0.5)
    assert rank[1, 14.0] == (best[0] - 1, best[1])  # who comes second is sure to meet the other
    assert rank[0, 5.0] == (best[0] + 10, best[1])  # 13.3 s ahead
    assert rank[0, 17.0] == (best[0] + 10, best[1])  # 1.3 s ahead
    assert rank[0, 19.0][0] == rank[2, 36.0][0] == rank[3, 46.0][0] == 20  # over; nobody is near
    assert np.isnan([rank[0, 19.0][1], rank[2, 36.0][1]]).all()
    assert set(met.kind[met.rank == 20]) == {2}
    short = encounters(seen, net, 4.0)
    assert np.isnan(short.apart_s[(seen.vehicle == 0) & (seen.time_s == 14.0)]).all()


def test_who_is_met_is_known_once_it_is_there_and_near(net):
    seen = drive([(OVER, 18.3), (UP, 20.3)])
    late = kept(seen, (seen.vehicle == 0) | (seen.time_s > 14.5))
    far = drive([(OVER, 18.3), (UP, 20.3)], speed=20.0)  # 152 m apart at 14 s
    for one, other in ((seen, 1), (late, -1), (far, -1)):
        met = encounters(one, net, 16.0)
        at = {
            (int(vehicle), float(time_s)): row
            for row, (vehicle, time_s) in enumerate(zip(one.vehicle, one.time_s, strict=True))
        }
        assert met.other[at[0, 14.0]] == other
        assert met.kind[at[0, 14.0]] == (0 if other == 1 else 1)
        assert met.other[at[1, 17.0]] == 0
        assert met.other[at[0, 30.0]] == -1


def test_a_moment_whose_only_other_vehicle_is_far_is_taken_again(net):
    """It meets that vehicle, so it was worth an attack: `prefer: both` chose it as well."""
    seen = drive([(OVER, 18.3), (UP, 20.3)])  # 61 m apart at 14 s
    at_14 = (("v0", 14.0),)
    met = encounters(seen, net, 16.0)
    for wish in (
        WantedMoments(count=1, again=at_14),
        WantedMoments(count=1, prefer="both", again=at_14),
    ):
        (moment,) = choose(seen, {}, wish, met).moments
        assert (moment.av, moment.start_s, moment.around, moment.meets) == ("v0", 14.0, 0, "v1")
    assert not choose(seen, {}, WantedMoments(count=1, at_s=(14.0,)), met).moments


def test_followers_and_those_who_cannot_attack_are_no_encounters(net):
    follow = drive([(OVER, 18.3), (OVER, 19.3)])
    bicycles = drive([(OVER, 18.3), (UP, 19.3)], permission="bicycle")
    for seen in (follow, bicycles):
        assert np.isnan(encounters(seen, net, 16.0).apart_s).all()


def test_the_nearest_on_a_meeting_way_is_found():
    """As by looking at all pairs."""
    rng = np.random.default_rng(4)
    many = 300
    entered = rng.uniform(0.0, 400.0, many)
    ways = (("a", "x"), ("b", "x"), ("b", "y"), ("c", "y"))
    passed = Passages(
        ways=ways, vehicle=np.arange(many), way=rng.integers(0, 4, many), entered_s=entered,
        left_s=entered + rng.exponential(4.0, many),
    )  # fmt: skip
    place, able = np.where(passed.way < 2, 0, 1), rng.random(many) < 0.8
    pairs = {(ways[0], ways[1]), (ways[1], ways[0]), (ways[2], ways[3]), (ways[3], ways[2])}
    expected, who = np.full((2, many), np.inf), np.full((2, many), -1)
    for one in range(many):
        for two in np.flatnonzero(able):
            if (ways[passed.way[one]], ways[passed.way[two]]) in pairs:
                gap = max(entered[two] - passed.left_s[one], entered[one] - passed.left_s[two], 0.0)
                role = int(entered[two] < entered[one])
                if gap <= NEAR_S and gap < expected[role, one]:
                    expected[role, one], who[role, one] = gap, two
    found, whose = _apart(passed, place, frozenset(pairs), able)
    np.testing.assert_allclose(found, expected)
    alone = found[expected == found] > 0  # of several at once any is met
    assert (whose == who)[expected == found][alone].all()
    assert (np.isfinite(found).sum(axis=1) > 50).all()


def crossings(many=6):
    """A stream on each road, of which every third vehicle has somebody of the other at 2 s."""
    over = [(OVER, 10.3 + 3.0 * number) for number in range(3 * many // 2)]
    up = [(UP, 12.3 + 9.0 * number) for number in range(many // 2)]
    return drive([*over, *up])


def test_encounters_come_first_where_they_are_preferred(net):
    seen = crossings()
    met = encounters(seen, net, 8.0)
    wish = WantedMoments(count=3, seed=2, prefer="encounters")
    found = choose(seen, {}, wish, met)
    assert len(found.moments) == 3
    assert all(one.encounter_s is not None for one in found.moments)
    assert choose(seen, {}, wish, met) == found
    assert choose(seen, {}, replace(wish, seed=3), met) != found


def test_both_spreads_over_edges_and_time_and_takes_encounters_there(net):
    seen = crossings()
    met = encounters(seen, net, 8.0)
    found, plain = (
        choose(seen, {}, WantedMoments(count=12, seed=2, prefer=one), met).moments
        for one in ("both", "spread")
    )
    at = {edge: [one for one in found if one.edge == edge] for edge in EDGES}
    assert {len(one) for one in at.values()} <= {2, 3}
    before = [one.encounter_s is not None for one in (*at["west"], *at["south"])]
    assert all(before)
    assert not all(one.encounter_s is not None for one in plain if one.edge in {"west", "south"})
    assert len({one.start_s // 15 for one in found}) >= 3


def test_fewer_encounters_than_moments_are_said_before_anything_is_attacked(net):
    seen = crossings(many=2)
    met = encounters(seen, net, 8.0)
    (line,) = choose(seen, {}, WantedMoments(count=9, prefer="both"), met).notes
    assert line == (
        "only 4 vehicles meet another at a junction: some of the 9 moments may be without an"
        " encounter"
    )
    for wish in (WantedMoments(count=2, prefer="both"), WantedMoments(count=9)):
        assert choose(seen, {}, wish, met).notes == ()
    alone = replace(met, junctions={})
    assert (
        "no two edges meet at any junction"
        in choose(seen, {}, WantedMoments(count=2), alone).notes[0]
    )


def test_without_the_wish_nothing_changes_but_the_column(net):
    seen = crossings()
    met = encounters(seen, net, 8.0)
    wish = WantedMoments(count=8, seed=2)
    plain, known = (choose(seen, {}, wish, one).moments for one in (None, met))
    assert any(one.encounter_s is not None for one in known)
    for one, two in zip(plain, known, strict=True):
        assert one.encounter_s is None
        assert asdict(one) == asdict(two) | {"encounter_s": None, "meets": None}


def test_junctions_have_equally_many_attacks_where_encounters_are_preferred(net):
    """By edges alone the one of two edges would have twice as many."""
    seen = crossings()
    ends = {"west": "mid", "south": "mid", "east": "e", "north": "n"}
    met = replace(encounters(seen, net, 8.0), junctions=ends)
    found = choose(seen, {}, WantedMoments(count=6, seed=2, prefer="encounters"), met)
    assert sorted(ends[one.edge] for one in found.moments) == ["e", "e", "mid", "mid", "n", "n"]
    assert "far" in {
        one.edge for one in choose(seen, {}, WantedMoments(count=6, seed=2), met).moments
    }


def test_moments_of_a_configuration_begin_before_its_encounters(config):
    """`over1` and `up1` are at the crossing at once; the others follow each other."""
    survey = TrafficSurvey(config=config, sumo_options=(), seed=1)
    found = find(survey, WantedMoments(count=2, prefer="encounters"))
    assert {one.av for one in found.moments} == {"over1", "up1"}
    assert {one.encounter_s for one in found.moments} == {1.2}
    assert {one.av: one.meets for one in found.moments} == {"over1": "up1", "up1": "over1"}
    # over the crossing at 10.1 and 11.7 s; the two are farther apart than 50 m
    assert all(2.0 < one.start_s < 9.0 and one.around == 0 for one in found.moments)
    assert find(survey, WantedMoments(count=2, prefer="encounters")) == found
    late = find(survey, WantedMoments(count=1, prefer="encounters", av="over2"))
    assert [(one.encounter_s, one.meets) for one in late.moments] == [(None, None)]


def test_encounters_are_known_of_moments_that_are_asked_for(config):
    survey = TrafficSurvey(config=config, sumo_options=(), seed=1)
    asked = find(survey, WantedMoments(count=1, prefer="encounters", at_s=(26.0,)))
    assert [(one.start_s, one.encounter_s) for one in asked.moments] == [(26.0, None)]
    again = find(survey, WantedMoments(count=2, again=(("over1", 9.0), ("up1", 10.0))))
    assert [(one.av, one.encounter_s) for one in again.moments] == [("over1", 1.2), ("up1", 1.2)]
