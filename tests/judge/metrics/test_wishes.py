"""What the metrics say about wishes: the wanted sector, and wishes that no candidate met."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import policy
from deepmf_sumo.scene import Contact

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, rollout_of, straight

AGENTS = {"av": (0, 0, 0, 10.0), "b": (-18, 0, 0, 12.0)}


def plan(**values):
    settings = plugins.settings("adversaries", "deepmf", {"opponent": "b", **values})
    made = policy.build(settings, Doubles())
    view = view_of(AGENTS)
    made.reset(view, np.random.default_rng(0))
    return plan_of(made, view)


def contact(sector):
    return Contact(
        kind="av_opponent",
        step=40,
        first_id="av",
        second_id="b",
        striker_id="b",
        pose_first=np.zeros(3),
        pose_second=np.zeros(3),
        relative_mps=3.0,
        closing_mps=3.0,
        sector=sector,
        delta_v_mps=1.5,
    )


def measured(name, plans, contacts=()):
    paths = {"av": straight(0, 0, 10), "b": straight(-18, 0, 12)}
    rollout = rollout_of(paths, contacts, plans=plans)
    return plugins.load("metrics", name).measure(rollout, case_of(paths))


@pytest.mark.parametrize(("sector", "value"), [(4, 1.0), (3, 0.0), (None, 0.0)])
def test_a_hit_counts_where_it_was_wanted(sector, value):
    contacts = [] if sector is None else [contact(sector)]
    assert measured("wanted_sector_hit", [plan(sector="rear")], contacts).value == value


def test_share_of_plans_whose_wish_nobody_met():
    met = plan(sector="rear")
    reason = replace(met.reason, unmet=("sector",))
    unmet = replace(met, reason=reason)
    assert met.reason.unmet == ()
    assert measured("unmet_wishes", [met, unmet, met, met]).value == 0.25
    assert measured("unmet_wishes", [plan(constraints=["fair"])]).value in (0.0, 1.0)
    # all that it could do is to ram the AV from behind
    assert measured("unmet_wishes", [plan(constraints=["lawful"])]).value == 1.0


@pytest.mark.parametrize("name", ["unmet_wishes", "wanted_sector_hit"])
def test_without_a_wish_there_is_a_reason(name):
    assert "wanted" in measured(name, [plan()]).reason or "wishes" in measured(name, []).reason
    assert measured(name, [plan()]).value is None
    assert measured(name, []).value is None
