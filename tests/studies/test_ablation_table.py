"""Figures of an ablation and their table: every denominator is shown."""

import csv
import itertools

import pytest

from deepmf_sumo.training.evaluation import Evaluation
from deepmf_sumo.training.evaluation.table import Figure, Key
from studies import ablation
from studies.ablation import table

CARDS = {
    "opponent": {"weights": 1000, "hours": 0.5},
    "marginal": {"weights": 200, "hours": 0.1, "steps_made": 30},
    "conditional": {"weights": 34, "hours": 0.05, "steps_made": 20},
}
FIGURES = {
    Key("marginal", "min_fde", 8.0, 6): Figure(4.123, 0.5, 7),
    Key("marginal", "min_fde", 8.0, 16): Figure(2.5, None, 7),
    Key("marginal", "log_likelihood", 8.0): Figure(-3.21, 0.1, 7),
    Key("conditional", "log_likelihood", 8.0, None, "marginal", "av"): Figure(-3.0, 0.1, 3),
    Key("conditional", "log_likelihood_gain", 8.0, None, "given_true", "av"): Figure(0.25, 0.02, 3),
    Key("conditional", "log_likelihood_gain", 8.0, None, "given_shuffled", "av"): Figure(-0.5),
}
EVALUATION = Evaluation(
    data=["val"],
    weights="half",
    scenes=4,
    attacked_scenes=0,
    refused=1,
    refusals=[],
    labelled_objects=7,
    modes=(6, 16, 32),
    clusters="",
    figures=FIGURES,
)


NUMBERS = itertools.count()


def run_of(outcome, rms, *cycles):
    return {
        "spec": f"s{next(NUMBERS)}",
        "scene": "a",
        "status": "ok",
        "outcome": outcome,
        "metrics": {"opponent_rms_acceleration": {"value": rms}},
        "timings": {"plans_ms": [{"marginal": each / 2, "select": each / 2} for each in cycles]},
    }


def unfinished(status):
    return {"status": status, "timings": {"wall_s": 1.0}}


@pytest.fixture
def row():
    results = {
        "idm": [
            run_of("av_opponent", 1.0, 10.0, 20.0),
            run_of("none", None, 60.0),
            run_of("av_other", 2.0),
            unfinished("skipped"),
            unfinished("timeout"),
        ],
        "replay": [unfinished("skipped")],
    }
    return table.row("half", "base", CARDS, EVALUATION, results)


def test_rates_are_of_the_runs_that_succeeded(row):
    idm, replay = row.attacks
    assert (idm.runs, idm.not_ok, idm.failed, idm.hits) == (3, 2, 1, 1)
    assert idm.rate.rate == pytest.approx(1 / 3)
    assert idm.rms_mps2 == pytest.approx(1.5)
    assert (replay.runs, replay.not_ok, replay.failed, replay.rate) == (0, 1, 0, None)
    assert replay.rms_mps2 is None


def test_costs(row):
    assert row.weights == 1234
    assert row.minutes == pytest.approx(9.0)
    assert row.opponent_minutes == pytest.approx(30.0)
    assert (row.cycle_ms, len(row.cycles_ms)) == (20.0, 3)


def test_the_table_shows_what_was_not_measured(row, tmp_path):
    ablation.write(tmp_path, ["What it is of."], [row, row])
    lines = (tmp_path / "ablation.md").read_text(encoding="utf-8").splitlines()
    assert lines[2] == "What it is of."
    assert [one.strip() for one in lines[4].strip("|").split("|")] == table.headings(
        ["idm", "replay"]
    )
    assert lines[6] == lines[7]
    assert [one.strip() for one in lines[6].strip("|").split("|")] == [
        "half", "base", "1,234", "9.0", "4.12 ± 0.50", "2.50", "-", "-3.21 ± 0.10",
        "+0.25 ± 0.02", "-0.50", "20",
        "1/3 (2 not ok) = 0.33 (0.01 to 0.91)", "1.50", "0/0 (1 not ok)", "-",
    ]  # fmt: skip
    with (tmp_path / "ablation.csv").open(newline="", encoding="utf-8") as file:
        first, _ = csv.DictReader(file)
    assert first["idm low"] == "0.0084"
    assert first["replay rate"] == first["min_fde_32_m"] == ""
    assert (first["objects"], first["avs"], first["marginal_steps"]) == ("7", "3", "30")
