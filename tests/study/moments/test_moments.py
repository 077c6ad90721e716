"""Moments chosen from made-up traffic."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.scene import Lane, RoadMap
from deepmf_sumo.scene.geometry.ground import ground_of
from deepmf_sumo.spec import Spec
from deepmf_sumo.study.moments import choice, search
from deepmf_sumo.study.moments.choice import choose
from deepmf_sumo.study.moments.flow import accompanied
from deepmf_sumo.study.moments.moment import Moment, WantedMoments, around, opponents
from deepmf_sumo.sumo.simulation.traffic_survey import DemandVehicle, Sightings

SUMO_CONFIG = Path(__file__).resolve().parents[3] / "sumo_nets" / "four_way" / "four_way.sumocfg"
EDGES = ("in", "left", "right", "out")
TURNS = {("in", "left"): "left", ("in", "right"): "right"}
SECONDS = 60


def traffic(*, pairs=6, permission="passenger", speed=5.0, apart=10.0, parked=False):
    """Pairs of vehicles that follow each other for a minute, each pair on its own road."""
    rows = []
    for pair in range(pairs):
        for member in (0, 1):
            for second in range(1, SECONDS + 1):
                x = speed * second + apart * member
                rows.append((float(second), 2 * pair + member, pair, x, 1000.0 * pair))
    rows.sort()
    time_s, vehicle, pair, x, y = map(np.array, zip(*rows, strict=True))
    return Sightings(
        begin_s=0.0,
        until_s=float(SECONDS),
        complete=True,
        persons=False,
        waiting=0,
        bodies=tuple(
            DemandVehicle(
                id=f"v{number}", type=f"t{number % 2}", permission=permission, departed_s=0.5
            )
            for number in range(2 * pairs)
        ),
        edges=EDGES,
        time_s=time_s,
        vehicle=vehicle,
        edge=np.where(pair < 4, 0, 3),
        following=np.where(pair < 4, 1 + pair % 2, -1),
        position_m=np.column_stack([x, y]),
        to_end_m=np.where(time_s > 40, 10.0, 500.0),
        speed_mps=np.full(len(rows), speed),
        parked=np.full(len(rows), parked),
        z_m=np.zeros(len(rows)),
    )


def test_moments_are_spread_over_edges_movements_vehicles_and_time():
    found = choose(traffic(), TURNS, WantedMoments(count=8))
    assert (len(found.moments), found.reason, found.vehicles) == (8, "", 12)
    moments = found.moments
    assert sorted(one.edge for one in moments) == ["in"] * 4 + ["out"] * 4
    assert {one.turn for one in moments if one.edge == "in"} == {"left", "right", "along"}
    assert len({one.av for one in moments}) == 8
    starts = np.array([one.start_s for one in moments])
    assert (np.diff(starts) >= 0).all()
    assert len(set((starts // 20).tolist())) == 3
    assert {one.around for one in moments} == {1}


def test_the_choice_is_that_of_the_seed():
    wish = WantedMoments(count=5, seed=3)
    assert choose(traffic(), TURNS, wish) == choose(traffic(), TURNS, wish)
    assert choose(traffic(), TURNS, wish) != choose(traffic(), TURNS, replace(wish, seed=4))


def test_attacks_on_one_vehicle_do_not_overlap():
    found = choose(traffic(), TURNS, WantedMoments(count=50, av="v3", duration_s=10.0))
    starts = [one.start_s for one in found.moments]
    assert {one.av for one in found.moments} == {"v3"}
    assert 2 < len(starts) < 7
    assert min(np.diff(starts)) >= 10.0
    assert "no other vehicle that could be the AV" in found.reason


def test_times_and_types_can_be_asked_for():
    found = choose(traffic(), TURNS, WantedMoments(count=4, at_s=(20.0, 50.0), av_type="t1"))
    assert sorted(one.start_s for one in found.moments) == [20.0, 20.0, 50.0, 50.0]
    assert {one.av_type for one in found.moments} == {"t1"}


def test_nobody_new_or_about_to_leave_is_attacked():
    sightings = traffic(pairs=1)
    kept = sightings.time_s < 30
    columns = ("time_s", "vehicle", "edge", "following", "to_end_m", "speed_mps", "parked")
    short = {name: getattr(sightings, name)[kept] for name in columns}
    gone = replace(sightings, position_m=sightings.position_m[kept], **short)
    starts = {
        one.start_s for one in choose(gone, TURNS, WantedMoments(count=500, duration_s=0.1)).moments
    }
    assert (min(starts), max(starts)) == (2.0, 28.0)
    starts = {
        one.start_s for one in choose(gone, TURNS, WantedMoments(count=500, duration_s=3.0)).moments
    }
    assert max(starts) <= 26.0


@pytest.mark.parametrize(
    ("sightings", "wish", "reason"),
    [
        (traffic(apart=60.0), {}, "no vehicle that could be the AV has another vehicle within 50"),
        (traffic(permission="bicycle"), {}, "no car, truck or bus.*classes: bicycle"),
        (traffic(speed=0.0), {}, "must move, and none does"),
        (traffic(parked=True), {}, "must not be parked"),
        (replace(traffic(), bodies=()), {}, "there is no vehicle from 0 to 60 s$"),
        (replace(traffic(), bodies=(), persons=True), {}, "only persons"),
        (replace(traffic(), bodies=(), waiting=3), {}, "3 vehicles wait to be inserted"),
        (traffic(), {"at_s": (20.5,), "av": "v1"}, "'v1' is there from 1 to 60 s, not at 20.5 s"),
    ],
)
def test_nobody_to_attack_has_a_reason(sightings, wish, reason):
    found = choose(sightings, TURNS, WantedMoments(count=3, **wish))
    assert found.moments == ()
    assert re.search(reason, found.reason)


def test_where_vehicles_are_far_apart_people_who_are_made_attack():
    """As if they alone attacked; where vehicles are near, nothing changes."""
    alone = choose(traffic(apart=60.0), TURNS, WantedMoments(count=3, made_too=True))
    by_people = choose(traffic(apart=60.0), TURNS, WantedMoments(count=3, people="made"))
    assert len(alone.moments) == 3
    assert alone.moments == by_people.moments
    slow = choose(traffic(apart=60.0, speed=1.0), TURNS, WantedMoments(count=3, made_too=True))
    assert not slow.moments
    near = [choose(traffic(), TURNS, WantedMoments(count=3, made_too=it)) for it in (True, False)]
    assert near[0].moments == near[1].moments


@pytest.mark.parametrize(
    ("attackers", "who", "too"),
    [("all", "made", True), ("all", "both", True), ("all", "existing", False),
     ("people", "made", False), ("vehicles", "made", False)],
)  # fmt: skip
def test_made_people_count_where_all_attack(attackers, who, too):
    sent = {"network": str(SUMO_CONFIG), "moments": {"count": 1}, "people": who}
    spec = Spec.model_validate(
        {"version": 3, "name": "a", "source": sent, "planner": {"name": "idm"}, "weights": "open",
         "adversary": {"name": "deepmf", "attackers": attackers}},
    )  # fmt: skip
    assert search.request(spec).wish.made_too == too


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({"av": "v33"}, "no such vehicle is on the road from 0 to 60 s; there are v3"),
        ({"av_type": "t7"}, "no such type .* there are t"),
        ({"at_s": (61.0,)}, "there is traffic from 0 to 60 s only"),
        ({"at_s": (0.5,)}, "the simulation begins at 0 s"),
    ],
)
def test_what_is_not_in_the_traffic_is_the_users_mistake(wish, message):
    with pytest.raises(UsageError, match=message):
        choose(traffic(), TURNS, WantedMoments(count=1, **wish))


def test_moments_before_the_beginning_are_left_out_and_why_is_said():
    found = choose(traffic(), TURNS, WantedMoments(count=8, from_s=45.0))
    assert min(one.start_s for one in found.moments) >= 45.0
    assert (found.from_s, found.from_why) == (45.0, "")
    late = choose(traffic(), TURNS, WantedMoments(count=8, from_s=61.0))
    assert not late.moments
    assert late.reason == (
        "a vehicle is there from 1 to 60 s, and none from 61 s on; --from S begins earlier"
    )
    at_once = choose(traffic(), TURNS, WantedMoments(count=8, from_s="settled"))
    assert at_once.from_s == 1.0
    assert "settled at about 12" in at_once.from_why


@pytest.mark.parametrize(
    ("number", "begins", "why"),
    [
        ([*range(60), *[60] * 180], 43.0, "settled at about 60"),
        (
            [*range(240)],
            120.0,
            "still grows .on average 150 in the third quarter of it, 210 in the last.",
        ),
        ([40] * 240, 0.0, "settled at about 40"),
        ([*range(60), *[60] * 120, *range(60, 0, -1)], 44.0, "settled at about 60"),
        ([0, 1, 1, 2], 1.0, "settled at about 2"),
        ([0, 1], 1.0, "settled at about 1"),
    ],
)
def test_traffic_has_settled_at_nine_tenths_of_its_level(number, begins, why):
    """Of a minute's mean; a number that still grows is attacked from its middle."""
    found = choice.settled(np.arange(float(len(number))), np.array(number, float))
    assert found.time_s == pytest.approx(begins, abs=2.0)
    assert re.search(why, found.why)
    assert choice.settled(np.zeros(0), np.zeros(0)) is None


