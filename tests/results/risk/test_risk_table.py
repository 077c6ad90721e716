import dataclasses
import itertools

import pytest
from scipy.stats import binomtest

from deepmf_sumo.results import risk
from deepmf_sumo.results.risk import places
from deepmf_sumo.results.risk.places import Spot

from tests.support import worth_doubles
from tests.support.risk_doubles import NET

LEFT = "centre: w_in -> n_out"


numbers = itertools.count()


def attack(spot, *, began=None, hit=False, **changes):
    values = {
        "worth": worth_doubles.worth() if hit else None,
        "ttc_s": 0.0 if hit else 3.0,
        "gap_m": 1.0,
    }
    values |= {"delta_v_mps": 6.0 if hit else None, "other": False, **changes}
    number = next(numbers)
    return risk.Attacked(
        folder="out", run_id=f"m--{number}--0", turn=None, scene=str(number), seed=0, decided=spot,
        began=began or spot, place_m=(0.0, 0.0), hit=hit, **values,
    )  # fmt: skip


def rows_of(attacks):
    network = risk.Network(
        name="city", net_file=NET, places=places.read(NET), attacks=tuple(attacks), left_out={}
    )
    return risk.rows(network)


def at_left(**changes):
    return attack(Spot(lane=":centre_15_0", junction="centre", movement=LEFT), **changes)


def on_edge(edge, **changes):
    return attack(Spot(lane=f"{edge}_0", edge=edge), **changes)


def test_five_of_seven_hit_four_findings():
    """As an engineer would say it, with the exact interval."""
    hits = [
        at_left(hit=True, worth=worth_doubles.worth("B" if number < 4 else "C"))
        for number in range(5)
    ]
    table = rows_of([*hits, at_left(), at_left(ttc_s=1.0, gap_m=0.4)])
    [row] = [one for one in table if one.kind == "movement" and one.counted == "decided"]
    assert (row.attacks, row.events["hit"], row.events["finding"], row.judged) == (7, 5, 4, 5)
    assert row.events["conflict"] == 6
    assert row.events["severe"] == 5
    assert (row.ttc_s, row.gap_m, row.delta_v_mps) == (0.0, 0.4, 6.0)
    values = risk.columns(row)
    assert values["title"] == "centre: from west to north (left, permissive)"
    assert values["hit_rate_lo"] == pytest.approx(binomtest(5, 7).proportion_ci().low, abs=1e-4)
    assert values["finding_share"] == 0.8


def test_seeds_of_one_moment_are_one_attack_in_intervals():
    """Ten seeds of a moment that all hit say of the place what one says."""

    def left(seeds):
        return [dataclasses.replace(at_left(hit=True), run_id=f"m--car--{n}") for n in range(seeds)]

    others = [on_edge(edge) for edge in ("w_in", "e_in", "n_in")]
    rows = [risk.worst(rows_of([*left(seeds), *others]))[0] for seeds in (1, 10)]
    assert [row.attacks for row in rows] == [1, 10]
    assert rows[0].risk == rows[1].risk
    assert rows[0].hit_rate == rows[1].hit_rate == pytest.approx((1.0, 0.025, 1.0), abs=1e-6)


def test_six_places_without_a_hit_are_not_sure():
    """One attack each, as the map of a small network has: the exact bound of all is 39 %."""
    edges = ("w_in", "e_in", "n_in", "s_in", "n_out", "s_out")
    rows = risk.worst(rows_of([on_edge(edge, criticality=0.0) for edge in edges]))
    assert len(rows) == 6
    for row in rows:
        assert 1 - 0.05 ** (1 / 6) < row.risk["hit"].high < 0.6
        assert row.risk["hit"].low == 0.0
        assert row.criticality.high - row.criticality.low > 0.1


def test_each_attack_was_decided_at_one_movement_or_edge():
    table = rows_of([at_left(), on_edge("w_in"), on_edge("w_in", hit=True), on_edge("e_in")])
    assert sum(row.attacks for row in risk.worst(table)) == 4
    assert risk.worst(table)[0].place == "w_in"
    lanes = [row for row in table if row.kind == "lane" and row.counted == "decided"]
    assert sum(row.attacks for row in lanes) == 4
    junctions = [row for row in table if row.kind == "junction" and row.counted == "decided"]
    assert [row.attacks for row in junctions] == [1]


def test_where_it_began_is_a_count_of_its_own():
    ahead = Spot(lane="w_in_2", edge="w_in", junction="centre", movement=LEFT)
    table = rows_of([on_edge("n_out", began=ahead, hit=True)])
    began = {row.place: row.events["hit"] for row in table if row.counted == "began"}
    assert began == {"w_in": 1, "w_in_2": 1, LEFT: 1, "centre": 1}
    decided = {row.place for row in table if row.counted == "decided"}
    assert decided == {"n_out", "n_out_0"}


def test_ranks_put_the_surely_dangerous_first():
    many = [on_edge("w_in", hit=number < 8) for number in range(10)]
    lucky = [on_edge("e_in", hit=True)]
    calm = [on_edge(edge) for edge in ("n_in", "s_in", "n_out", "s_out") for _ in range(10)]
    table = risk.worst(rows_of([*lucky, *many, *calm]))
    assert [row.place for row in table][:2] == ["w_in", "e_in"]
    assert table[0].rank["hit"] == 1
    assert table[0].risk["hit"].low > table[1].risk["hit"].low


def test_equals_have_one_rank():
    table = risk.worst(rows_of([on_edge("w_in", hit=True), on_edge("e_in"), on_edge("n_in")]))
    assert [row.rank["hit"] for row in table] == [1, 2, 2]


def test_ranks_by_another_event():
    harmless = [on_edge("w_in", hit=True, worth=worth_doubles.worth("D")) for _ in range(8)]
    found = [on_edge("e_in", hit=number < 4) for number in range(8)]
    table = rows_of([*harmless, *found])
    assert risk.worst(table)[0].place == "w_in"
    assert risk.worst(table, "finding")[0].place == "e_in"


def test_a_hit_without_known_delta_v_is_not_severe():
    [row] = risk.worst(rows_of([on_edge("w_in", hit=True, delta_v_mps=None)]))
    assert row.events["severe"] == 0
    assert row.delta_v_mps is None
    assert row.events["hit"] == pytest.approx(1)
