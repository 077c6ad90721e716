"""`form: paper`: the method as published, and what contradicts it; numbers that studies vary."""

import pytest
from pydantic import ValidationError

from deepmf_sumo.deepmf.settings import Form, Settings


def test_the_published_form_has_one_opponent_and_the_predictors_modes_alone():
    paper = Settings(form="paper")
    form = paper.form
    assert (paper.rule, form.likelihood_weight, paper.comfort) == ("expected", 1.0, 0.0)
    assert (paper.tried, form.goal_candidates, paper.most_candidates) == (1, 0, None)
    assert (form.candidates, form.reactions) == (32, 6)


@pytest.mark.parametrize(("key", "value"), [("opponent", "sample"), ("rule", "pair")])
def test_what_the_paper_leaves_open_can_be_chosen(key, value):
    assert getattr(Settings(form="paper", **{key: value}), key) == value


def test_the_paper_leaves_the_number_of_modes_open():
    form = Settings(form={"preset": "paper", "candidates": 6, "reactions": 9}).form
    assert (form.preset, form.candidates, form.reactions) == ("paper", 6, 9)
    assert (form.goal_candidates, form.shortlist) == (0, None)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rule", "likeliest"),
        ("sector", "left"),
        ("aggressiveness", 0.5),
        ("constraints", ("fair",)),
        ("opponent", "partner"),
        ("attackers", "people"),
        ("goal", "finding"),
        ("tries", 2),
        ("supporting", 1),
    ],
)
def test_what_contradicts_it_is_refused_by_name(key, value):
    with pytest.raises(ValidationError, match=f"form 'paper' contradicts {key}: "):
        Settings(form="paper", **{key: value})
    Settings(**{key: value})  # ours takes it


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("tried_opponents", 3),
        ("likelihood_weight", 0.1),
        ("comfort_weight", 1.0),
        ("goal_candidates", 16),
        ("shortlist", 32),
        ("conditional", False),
    ],
)
def test_so_are_other_numbers_than_the_published(key, value):
    with pytest.raises(ValidationError, match=f"form 'paper' contradicts {key}: "):
        Settings(form={"preset": "paper", key: value})
    assert getattr(Settings(form={key: value}).form, key) == value


def test_results_record_all_numbers_and_are_read_back():
    for form in ("paper", "extended", {"reactions": 3}):
        settings = Settings(form=form)
        written = settings.model_dump(mode="json")
        assert written["form"].keys() == Form.model_fields.keys()
        assert Settings.model_validate(written) == settings
    assert Settings(form="extended") == Settings(form={}) == Settings()