def test_the_moments_of_another_attack_are_taken_again():
    first = choose(traffic(), TURNS, WantedMoments(count=8)).moments
    pairs = tuple((one.av, one.start_s) for one in first)
    again = choose(traffic(), TURNS, WantedMoments(count=8, seed=5, again=pairs))
    assert [(one.av, one.start_s) for one in again.moments] == list(pairs)
    assert again.reason == ""
    fewer = choose(traffic(pairs=3), TURNS, WantedMoments(count=8, again=(*pairs, ("gone", 5.0))))
    assert {(one.av, one.start_s) for one in fewer.moments} < set(pairs)
    assert "not there at their times" in fewer.reason
    none = choose(traffic(), TURNS, WantedMoments(count=1, again=(("gone", 5.0),)))
    assert not none.moments
    assert "not there at their times" in none.reason


def test_nobody_at_all_is_told_when_moments_are_taken_again():
    empty = replace(traffic(), bodies=(), vehicle=np.zeros(0, int), time_s=np.zeros(0))
    found = choose(empty, TURNS, WantedMoments(count=1, again=(("v0", 5.0),)))
    assert found.reason.startswith("there is no vehicle from 0 to 60 s: the moments are of other")


def test_moments_of_a_table_are_each_taken_once(tmp_path):
    table = tmp_path / "moments.csv"
    table.write_text("run_id,av,start_s\nr1,car ü,3.04\nr1,car ü,3.0\nr2,b,7\n", "utf-8")
    assert search.read(tmp_path) == search.read(table) == (("car ü", 3.0), ("b", 7.0))
    table.write_text("run_id,av,start_s\nold-town--r1,a,3\nnew-town--r1,a,4\n", "utf-8")
    assert search.read(table, spec="New town") == (("a", 4.0),)
    assert search.read(table, spec="new") == (("a", 3.0), ("a", 4.0))
    table.write_text("run_id,av,start_s\nnew--a--1,a,3\nnew--b--2,b,4\nnew--a--21,a,5\n")
    assert search.read(table, spec="new", seed=1) == (("a", 3.0),)
    assert search.read(table, spec="new", seed=2) == (("b", 4.0),)
    assert search.read(table, spec="new", seed=3) == (("a", 3.0), ("b", 4.0), ("a", 5.0))
    for damaged in ("run_id,av,start_s\nr,a,inf\n", "run_id,av\nr,a\n", "run_id,av,start_s\nr\n"):
        table.write_text(damaged)
        with pytest.raises(UsageError, match="is not a table of moments"):
            search.read(table)


