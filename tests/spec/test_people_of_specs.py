"""``source.people``: a word or a mapping, left out where it says nothing new."""

from pathlib import Path

import pytest

from deepmf_sumo import spec
from deepmf_sumo.errors import SpecError
from deepmf_sumo.spec import PERSON_PLACES, WantedPeople

ROOT = Path(__file__).resolve().parents[2]
NETWORK = ROOT / "sumo_nets" / "four_way" / "four_way.sumocfg"


def loaded(tmp_path, people, more="start_s: 3.0\n  av: {vehicle: a}"):
    file = tmp_path / "one.yaml"
    said = "" if people is None else f"\n  people: {people}"
    file.write_text(f"version: 3\nname: one\nsource:\n  network: {NETWORK}\n  {more}{said}\n")
    return spec.load(file)


def refused(tmp_path, *given):
    with pytest.raises(SpecError) as error:
        loaded(tmp_path, *given)
    return str(error.value)


@pytest.mark.parametrize("people", [None, "existing"])
def test_specs_without_made_people_are_written_as_before(tmp_path, people):
    one = loaded(tmp_path, people)
    assert "people" not in one.resolved()["source"]
    assert not one.source.people.made
    assert one.source.people.own


def test_a_word_and_a_mapping_say_the_same(tmp_path):
    word, mapping = loaded(tmp_path, "made"), loaded(tmp_path, "{who: made}")
    assert word == mapping
    assert word.source.people == WantedPeople(who="made", count=3, places=PERSON_PLACES)
    assert word.resolved()["source"]["people"] == "made"
    assert not word.source.people.own
    assert loaded(tmp_path, "both").source.people.own


def test_what_is_written_is_read_again(tmp_path):
    text = "{count: 2, places: [kerb, stop], who: both}"
    one = loaded(tmp_path, text)
    again = loaded(tmp_path, one.resolved()["source"]["people"])
    assert again == one


def test_chosen_moments_keep_it(tmp_path):
    one = loaded(tmp_path, "{count: 2}", "moments: {count: 4}")
    assert one.source.at(3.0, "a").people.count == 2


@pytest.mark.parametrize(
    ("people", "told"),
    [
        ("some", "source.people"),
        ("{who: made, places: [roof]}", "'roof'"),
        ("{count: 0}", "source.people.count"),
        ("{who: existing, count: 2}", "is for made people"),
        ("{where: kerb}", "unknown key"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path, people, told):
    said = refused(tmp_path, people)
    assert told in said
    assert "\n" not in said


def test_given_people_are_for_one_moment(tmp_path):
    given = "{given: [{position_m: [1, 2], heading_rad: 0.0}]}"
    assert loaded(tmp_path, given).source.people.given[0].position_m == (1.0, 2.0)
    assert "is for one moment" in refused(tmp_path, given, "moments: {count: 4}")


def test_recordings_have_their_own_people(tmp_path):
    file = tmp_path / "recorded.yaml"
    file.write_text(f"version: 3\nname: one\nsource: {{recording: {tmp_path}, people: made}}\n")
    with pytest.raises(SpecError, match="a recording has its own people"):
        spec.load(file)
