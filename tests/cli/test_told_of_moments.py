"""What is said of the moments that are chosen, and where nothing came near."""

from types import SimpleNamespace

import pytest

from deepmf_sumo.cli import _moments as told
from deepmf_sumo.study.moments import FoundMoments
from deepmf_sumo.study.moments.moment import Flow, WantedMoments


def run(ttc_s=None, outcome="none", status="ok", opponent="foe"):
    metrics = {"ttc_min": {"value": ttc_s}}
    return {"status": status, "outcome": outcome, "opponent": opponent, "metrics": metrics}


def looked(where="", near=(3, 8)):
    flows = [
        Flow(edge=f"e{at}", following="", vehicles=9, near=many) for at, many in enumerate(near)
    ]
    flows.append(Flow(edge="e0", following="e1", vehicles=20, near=20))
    found = FoundMoments(
        moments=(), suitable=1, vehicles=2, begin_s=0.0, until_s=9.0, complete=True,
        flows=tuple(flows),
    )  # fmt: skip
    return [(SimpleNamespace(wish=WantedMoments(count=10, where=where)), found)]


def test_ten_attacks_without_a_conflict_say_so_and_what_may_find_one():
    text = told.no_conflict([run(4.0), *[run()] * 9], looked())
    assert text == (
        "no conflict in 10 attacks: no contact of the AV, and no time to collision of 1.5 s or"
        " less. Up to 31 % of other moments may have one. What may find it: the edge where most"
        " have others near them (--edge e1: 8 vehicles), more attacks (--moments 40), more traffic"
        " (-- --scale 2)"
    )


@pytest.mark.parametrize("asked", [looked("edge e0"), looked(near=(0, 0)), looked() * 2, []])
def test_no_edge_is_named_where_none_is_better(asked):
    text = told.no_conflict([run()], asked)
    assert "What may find it: more attacks (--moments 4), more traffic" in text


@pytest.mark.parametrize(
    "results",
    [
        [run(), run(1.5)],
        [run(outcome="av_opponent")],
        [],
        [run(opponent=None)],
        [run(status="failed")],
    ],
)
def test_a_conflict_or_no_attack_at_all_says_nothing(results):
    assert told.no_conflict(results, looked()) == ""


@pytest.mark.parametrize(
    ("count", "pool", "words"),
    [
        (30, 120, "30 moments of 120: 10 spread, 20 drawn where conflicts come near; of all 120"),
        (30, 12, "12 moments of 12: 12 spread, 0 drawn where conflicts come near; of all 12"),
    ],
)
def test_how_many_are_spread_and_how_many_are_drawn(count, pool, words):
    assert told._drawn(count, pool) == words
