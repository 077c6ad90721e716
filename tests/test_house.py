"""The structure that docs/developers/architecture.md promises."""

import ast
from collections import Counter

import pytest

from tests import house
from tests.mutations import MUTATIONS

ROOMS = sorted(one.parent for one in house.PACKAGE.glob("*/__init__.py"))


def test_each_class_has_a_name_of_its_own():
    assert house.repeated_classes() == {}


def test_no_function_takes_more_than_seven_values():
    assert house.long_signatures() == []


@pytest.mark.parametrize("room", ROOMS, ids=lambda one: one.name)
def test_a_room_says_what_it_is_and_why(room):
    doc = ast.get_docstring(ast.parse((room / "__init__.py").read_text())) or ""
    assert len(doc.splitlines()) >= 5


def test_the_architecture_page_lists_all_rooms():
    page = (house.ROOT / "docs" / "developers" / "architecture.md").read_text()
    assert [room.name for room in ROOMS if f"| `{room.name}/`" not in page] == []


def test_files_of_tests_have_names_of_their_own():
    """pytest takes two files of one name in folders without __init__.py for one module."""
    names = [file.name for file in (house.ROOT / "tests").rglob("test_*.py")]
    assert [name for name, count in Counter(names).items() if count > 1] == []


def test_deepmf_has_few_settings_and_one_mapping_of_what_studies_vary():
    keys = house.settings("deepmf")
    assert len(keys) <= 14
    assert [name for name, below in keys.items() if below] == ["form"]
    assert keys["form"] <= 9


def test_what_planted_defects_change_is_there_once():
    """`tests.mutations` fails at a defect whose text has moved; this says so in every run."""
    found = {one.name: (house.PACKAGE / one.file).read_text().count(one.old) for one in MUTATIONS}
    assert {name: count for name, count in found.items() if count != 1} == {}
