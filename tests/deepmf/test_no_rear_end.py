"""Which pairs are rams from behind, and what `no_rear_end` does to a plan and to `attack`."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from deepmf_sumo import plugins
from deepmf_sumo.cli import main
from deepmf_sumo.datatypes import Forecast, Futures
from deepmf_sumo.deepmf.candidates import collisions, rear_ends
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.errors import UsageError
from deepmf_sumo.moments import search

from tests.support.predictor_doubles import Doubles, view_of

SUMO_CONFIG = Path(__file__).resolve().parents[2] / "sumo_nets" / "four_way" / "four_way.sumocfg"
CAR_M = np.array([4.8, 2.0])
BEHIND = {"av": (0, 0, 0, 10.0), "near": (-9, 0.0, 0, 14.0), "far": (60, -40, np.pi / 2, 9.0)}
BESIDE = {"av": (0, 0, 0, 10.0), "near": (-3, 3.5, 0, 12.0), "far": (60, -40, np.pi / 2, 9.0)}


def straight(x, y, heading, speed, steps=30):
    way = np.arange(1, steps + 1)[:, None] * 0.1 * speed
    position = np.array([x, y]) + way * [np.cos(heading), np.sin(heading)]
    return Futures(
        agent_id="b", position_m=position[None], heading_rad=np.full((1, steps), heading)
    )


@pytest.mark.parametrize(
    ("opponent", "expected"),
    [
        ((-12, 0.5, 0.0, 15.0), True),  # the follower
        ((12, 0.5, 0.0, 2.0), False),  # a leader that is too slow
        ((20, -20, np.pi / 2, 10.0), False),  # from the side
        ((-1, 2.6, -0.15, 10.5), False),  # a neighbour that comes over
        ((-9, -4.0, 0.35, 16.0), True),  # from the next lane into the rear end
        ((40, 0.0, np.pi, 10.0), False),  # oncoming
    ],
)
def test_a_ram_is_an_impact_on_the_rear_end_in_the_same_direction(opponent, expected):
    """And nothing changes if all is turned."""
    for turn in (0.0, 2.4):
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, heading, speed = opponent
        own = straight(cos * x - sin * y, sin * x + cos * y, heading + turn, speed)
        av = [Forecast(futures=straight(0, 0, turn, 10.0), probability=np.ones(1))]
        collides, step = collisions(own, av, CAR_M, CAR_M, 30)
        assert collides.all()
        assert rear_ends(own, av, CAR_M, CAR_M, step).tolist() == [[expected]]


def test_pairs_without_a_contact_are_no_rams():
    own, av = straight(-12, 0, 0.0, 9.0), straight(0, 0, 0.0, 10.0)
    step = np.full((1, 1), 30.0)
    alone = [Forecast(futures=av, probability=np.ones(1))]
    assert not rear_ends(own, alone, CAR_M, CAR_M, step).any()


def plan(agents, **values):
    made = build(plugins.settings("policies", "deepmf", values), Doubles())
    view = view_of(agents)
    made.reset(view, np.random.default_rng(0))
    return made.plan(view).reason


def test_a_follower_does_not_ram_and_others_still_attack():
    rams = plan(BEHIND, opponent="near")
    assert rams.collides[rams.chosen].any()
    kept = plan(BEHIND, opponent="near", no_rear_end=True)
    allowed = kept.allowed["no_rear_end"]
    assert not allowed.all()
    assert kept.unmet == ("no_rear_end",) or allowed[kept.chosen]
    if kept.unmet:
        mass = kept.collision_mass
        assert kept.rule == "nothing no_rear_end"
        assert mass[kept.chosen] == pytest.approx(mass.min())
    beside = plan(BESIDE, opponent="near", no_rear_end=True)
    assert beside.collides[beside.chosen].any()
    assert beside.allowed["no_rear_end"][beside.chosen]


def test_it_contradicts_a_wish_for_the_rear_and_the_published_form():
    for values in ({"sector": "rear"}, {"sector": 4}, {"form": "paper"}):
        with pytest.raises(ValidationError, match="contradict"):
            Settings(no_rear_end=True, **values)
    assert "no_rear_end" not in Settings().model_dump(mode="json")
    assert Settings(no_rear_end=True).model_dump(mode="json")["no_rear_end"] is True


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([], True),
        (["adversary=S2"], True),
        (["adversary.no_rear_end=false"], False),
        (["adversary.sector=rear"], None),
        (["adversary.lawful=true"], None),
        (["adversary={name: deepmf, form: paper}"], None),
        (["adversary.constraints=[no_rear_end]"], None),
        (["adversary=brs"], None),
    ],
)
def test_attack_asks_for_it_unless_something_else_is_said(sets, expected):
    [document] = search.documents([SUMO_CONFIG], {}, sets)
    spec = search.spec_of(document)
    assert spec.adversary.settings.get("no_rear_end") is expected
    if expected:
        assert document.values["adversary"]["no_rear_end"] is True
    [plain] = search.documents([SUMO_CONFIG], {}, sets)
    if sets and "constraints" in sets[0]:
        with pytest.raises(UsageError, match="leave one of them out"):
            search.spec_of(plain, all_conflicts=True)
        return
    allowed = search.spec_of(plain, all_conflicts=True).adversary.settings.get("no_rear_end")
    assert allowed is (False if expected is False else None)


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([], ["on_road"]),
        (["adversary.constraints=[]"], []),
        (["adversary.constraints=[clean]"], ["clean"]),
        (["adversary.lawful=true"], None),
        (["adversary.goal=avoidable"], None),
        (["adversary={name: deepmf, form: paper}"], None),
        (["adversary=brs"], None),
    ],
)
def test_attack_stays_on_the_road_unless_constraints_are_given(sets, expected):
    for all_conflicts in (True, False):
        [document] = search.documents([SUMO_CONFIG], {}, sets)
        spec = search.spec_of(document, all_conflicts=all_conflicts)
        by_default = expected == ["on_road"] and not all_conflicts
        more = ["with_traffic"] if by_default else []
        found = spec.adversary.settings.get("constraints")
        assert found == (None if expected is None else expected + more)


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([], True),
        (["adversary.fair=false"], False),
        (["adversary.no_rear_end=false"], True),
        (["adversary.sector=front"], True),
        (["adversary.sector=rear"], None),  # which hardly any driver avoids
        (["adversary.constraints=[fair]"], None),
        (["adversary.goal=avoidable"], None),  # which asks for more
        (["adversary.lawful=true"], None),
        (["adversary={name: deepmf, form: paper}"], None),
        (["adversary=brs"], None),
    ],
)
def test_attack_is_fair_unless_something_else_is_said(sets, expected):
    [document] = search.documents([SUMO_CONFIG], {}, sets)
    assert search.spec_of(document).adversary.settings.get("fair") is expected
    [document] = search.documents([SUMO_CONFIG], {}, sets)
    allowed = search.spec_of(document, all_conflicts=True).adversary.settings.get("fair")
    assert allowed is (False if expected is False else None)


def test_all_conflicts_and_no_rear_end_contradict_each_other(tmp_path, capsys):
    arguments = ["--all-conflicts", "--set", "adversary.no_rear_end=true"]
    out = ["--out", str(tmp_path / "out")]
    assert main._run(["attack", str(SUMO_CONFIG), *arguments, *out]) == 2
    assert "leave one of them out" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
