"""Opponents in turn: what the result and the tables say of each, and of the run."""

import csv
import io
from dataclasses import replace

import pytest

from deepmf_sumo import spec
from deepmf_sumo.results import result, turns
from deepmf_sumo.scene import Attack, MetricValue, Turn, TurnRules
from deepmf_sumo.spec.tasks import Task

from tests.support import tiny_network
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight


def turn(opponent, first, last, ended, gap):
    return Turn(opponent_id=opponent, first_step=first, last_step=last, ended=ended, gap_m=gap)


@pytest.fixture
def rollout():
    paths = {"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12), "c": straight(30, 0, 5)}
    found = rollout_of(paths, [replace(contact_of(step=70), second_id="c")], opponent_id="c")
    spent = turn("b", 10, 50, "harmless", 1.5), turn("c", 60, 70, "contact", 0.0)
    return replace(found, turns=spent)


@pytest.fixture
def case():
    return replace(case_of(), duration_steps=80, turns=TurnRules(longest_s=5.0))


@pytest.fixture
def task(tiny):
    more = {"opponents": "in_turn", "turns": "{longest_s: 5.0}"}
    path = tiny_network.spec(tiny, "several", **more)
    return Task(run_id="several--tiny--0", spec=spec.load(path), scene="tiny")


def measure(rollout, case):
    """What a metric sees: the agents there, the time of the turn, who attacks."""
    values = {"now": rollout.now, "time": case.duration_steps, "last": rollout.tracks.steps - 1}
    found = [
        MetricValue(name=name, value=value, unit="", better="") for name, value in values.items()
    ]
    return [*found, MetricValue(name="none", value=None, unit="", better="", reason="no")]


def test_each_turn_is_measured_by_itself(rollout, case):
    first, second = turns.judged(rollout, case, measure)
    assert first["metrics"] == {"now": 10, "time": 50, "last": 50, "none": None}
    assert second["metrics"] == {"now": 60, "time": 30, "last": 70, "none": None}
    assert (first["begin_s"], first["end_s"], first["ended"]) == (0.0, 4.0, "harmless")
    assert (second["outcome"], second["hit_speed_mps"]) == ("av_opponent", 4.5)
    assert (first["outcome"], first["hit_speed_mps"]) == ("none", None)
    alone = replace(rollout, turns=())
    assert turns.judged(alone, replace(case, turns=None), measure) is None


def test_the_run_has_the_numbers_of_the_decisive_turn(rollout, case, task):
    cut, its_case = turns.decisive_part(rollout, case)
    assert (cut.opponent_id, cut.now, its_case.duration_steps) == ("c", 60, 30)
    by_turn = turns.judged(rollout, case, measure)
    metrics = measure(cut, its_case)
    found = result.finished(task, case, Attack(rollout=rollout), metrics, 0.0, by_turn)
    row = result.row(found)
    assert (row["turns"], row["turn_hits"], row["opponent"]) == ("2", "1", "c")
    assert (row["contact_time_s"], row["outcome"]) == ("6", "av_opponent")
    assert found["metrics"]["now"]["value"] == 60
    assert len(found["samples"]["opponent_m"]) == 3  # twice a second from the turn's begin


def test_without_any_turn_the_episode_itself_is_measured(rollout, case):
    nobody = replace(rollout, turns=(), attackers=())
    assert turns.decisive_part(nobody, case) == (nobody, case)
    assert turns.judged(nobody, case, measure) == []


def test_table_has_a_row_a_turn(rollout, case, task):
    found = result.finished(
        task, case, Attack(rollout=rollout), [], 0.0, turns.judged(rollout, case, measure)
    )
    other = result.unfinished(task, "failed", "no reason")
    rows = list(csv.DictReader(io.StringIO(turns.table([other, found]))))
    assert [(row["turn"], row["opponent"], row["now"], row["none"]) for row in rows] == [
        ("1", "b", "10", ""),
        ("2", "c", "60", ""),
    ]
    assert {row["run_id"] for row in rows} == {"several--tiny--0"}
    assert turns.table([other]) is None


def test_results_of_one_opponent_say_nothing_of_turns(rollout, case, task):
    one = replace(rollout, turns=())
    found = result.finished(task, replace(case, turns=None), Attack(rollout=one), [], 0.0)
    assert "turns" not in found
    assert (result.row(found)["turns"], result.row(found)["turn_hits"]) == ("", "")