def spec_of(keys, sets=()):
    [document] = search.documents([SUMO_CONFIG], keys, sets)
    return search.spec_of(document)


def test_vehicles_whose_names_are_one_file_name_have_runs_of_their_own(tmp_path):
    """Else one of them would be lost without a word."""
    spec = spec_of({"seed": 3})
    moments = [
        Moment(
            av=av, av_type="t", start_s=10.0, edge="in", following="", turn="along",
            speed_mps=5.0, around=1,
        )
        for av in ("car.1", "Car_1", "car 1", "bus")
    ]  # fmt: skip
    tasks = search.tasks(spec, moments)
    assert len({task.run_id for task in tasks}) == 4
    assert [task.spec.source.av.vehicle for task in tasks] == [one.av for one in moments]
    assert tasks[3].run_id == "four-way--bus-10s--3"


@pytest.mark.parametrize(("asked", "of_first", "of_second"), [("met", "b", None), ("x", "x", "x")])
def test_whom_the_av_is_about_to_meet_can_be_the_opponent(asked, of_first, of_second):
    """Who meets nobody has its opponent chosen as by default."""
    sets = ["adversary.version=S2", f"adversary.opponent={asked}", "profile=lawful"]
    spec = spec_of({}, sets)
    moments = [
        Moment(
            av="a", av_type="t", start_s=start_s, edge="in", following="", turn="along",
            speed_mps=5.0, around=1, encounter_s=meets and 1.0, meets=meets,
        )
        for start_s, meets in ((10.0, "b"), (30.0, None))
    ]  # fmt: skip
    settings = [task.spec.adversary.settings for task in search.tasks(spec, moments)]
    assert [one.get("opponent") for one in settings] == [of_first, of_second]
    assert all(one["constraints"] == ["lawful"] for one in settings)
    long = spec_of({"duration_s": 30.0}, sets[1:2])
    assert long.opponents == "one", "who is named, or met, takes no turns"


