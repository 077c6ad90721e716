"""Kinds of conflict, and what was never attacked."""

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.judge.conflict_types import Course, conflict_type
from deepmf_sumo.results import risk, statistics
from deepmf_sumo.results.risk import places as places_module
from deepmf_sumo.results.risk.kinds import NO_CONFLICT
from deepmf_sumo.sumo.network.sumo_road import road_of_net

from tests.support import worth_doubles
from tests.support.risk_doubles import LEFT_IN, NET, Attacks, eastward, straight

CAR_M = np.array([4.8, 2.0])


@pytest.fixture(scope="module")
def places():
    return places_module.read(NET)


@pytest.fixture(scope="module")
def road():
    return road_of_net(NET)


def course(places, road, origin, target, point):
    """Of a vehicle at a point of its way over the junction: the first one, or the last but one."""
    lane = places.movement(origin, target).lanes[0]
    (x, y), (to_x, to_y) = road.lanes[lane].centre_m[[point, point + 1]]
    pose = np.array([x, y]), float(np.arctan2(to_y - y, to_x - x)), CAR_M
    return Course.on_lanes(road, (f"{origin}_0", lane), *pose)


@pytest.mark.parametrize(
    ("av", "opponent", "expected"),
    [
        (("w_in", "n_out"), ("e_in", "w_out"), "left turn across path"),
        (("e_in", "w_out"), ("w_in", "n_out"), "left turn across path"),
        (("w_in", "e_out"), ("s_in", "n_out"), "crossing"),
        (("w_in", "n_out"), ("n_in", "s_out"), "crossing"),
        (("w_in", "e_out"), ("s_in", "e_out"), "merging"),
        (("w_in", "n_out"), ("e_in", "n_out"), "merging"),
    ],
)
def test_two_ways_over_a_junction_have_a_kind(places, road, av, opponent, expected):
    """Wherever on them the two met."""
    for point in (0, -2):
        pair = (course(places, road, *one, point) for one in (av, opponent))
        assert conflict_type(*pair, road) == expected


@pytest.mark.parametrize(
    ("x", "y", "heading", "expected"),
    [
        (-5.2, 0.0, 0.0, "rear-end"),
        (5.2, 0.5, 0.1, "rear-end"),
        (1.0, 2.3, -0.1, "lane change"),
        (5.0, 0.3, 3.0, "head-on"),
        (3.0, -4.0, 1.6, "crossing"),
    ],
)
def test_elsewhere_the_poses_decide(road, x, y, heading, expected):
    av = Course.on_lanes(road, (), np.zeros(2), 0.0, CAR_M)
    other = Course.on_lanes(road, (), np.array([x, y]), heading, CAR_M)
    assert conflict_type(av, other, road) == expected


def test_an_edge_has_a_direction_at_its_end(places):
    assert places.heading_rad("w_in") == pytest.approx(0.0, abs=0.1)
    assert places.heading_rad("s_in") == pytest.approx(np.pi / 2, abs=0.1)


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    out = Attacks(tmp_path_factory.mktemp("covered") / "out")
    measured = {"pet": 0.0, "ttc_min": 0.0}
    out.add("a", av=eastward(x=-130.0), opponent=eastward(x=-136.0), hit=80, metrics=measured)
    near = {"ttc_min": 1.2, "pet": 0.8}
    out.add("b", av=eastward(x=-130.0), opponent=eastward(x=-139.0), metrics=near)
    out.add("c", av=eastward(x=-130.0), opponent=straight((-60.0, -12.0), 0.0, 0.0))
    left = straight((-60.0, -1.6), 10.0, 0.0, steps=51)
    out.add("d", av=left, opponent=eastward(), moment=(*LEFT_IN, "left"))
    [network] = risk.read([out.out])
    return network


def test_conflicts_have_a_row_a_kind(network):
    rows = {row.kind: row for row in risk.by_type(network.attacks)}
    behind = rows["rear-end"]
    assert (behind.attacks, behind.hits, behind.findings, behind.judged) == (2, 1, 1, 1)
    assert (behind.least_ttc_s, behind.median_ttc_s) == (0.0, pytest.approx(0.6))
    assert (behind.least_pet_s, behind.median_pet_s) == (0.0, pytest.approx(0.4))
    assert behind.delta_v_mps == behind.delta_v_most_mps == 6.0
    assert (rows[NO_CONFLICT].attacks, rows[NO_CONFLICT].hits) == (2, 0)
    assert rows["head-on"].attacks == 0
    assert rows["head-on"].least_ttc_s is None


