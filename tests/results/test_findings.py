"""What a hit is worth, and how it is said; results of versions without a ladder."""

from types import SimpleNamespace

import pytest

from deepmf_sumo.cli import _risk_screen
from deepmf_sumo.judge import ladder
from deepmf_sumo.results import findings, gate, junit, quantities
from deepmf_sumo.results.findings import DRIVERS, Worth
from deepmf_sumo.results.gate import thresholds
from deepmf_sumo.results.reader import Run, without_ladder
from deepmf_sumo.study.shrink import search

from tests.support import gate_doubles, worth_doubles


@pytest.mark.parametrize(("rung", "found"), [("A", True), ("B", True), ("C", False), ("D", False)])
def test_the_rung_says_whether_it_is_a_finding(rung, found):
    one = findings.worth(worth_doubles.metrics(rung, by=("search", "cc")))
    assert one == Worth(rung=rung, finding=found, avoided_by=("cc", "search"))
    assert findings.said(one).endswith(f"({rung})")
    assert quantities.BY_NAME["finding_rate"].of(
        gate_doubles.result(hit=True, metrics=valued(worth_doubles.metrics(rung)))
    ) == float(found)


def valued(metrics):
    return {name: {"value": value} for name, value in metrics.items()}


def test_a_miss_counts_zero_and_what_could_not_be_judged_is_left_out():
    rate = quantities.BY_NAME["finding_rate"]
    assert rate.of(gate_doubles.result(metrics=valued({"finding": 0.0, "rung": None}))) == 0.0
    hit = gate_doubles.result(hit=True, metrics=valued({"finding": None, "rung": None}))
    assert rate.of(hit) is None
    assert quantities.worth(hit) is None
    assert quantities.worth(gate_doubles.result(metrics=valued({"finding": 0.0}))) is None


@pytest.mark.parametrize(("valid", "word"), [(1.0, "valid"), (0.0, "not valid")])
def test_a_valid_hit_of_an_earlier_version_counts_as_a_finding(valid, word):
    metrics = {"valid_collision": valid, "avoided_by_cc": 1.0, "avoided_by_search": 0.0}
    one = findings.worth(metrics)
    assert one == Worth(rung=None, finding=valid == 1, avoided_by=("cc",))
    assert findings.said(one) == word
    assert findings.finding(metrics) == valid
    assert findings.earlier(metrics)
    assert not findings.earlier(metrics | {"finding": 0.0})
    assert findings.finding(metrics | {"finding": 0.0}) == 0.0
    assert findings.worth({"avoidable": 1.0}) is None
    assert "1 of 2 hits" in findings.earlier_note(1, 2)
    assert findings.earlier_note(0, 2) == ""


def test_a_gate_and_a_risk_map_say_which_hits_an_earlier_version_judged(tmp_path):
    def hit(scene, **metrics):
        return gate_doubles.result(scene, hit=True, metrics=valued(metrics))

    note = findings.earlier_note(1, 2)
    results = [
        hit("old", valid_collision=1.0), hit("new", finding=1.0, rung=0.0),
        gate_doubles.result("miss", metrics=valued({"valid_collision": 0.0})),
        gate_doubles.failed("broken"),
    ]  # fmt: skip
    assert without_ladder([Run.of_result(tmp_path, one) for one in results]) == note
    out = gate_doubles.write_folder(tmp_path / "mixed", results)
    assert gate.check(out, thresholds.load(None)).notes == [note]
    out = gate_doubles.write_folder(tmp_path / "today", results[1:])
    assert gate.check(out, thresholds.load(None)).notes == []
    judged = [Worth(rung=None, finding=True), worth_doubles.worth("A"), None]
    attacks = [SimpleNamespace(hit=one is not None, worth=one) for one in judged]
    network = SimpleNamespace(name="grid", attacks=attacks, left_out={})
    assert _risk_screen._counted_on(network) == f"grid: 3 attacks; {note}"
    network.attacks = attacks[1:]
    assert _risk_screen._counted_on(network) == "grid: 2 attacks"


def test_hits_are_counted_by_rung_and_every_driver_is_named():
    hits = [
        worth_doubles.worth("A", by=("fsm",)), worth_doubles.worth("B", by=("cc", "search")),
        worth_doubles.worth("B", by=("cc",)), worth_doubles.worth("C", by=("rss",)),
    ]  # fmt: skip
    found = findings.count(hits)
    assert (found.hits, found.findings, found.judged) == (4, 3, 4)
    assert findings.counted(found) == (
        "3 findings: 1 by an error of the AV (A), 2 avoidable (B; avoided by cc 2, search 1); apart"
        " from these 1 contrived (C), 0 unavoidable (D)"
    )
    told = findings.legend(found)
    assert [line.partition(":")[0] for line in told] == ["A", "B", "C", "cc", "search"]
    assert findings.by_whom(worth_doubles.worth("D", by=())) == "no driver"
    assert findings.by_whom(hits[1]) == "cc, search"
    assert findings.by_whom(None) == ""


def test_counts_of_earlier_versions_and_of_what_was_not_judged():
    old = [Worth(rung=None, finding=one) for one in (True, False, False)]
    assert findings.counted(findings.count([*old, None])) == (
        "1 finding: 1 of an earlier version, which knows no ladder (valid hits); apart from these"
        " 2 not valid in an earlier version, 1 not judged"
    )
    assert findings.counted(findings.count([])) == "no findings"
    assert findings.counted(findings.count([None])) == "no findings; apart from these 1 not judged"
    assert findings.legend(findings.count(old)) == []


def test_each_driver_of_the_judge_has_words():
    assert tuple(DRIVERS) == ladder.DRIVERS


@pytest.mark.parametrize(
    ("first", "found", "as_much"),
    [
        (("B", ("cc",)), ("B", ("cc",)), True),
        (("B", ("cc",)), ("B", ("cc", "rss")), True),
        (("B", ("cc", "rss")), ("B", ("cc",)), False),
        (("B", ("cc",)), ("A", ("cc",)), False),
        (("A", ()), ("B", ("cc",)), False),
    ],
)
def test_a_shrunk_hit_is_on_the_same_rung_and_whoever_avoided_it_still_does(first, found, as_much):
    one, other = worth_doubles.worth(*first), worth_doubles.worth(*found)
    assert search._as_much(other, one) == as_much
    assert not search._as_much(None, one)
    assert search._as_much(None, None)


def test_a_test_case_says_what_the_hit_is_worth():
    hit = gate_doubles.result(hit=True, metrics=valued(worth_doubles.metrics("C")))
    assert junit._case(hit).output.startswith("outcome: av_opponent, contrived (C); files: ")
    assert junit._case(gate_doubles.result()).output.startswith("outcome: none; files: ")


def test_the_tries_of_an_attack_are_told_one_after_another():
    assert findings.tried(["miss", "C", "B"]) == "3 tries: miss, hit C, hit B"
    assert findings.tried(["A"]) == findings.tried([]) == ""