def test_a_time_before_a_saved_state_is_refused_though_the_survey_saw_no_vehicle():
    empty = replace(traffic(), bodies=(), begin_s=300.0, until_s=300.0)
    with pytest.raises(UsageError, match="100: the simulation begins at 300 s"):
        choose(empty, TURNS, WantedMoments(count=1, at_s=(100.0,)))


def bridge():
    """The surface of a road along x at height 0, and of one across it 8 m above."""
    lanes = [
        Lane(id=name, kind="street", centre_m=np.array(line, float), z_m=np.full(2, z), width_m=3.2)
        for name, line, z in (
            ("below", ((-200, 0), (200, 0)), 0.0),
            ("above", ((0, -200), (0, 200)), 8.0),
        )
    ]
    return ground_of(RoadMap(lanes={one.id: one for one in lanes}))


def two_roads(z_m, ground):
    """One vehicle on the road below, and one 10 m away on the road above, for a minute."""
    seen = traffic(pairs=1)
    x = np.where(seen.vehicle == 0, -7.0, 0.0)
    y = np.where(seen.vehicle == 0, 0.0, 7.0)
    heights = np.where(seen.vehicle == 0, 0.0, z_m)
    return replace(seen, position_m=np.column_stack([x, y]), z_m=heights, ground=ground)


@pytest.mark.parametrize(("z_m", "near"), [(8.0, False), (0.0, True), (2.0, True)])
def test_a_vehicle_on_the_bridge_above_is_not_around(z_m, near):
    seen = two_roads(z_m, bridge())
    able = opponents(seen)
    assert around(seen, able, 0) == int(near)
    assert accompanied(seen).all() == accompanied(seen).any() == near
    assert around(two_roads(z_m, None), able, 0) == 1, "a network without levels"


def test_a_vehicle_farther_up_the_slope_is_around():
    line = np.array([[-200.0, 0.0], [200.0, 0.0]])
    slope = Lane(id="up", kind="street", centre_m=line, z_m=np.array([0.0, 40.0]), width_m=3.2)
    ground = ground_of(RoadMap(lanes={"up": slope}))
    seen = traffic(pairs=1, apart=40.0, speed=0.0)
    z_m = 20.0 + 0.1 * seen.position_m[:, 0]
    seen = replace(seen, z_m=z_m, ground=ground)
    assert np.ptp(z_m) == pytest.approx(4.0)
    assert around(seen, opponents(seen), 0) == 1
    assert accompanied(seen).all()


def test_vehicles_of_a_distribution_are_of_each_of_its_types():
    wish = WantedMoments(count=8, av_type="mix", av_types=("t0", "t1"))
    assert {one.av_type for one in choose(traffic(), TURNS, wish).moments} == {"t0", "t1"}
    one = replace(wish, av_types=("t1", "gone"))
    assert {one.av_type for one in choose(traffic(), TURNS, one).moments} == {"t1"}
    with pytest.raises(UsageError, match=r"moments\.av_type mix: no such type is on the road"):
        choose(traffic(), TURNS, replace(wish, av_types=("gone",)))