def cells(network):
    return {(one.table, one.subject, one.name): one for one in risk.coverage(network)}


def test_what_was_never_attacked_is_there(network):
    found = cells(network)
    left = network.places.movement(*LEFT_IN).id
    assert found["place", "movement", left].attacks == 1
    movements = [one for one in found.values() if one.subject == "movement"]
    assert len(movements) == network.places.count("movement")
    assert sum(one.attacks > 0 for one in movements) < len(movements)
    assert found["place", "edge", "s_in"].attacks == 0
    speed = "manoeuvre", "speed at the start"
    assert found[*speed, "30 to 50 km/h"].attacks == 4
    assert sum(one.attacks for key, one in found.items() if key[:2] == speed) == 4


def test_each_attack_counts_in_the_cells_that_it_belongs_to(network):
    """Three on the way to the junction, one that turns left there; one opponent behind hits."""
    found = cells(network)
    behind = found["conflict", "kind of conflict", "rear-end"]
    assert (behind.conflicts, behind.hits, behind.findings) == (2, 1, 1)
    assert behind.hit_rate == statistics.rate([[1.0], *[[0.0]] * (behind.attacks - 1)])
    assert sum(one.attacks for key, one in found.items() if key[0] == "conflict") == 4
    assert found["environment", "speed limit", "30 to 50 km/h"].attacks == 4
    assert found["environment", "junction", "between junctions"].attacks == 4
    around = "environment", "road users within 50 m at the start"
    assert found[*around, "up to 2"].attacks == 4


def test_a_cell_without_an_attack_says_why(network):
    found = cells(network)
    for key, one in found.items():
        assert bool(one.reason) == (one.attacks == 0), key
        if one.attacks == 0:
            assert (one.conflicts, one.hits, one.findings, one.causes) == (0, 0, 0, 0)
            assert one.hit_rate is None
    assert found["environment", "junction", "roundabout"].reason == "no such place in the network"
    assert found["rule", "rule", "stop"].reason == "no such place in the network"
    assert found["environment", "weather", "rain, snow, fog"].reason == "never: SUMO has none"
    assert found["manoeuvre", "manoeuvre", "stands"].reason == "not reached in 4 attacks"


def finding(change):
    """The metrics and keys of a finding with a cause."""
    return {
        "metrics": worth_doubles.metrics("A", by=()),
        "finding": {"rung": "A", "reasons": [], "av_error": "struck_ahead", "opponent_error": "",
                    "avoided_by": []},
        "cause": {"change": change, "what": "", "last_moment_s": {}, "changes": {}},
    }  # fmt: skip


def test_findings_of_one_cause_are_one_cause(tmp_path):
    out = Attacks(tmp_path / "out")
    for number, change in enumerate(("reacts", "reacts", "brakes harder")):
        scene = f"s{number}"
        out.add(scene, av=eastward(), opponent=eastward(x=-144.0), hit=30, **finding(change))
    contrived = finding("reacts") | {"metrics": worth_doubles.metrics("C")}
    contrived["finding"] = contrived["finding"] | {"rung": "C", "av_error": "other"}
    out.add("c", av=eastward(), opponent=eastward(x=-144.0), hit=30, **contrived)
    out.add("old", av=eastward(), opponent=eastward(x=-144.0), hit=30,
            metrics=worth_doubles.metrics("B"))  # fmt: skip
    [network] = risk.read([out.out])
    one = cells(network)["conflict", "kind of conflict", "rear-end"]
    assert (one.attacks, one.hits, one.findings, one.causes) == (5, 5, 4, 2)


