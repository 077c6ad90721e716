"""Who counts as a person is one fact: the table's, the attackers' and the line of sight's."""

from typing import get_args

from deepmf_sumo.deepmf import opponent
from deepmf_sumo.scene import AgentKind
from deepmf_sumo.scene.interface import MadePlace
from deepmf_sumo.scene.road_users import PEOPLE, ROAD_USERS
from deepmf_sumo.spec.model import PERSON_PLACES


def test_people_are_the_kinds_that_are_on_foot_or_on_a_bicycle():
    assert {"pedestrian", "bicycle"} == {name for name, one in ROAD_USERS.items() if one.person}
    assert {one.kind for one in ROAD_USERS.values() if one.person} == set(PEOPLE)
    assert set(PEOPLE) < set(get_args(AgentKind))


def test_everybody_who_may_attack_is_a_vehicle_or_a_person():
    assert opponent.ATTACK["people"] == PEOPLE
    assert set(opponent.ATTACK["all"]) == {"vehicle", *PEOPLE}


def test_a_made_person_is_where_a_spec_may_ask_for_or_where_it_is_put():
    assert set(get_args(MadePlace)) == {*PERSON_PLACES, "given"}
