"""Who may attack, and who of them is chosen."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.opponent import least_time_s, named, reach_scores, tried
from deepmf_sumo.errors import PluginError, RunError
from deepmf_sumo.scene import Forecast, Futures
from deepmf_sumo.scene.road_users import ROAD_USERS

from tests.support.one_attacker import plan_of
from tests.support.people_views import people_policy, people_view

UP = np.pi / 2
STREET = {
    "av": ("vehicle", 0, 0, 0, 10.0),
    "car": ("vehicle", -12, 3.5, 0, 10.0),
    "walker": ("pedestrian", 35, -4, UP, 1.4),
    "rider": ("cyclist", 20, -2.5, 0, 4.0),
    "tram": ("other", 10, 10, 0, 0.0),
}
WALKS = ROAD_USERS["pedestrian"].motion


def chosen_of(attackers, **values):
    made = people_policy(attackers=attackers, **values)
    (found,) = made.reset(people_view(STREET), np.random.default_rng(0)) or (None,)
    return found, made


def straight_on(speed, steps=80):
    along = speed * 0.1 * np.arange(1, steps + 1)
    position = np.stack([along, np.zeros(steps)], -1)[None]
    futures = Futures(agent_id="av", position_m=position, heading_rad=np.zeros((1, steps)))
    return Forecast(futures=futures, probability=np.ones(1))


@pytest.mark.parametrize(
    ("attackers", "ids"),
    [
        ("vehicles", {"car"}),
        ("people", {"walker", "rider"}),
        ("all", {"car", "walker", "rider"}),
    ],
)
def test_the_candidates_are_of_the_classes_that_may_attack(attackers, ids):
    found, made = chosen_of(attackers)
    assert set(plan_of(made, people_view(STREET)).reason.scores.ids) == ids
    assert found in ids


def test_a_person_attacks_where_people_are_asked_for():
    found, made = chosen_of("people")
    assert found in {"walker", "rider"}
    assert plan_of(made, people_view(STREET)).agent_id == found


@pytest.mark.parametrize("name", ["walker", "rider"])
def test_a_named_person_attacks_whoever_is_chosen_from(name):
    assert chosen_of("vehicles", opponent=name)[0] == name


@pytest.mark.parametrize("name", ["tram", "av", "nobody"])
def test_neither_trams_nor_the_av_are_named(name):
    with pytest.raises(RunError, match="is not a road user near the AV"):
        chosen_of("all", opponent=name)


def test_other_methods_are_told_that_they_attack_with_vehicles():
    with pytest.raises(
        RunError, match=r"'walker' is not a vehicle near the AV .* name one of: car"
    ):
        named(people_view(STREET), "walker")


def test_the_published_form_chooses_vehicles():
    with pytest.raises(PluginError, match="form 'paper' contradicts attackers: 'people'"):
        plugins.settings("adversaries", "deepmf", {"form": "paper", "attackers": "people"})


def test_results_say_who_may_attack_only_where_it_is_not_the_default():
    said = [
        plugins.settings("adversaries", "deepmf", values).model_dump()
        for values in ({}, {"attackers": "all"})
    ]
    assert "attackers" not in said[0]
    assert said[1]["attackers"] == "all"


def test_who_can_be_in_the_way_in_time_scores_before_who_cannot():
    view = people_view(
        {
            "av": ("vehicle", 0, 0, 0, 10.0),
            "at the kerb": ("pedestrian", 30, -3, UP, 0.0),
            "too far aside": ("pedestrian", 12, -40, UP, 0.0),
            "behind": ("pedestrian", -20, -3, UP, 0.0),
        }
    )
    scores = reach_scores(view, straight_on(10.0))
    found = dict(zip(scores.ids, scores.logits, strict=True))
    assert found["at the kerb"] > 3 + max(found["too far aside"], found["behind"])


def test_a_person_on_its_way_to_the_av_scores_before_one_who_walks_away():
    view = people_view(
        {
            "av": ("vehicle", 0, 0, 0, 10.0),
            "comes": ("pedestrian", 30, -4, UP, 1.4),
            "goes": ("pedestrian", 30, 4, UP, 1.4),
        }
    )
    scores = reach_scores(view, straight_on(10.0))
    assert scores.ids[int(np.argmax(scores.logits))] == "comes"


def test_the_scores_do_not_depend_on_the_frame():
    view = people_view(STREET)
    turned = people_view(
        {
            name: (kind, -y + 100, x - 50, heading + UP, speed)
            for name, (kind, x, y, heading, speed) in STREET.items()
        }
    )
    ahead = straight_on(10.0)
    where = ahead.futures.position_m
    there = Futures(
        agent_id="av",
        position_m=np.stack([-where[..., 1] + 100, where[..., 0] - 50], -1),
        heading_rad=ahead.futures.heading_rad + UP,
    )
    one = reach_scores(view, ahead)
    other = reach_scores(turned, Forecast(futures=there, probability=np.ones(1)))
    assert one.ids == other.ids
    np.testing.assert_allclose(one.logits, other.logits, atol=1e-9)


def test_nobody_is_scored_who_is_no_person_or_far_away():
    view = people_view(STREET | {"far": ("pedestrian", 90, 0, 0, 0.0)})
    assert set(reach_scores(view, straight_on(10.0)).ids) == {"walker", "rider"}


@pytest.mark.parametrize(
    ("distance", "towards", "seconds"),
    [
        (0.0, 0.0, 0.0),
        (0.8, 0.0, 1.0),  # d = a t^2 / 2
        (1.4, 1.4, 0.7111),  # 1.4 t + 0.8 t^2 = 1.4
        (3.5**2 / 3.2 + 7.0, 0.0, 3.5 / 1.6 + 2.0),  # up to 3.5 m/s, then 7 m at that
        (0.0, -2.0, 1.0 + (2 * 1.0 / 1.6) ** 0.5),  # stops after 1 m and 1 s, and comes back
    ],
)
def test_the_least_time_by_hand(distance, towards, seconds):
    found = least_time_s(np.array(distance), np.array(towards), WALKS)
    assert float(found) == pytest.approx(seconds, abs=1e-3)


@pytest.mark.parametrize(
    ("ranked", "count", "expected"),
    [
        (["car", "walker", "rider"], 1, ["car"]),
        (["car", "van", "walker"], 2, ["car", "walker"]),
        (["walker", "rider", "car"], 2, ["walker", "car"]),
        (["car", "walker", "van"], 2, ["car", "walker"]),
        (["car", "van"], 3, ["car", "van"]),
    ],
)
def test_of_several_to_try_each_class_has_its_first(ranked, count, expected):
    view = people_view(STREET | {"van": ("vehicle", 40, 0, 0, 5.0)})
    assert tried(view, ranked, count) == expected
