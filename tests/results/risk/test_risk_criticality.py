"""Means of few attacks, drawn to the typical place."""

import itertools

import numpy as np
import pytest

from deepmf_sumo.results import risk, statistics
from deepmf_sumo.results.quantities import criticality
from deepmf_sumo.results.risk import places
from deepmf_sumo.results.risk.places import Spot
from deepmf_sumo.results.statistics import ranks

from tests.support.risk_doubles import NET


def drawn(groups):
    units = {
        name: statistics.units_of([value] for value in values) for name, values in groups.items()
    }
    return statistics.place_means(units)


@pytest.mark.parametrize(
    ("spare_s", "value"), [(0.0, 1.0), (1.0, 0.8), (5.0, 0.0), (9.0, 0.0), (None, 0.0)]
)
def test_five_seconds_to_spare_are_no_conflict(spare_s, value):
    assert criticality(spare_s) == pytest.approx(value)


def test_what_differs_by_chance_alone_is_drawn_to_the_typical_place():
    rng = np.random.default_rng(3)
    out, kept = 0, []
    for _ in range(40):
        groups = {str(name): rng.uniform(0.0, 1.0, 8).tolist() for name in range(10)}
        found = drawn(groups)
        means, shrunk = zip(*((one.mean, one.shrunk) for one in found.values()), strict=True)
        kept.append(np.std(shrunk) / np.std(means))
        out += sum(one.stands_out for one in found.values())
    assert out <= 0.05 * 400
    assert np.mean(kept) < 0.7


def test_a_place_that_is_worse_in_all_its_attacks_stands_out_and_one_attack_does_not():
    groups = {str(name): [0.0, 0.1] * 4 for name in range(9)} | {"worse": [0.6, 0.7, 0.6, 0.8]}
    found = drawn(groups)
    assert found["worse"].stands_out
    assert [name for name, one in found.items() if one.stands_out] == ["worse"]
    assert 0.4 < found["worse"].excess < 0.63
    noisy = {str(name): [0.0] * 6 + [1.0] * 2 for name in range(9)}
    once = drawn({**noisy, "once": [1.0]})["once"]
    assert not once.stands_out
    assert once.shrunk < 0.7 * once.mean


def test_places_that_cannot_be_told_from_the_typical_one_share_a_rank():
    near_misses = {str(name): [0.0] * 7 + [0.1 * name] for name in range(8)}
    found = drawn({**near_misses, "worse": [0.6] * 8, "worst": [0.9] * 8})
    assert len({one.excess for one in found.values()}) == 10
    rank = ranks({name: one.surely for name, one in found.items()})
    assert (rank["worst"], rank["worse"]) == (1.0, 2.0)
    assert {rank[name] for name in near_misses} == {6.5}
    assert sum(rank.values()) == 55
    assert ranks({}) == {}


def test_more_attacks_are_drawn_less():
    rng = np.random.default_rng(0)
    alike = {str(name): rng.uniform(0, 0.4, 8).tolist() for name in range(8)}
    few, many = (drawn({**alike, "a": [0.6, 0.8] * count})["a"] for count in (1, 20))
    assert few.excess < many.excess <= 0.7
    assert few.high - few.low > many.high - many.low


def test_a_place_without_attacks_is_typical():
    found = drawn({"a": [0.2, 0.4], "b": [0.3, 0.3], "none": []})
    assert found["none"].attacks == 0
    assert found["none"].excess == 0.0
    assert drawn({}) == {}
    assert not drawn({"none": []})["none"].stands_out


NUMBERS = itertools.count()


def attack(edge, value):
    spot = Spot(lane=f"{edge}_0", edge=edge)
    return risk.Attacked(
        folder="out", run_id=f"m--{next(NUMBERS)}--0", turn=None, scene="s", seed=0,
        decided=spot, began=spot, place_m=(0.0, 0.0), hit=False, other=False, worth=None,
        ttc_s=None, gap_m=1.0, delta_v_mps=None, criticality=value,
    )  # fmt: skip


def test_the_table_has_it_by_place_and_leaves_out_what_was_not_measured():
    attacks = [attack("w_in", value) for value in (0.9, 0.8, 1.0, None) * 4]
    attacks += [attack(edge, 0.1) for edge in ("e_in", "n_in", "n_in", "e_in") * 4]
    attacks += [attack("n_out", None)]
    network = risk.Network(
        name="city", net_file=NET, places=places.read(NET), attacks=tuple(attacks), left_out={}
    )
    found = {
        row.place: risk.columns(row)
        for row in risk.rows(network)
        if row.kind == "edge" and row.counted == "began"
    }
    west = found["w_in"]
    assert west["criticality_lo"] < west["criticality"] < west["criticality_hi"]
    assert 0.5 < west["criticality"] <= 0.9
    assert found["e_in"]["criticality"] < 0.3
    assert found["n_out"]["criticality"] is None
    assert found["w_in"]["rank_criticality"] == 1.0
    assert found["e_in"]["rank_criticality"] == found["n_in"]["rank_criticality"] == 2.5
    assert found["n_out"]["rank_criticality"] is None
