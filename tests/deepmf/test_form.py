"""`form: paper`: the method as published, and what contradicts it."""

import pytest
from pydantic import ValidationError

from deepmf_sumo.deepmf.settings import Settings


def test_the_published_form_has_one_opponent_and_the_predictors_modes_alone():
    paper = Settings(form="paper", version="S1")
    assert (paper.rule, paper.likelihood_weight, paper.comfort) == ("expected", 1.0, 0.0)
    assert (paper.tried, paper.goal_candidates, paper.most_candidates) == (1, 0, None)
    assert (paper.candidates, paper.reactions) == (32, 6)


@pytest.mark.parametrize("key", ["opponent", "rule", "version", "candidates", "reactions"])
def test_what_the_paper_leaves_open_can_be_chosen(key):
    chosen = {"opponent": "sample", "rule": "pair", "version": "S2"}
    chosen |= {"candidates": 6, "reactions": 9}
    assert getattr(Settings(form="paper", **{key: chosen[key]}), key) == chosen[key]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rule", "likeliest"),
        ("tried_opponents", 3),
        ("likelihood_weight", 0.1),
        ("comfort_weight", 1.0),
        ("goal_candidates", 16),
        ("shortlist", 32),
        ("conditional", False),
        ("keep_tail", True),
        ("sector", "left"),
        ("aggressiveness", 0.5),
        ("constraints", ("fair",)),
        ("opponent", "partner"),
    ],
)
def test_what_contradicts_it_is_refused_by_name(key, value):
    with pytest.raises(ValidationError, match=f"form 'paper' contradicts {key}: "):
        Settings(form="paper", **{key: value})
    Settings(**{key: value})  # ours takes it


@pytest.mark.parametrize("key", ["fair", "lawful", "no_rear_end"])
def test_a_constraint_that_is_switched_on_contradicts_it(key):
    with pytest.raises(ValidationError, match=f"form 'paper' contradicts constraints: ..{key}"):
        Settings(form="paper", **{key: True})


def test_results_name_the_form_where_it_is_not_ours_and_are_read_back():
    paper = Settings(form="paper", version="S1")
    assert paper.model_dump()["form"] == "paper"
    assert Settings(**paper.model_dump()) == paper
    assert "form" not in Settings().model_dump()
