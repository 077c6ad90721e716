"""Which causes are a planted fault's own: the list fits the faults and the causes that exist."""

from typing import get_args

import pytest

from deepmf_sumo.judge.causes import CHANGES
from deepmf_sumo.judge.conflict_types import TYPES, Side
from studies.planner_faults.faults import FAULTS
from studies.planner_faults.own_causes import accepted, own

KNOWN = {
    "change": set(CHANGES),
    "conflict": set(TYPES),
    "side": set(get_args(Side)),
    "opponent": {"car", "truck or bus", "motorcycle", "bicycle", "pedestrian"},
    "stood": {True},
    "over": {True},
}


def test_each_fault_has_alternatives_of_facts_that_exist():
    assert set(accepted()) == set(FAULTS)
    for alternatives in accepted().values():
        assert alternatives
        for one in alternatives:
            assert one["change"]  # no fault is recognised by the situation alone
            assert all(set(values) <= KNOWN[key] for key, values in one.items())


@pytest.mark.parametrize(
    ("fault", "changed", "expected"),
    [
        ("weak_brakes", {"change": "brakes harder"}, True),
        ("weak_brakes", {"change": "reacts"}, False),
        ("blind_left", {"change": "reacts"}, True),
        ("blind_left", {"change": "reacts", "side": "right"}, False),
        ("no_standing", {"change": "reacts", "stood": True}, True),
        ("no_standing", {"change": "reacts"}, False),
        ("no_trucks", {"change": "sees the danger"}, False),
        ("no_trucks", {"change": "sees the danger", "opponent": "truck or bus"}, True),
        ("speeding", {"change": "drives 20 % slower", "over": True}, True),
        ("speeding", {"change": "drives 20 % slower"}, False),
    ],
)
def test_a_cause_is_own_if_it_has_all_facts_of_an_alternative(fault, changed, expected):
    known = {"conflict": "crossing", "side": "left", "opponent": "car", "stood": False,
             "over": False}  # fmt: skip
    assert own(fault, known | changed) is expected