def test_the_cause_is_of_the_turn_that_hit_first(tmp_path):
    def turn(begin_s, ended):
        return {"opponent": "foe", "begin_s": begin_s, "end_s": begin_s + 2.0, "ended": ended,
                "outcome": "av_opponent" if ended == "contact" else "none",
                "hit_speed_mps": None, "metrics": worth_doubles.metrics("A")}  # fmt: skip

    out = Attacks(tmp_path / "out")
    turns = [turn(0.0, "time"), turn(2.0, "contact")]
    out.add("a", av=eastward(), opponent=eastward(x=-144.0), hit=45, turns=turns,
            **finding("reacts"))  # fmt: skip
    [network] = risk.read([out.out])
    assert [one.cause is not None for one in network.attacks] == [False, True]
    both = [{"kind": "av_opponent", "step": step, "first_id": "ego", "second_id": "foe",
             "sector": 4, "relative_mps": 6.0} for step in (25, 45)]  # fmt: skip
    out = Attacks(tmp_path / "both")
    turns = [turn(0.0, "contact"), turn(2.0, "contact")]
    out.add("a", av=eastward(), opponent=eastward(x=-144.0), hit=25, turns=turns,
            **finding("reacts") | {"contacts": both})  # fmt: skip
    [network] = risk.read([out.out])
    assert [one.hit for one in network.attacks] == [True, True]
    assert [one.cause is not None for one in network.attacks] == [True, False]


def test_a_hit_that_could_not_be_judged_is_in_no_rate_of_findings(tmp_path):
    out = Attacks(tmp_path / "out")
    unknown = dict.fromkeys(("finding", "rung"))
    out.add("a", av=eastward(), opponent=eastward(x=-144.0), hit=30, metrics=unknown)
    out.add("b", av=eastward(), opponent=eastward(x=-144.0), hit=30)
    [network] = risk.read([out.out])
    one = cells(network)["conflict", "kind of conflict", "rear-end"]
    assert (one.hits, one.findings, one.finding_rate.rate, one.hit_rate.rate) == (2, 1, 1.0, 1.0)
    assert one.finding_rate.low < one.hit_rate.low


FLOWS = """spec,network,edge,following,vehicles,near,hours
city,four_way,w_approach,,100,50,0.5
city,four_way,w_in,,60,60,0.5
city,four_way,w_in,n_out,20,10,0.5
city,four_way,gone,,7,7,0.5
city,four_way,n_in,,30,0,0.5
other,four_way,w_in,,999,999,0.5
"""


def test_flows_make_hits_per_passing_vehicle(tmp_path):
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(x=-130.0), opponent=eastward(x=-136.0), hit=80)
    (tmp_path / "out" / "flow.csv").write_text(FLOWS)
    [network] = risk.read([tmp_path / "out"])
    table = [risk.columns(row) for row in risk.rows(network)]
    edge = {one["place"]: one for one in table if one["kind"] == "edge"}
    began, decided = edge["w_approach"], edge["w_in"]
    assert (began["counted"], began["vehicles_per_hour"], began["near_share"]) == (
        "began",
        200.0,
        0.5,
    )
    assert began["hits_per_1000_vehicles"] == pytest.approx(500.0 * began["risk_hit"])
    assert (decided["counted"], decided["vehicles_per_hour"]) == ("decided", 120.0)
    assert decided["hits_per_1000_vehicles"] is None
    found = cells(network)
    left = network.places.movement(*LEFT_IN).id
    assert found["place", "movement", left].vehicles_per_hour == 40.0
    assert found["place", "edge", "s_in"].vehicles_per_hour == 0.0
    assert found["place", "edge", "s_in"].reason == "no traffic there while moments were chosen"
    alone = "no vehicle there had another one near it"
    assert found["place", "edge", "n_in"].reason == alone
    assert found["place", "edge", "w_in"].reason == "not reached in 1 attack"
    assert found["manoeuvre", "manoeuvre", "left turn"].vehicles_per_hour == 40.0
    assert found["manoeuvre", "manoeuvre", "left turn"].reason == "not reached in 1 attack"
    right = found["manoeuvre", "manoeuvre", "right turn"]
    assert (right.vehicles_per_hour, right.reason) == (
        0.0, "no traffic there while moments were chosen",
    )  # fmt: skip
    assert found["rule", "rule", "change lanes"].vehicles_per_hour is not None
    assert found["environment", "junction", "between junctions"].vehicles_per_hour is None


@pytest.mark.parametrize(
    "table", ["a,b\n1,2\n", FLOWS.replace("100,50", "many,50"), FLOWS.rstrip("\n")]
)
def test_a_damaged_table_of_flows_is_one_sentence(tmp_path, table):
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(x=-130.0), opponent=eastward(x=-136.0), hit=80)
    (tmp_path / "out" / "flow.csv").write_text(table)
    with pytest.raises(UsageError, match=r"flow\.csv .*run it again, or remove it"):
        risk.read([tmp_path / "out"])
