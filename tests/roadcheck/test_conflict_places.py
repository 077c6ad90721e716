"""Conflicts of plain traffic at places, beside attacks there: made up on the four-way junction."""

import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results.risk import places as places_module
from deepmf_sumo.roadcheck import conflict_places
from deepmf_sumo.roadcheck.conflict_places import LISTED, beside, by_place, listed, place_columns
from deepmf_sumo.roadcheck.conflicts import Observation, Observed, Side
from deepmf_sumo.scene import agent_ids
from deepmf_sumo.sumo.network.sumo_road import road_of_net

from tests.support.risk_doubles import NET, Attacks, eastward

ROAD = road_of_net(NET)


@pytest.fixture(scope="module")
def places():
    return places_module.read(NET)


def side(name, lane, pose=(0.0, 0.0, 0.0, 5.0, 1.8), delta_v=2.0):
    return Side(
        id=name, type="car", lane=lane, lanes=(lane,), speed_mps=8.0, pose=pose,
        delta_v_mps=delta_v,
    )  # fmt: skip


def conflict(first, second, kind="rear end", ttc_s=1.0):
    return Observed(
        first=first, second=second, begin_s=10.0, end_s=11.0, ttc_s=ttc_s, ttc_at_s=10.5,
        pet_s=0.8, type=kind, angle_deg=0.0, max_s_mps=9.0, delta_s_mps=4.0, max_d_mps2=3.0,
        place_m=(1.0, 2.0),
    )  # fmt: skip


def observation(*conflicts, driven=()):
    return Observation(
        begin_s=0.0, until_s=360.0, complete=True, users=4, user_steps=99, conflicts=conflicts,
        left_out={}, driven=dict(driven),
    )  # fmt: skip


def inside(places, movement):
    return places.movements[movement].lanes[0]


ACROSS = "centre: w_in -> n_out"
ONCOMING = "centre: e_in -> w_out"


def test_a_left_turn_that_has_to_give_way(places):
    turns = side("turns", inside(places, ACROSS), delta_v=3.0)
    goes = side("goes", inside(places, ONCOMING), pose=(9.0, 0.0, 3.1, 5.0, 1.8))
    for pair, waits in (((goes, turns), "second"), ((turns, goes), "first")):
        [row] = listed(observation(conflict(*pair, kind="crossing")), places, ROAD)
        assert row["gives_way"] == waits
        assert (row["type"], row["kind"]) == ("crossing", "left turn across path")
        assert (row["place_kind"], row["junction"]) == ("movement", "centre")
        assert row["max_delta_v_mps"] == 3.0
        assert not row["contact"]
        assert tuple(row) == LISTED


@pytest.mark.parametrize(
    ("name", "kind"), [("goes", "merging"), (agent_ids.of_person("goes"), "crossing")]
)
def test_people_cross_where_vehicles_merge(places, name, kind):
    turns = side("turns", inside(places, "centre: n_in -> w_out"))
    goes = side(name, inside(places, ONCOMING))
    for pair in ((goes, turns), (turns, goes)):
        [row] = listed(observation(conflict(*pair, kind="crossing")), places, ROAD)
        assert row["kind"] == kind


def test_places_count_conflicts_hours_and_each_vehicle_once(places):
    follows = conflict(side("a", "w_in_0"), side("b", "w_in_0"), ttc_s=0.0)
    left = conflict(
        side("c", inside(places, ONCOMING)), side("d", inside(places, ACROSS)), "crossing"
    )
    seen = observation(
        follows, follows, left, driven={"w_in_0": (0, 1), "w_in_1": (1, 2), "n_out_0": (3,)}
    )
    edge, movement = by_place(seen, listed(seen, places, ROAD), places)
    assert (edge.kind, edge.place, edge.conflicts, edge.contacts) == ("edge", "w_in", 2, 2)
    assert (edge.vehicles, edge.per_1000, edge.per_hour) == (3, pytest.approx(2000 / 3), 20.0)
    assert (movement.place, movement.types["crossing"]) == (ONCOMING, 1)
    assert movement.per_1000 is None
    assert tuple(edge.columns()) == place_columns(beside=False)


def test_a_junction_has_those_on_its_movements(places):
    """A conflict on a crossing is the junction's: not only who walks there could have it."""
    driven = {inside(places, ACROSS): {1, 2}, inside(places, ONCOMING): {2, 3}}
    found = conflict_places._vehicles(observation(driven=driven), places)
    assert found["junction", "centre"] == {1, 2, 3}
    assert found["movement", ACROSS] == {1, 2}


def test_attacks_stand_beside_the_conflicts(places, tmp_path):
    runs = Attacks(tmp_path / "out")
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    attacked = beside(tmp_path / "out", places)
    one = conflict(side("a", "e_in_0"), side("b", "e_in_0"))
    seen = observation(one, driven={"e_in_0": (0, 1), "w_in_0": (2,)})
    first, second = by_place(seen, listed(seen, places, ROAD), places, attacked)
    assert (first.place, first.conflicts, first.columns()["attacks"]) == ("e_in", 1, 0)
    assert first.columns()["criticality"] is None
    assert (second.place, second.conflicts, second.vehicles) == ("w_in", 0, 1)
    assert (second.columns()["attacks"], second.columns()["hits"]) == (1, 1)
    assert second.per_1000 == 0
    assert tuple(first.columns()) == tuple(second.columns()) == place_columns(beside=True)


def test_attacks_on_another_network_are_refused(tmp_path):
    runs = Attacks(tmp_path / "out")
    runs.add("a", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=80)
    other = places_module.read(NET.parents[1] / "rural" / "rural.net.xml")
    with pytest.raises(UsageError, match=r"--beside .*out: its attacks are on another network \(f"):
        beside(tmp_path / "out", other)
