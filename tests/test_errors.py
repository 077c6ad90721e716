"""Exit codes."""

import pytest

from deepmf_sumo.errors import EXIT_CODES, exit_code, worst


@pytest.mark.parametrize(
    ("endings", "code"),
    [
        ((), 0),
        (("fine",), 0),
        (("broken", "fine"), 1),
        (("broken", "failed"), 3),
        (("failed", "wrong", "broken"), 2),
        (("wrong", "interrupted"), 130),
    ],
)
def test_the_most_important_ending_decides(endings, code):
    assert exit_code(*endings) == code
    assert exit_code(*reversed(endings)) == code


def test_the_codes_are_those_of_the_docs():
    assert EXIT_CODES == {"interrupted": 130, "wrong": 2, "failed": 3, "broken": 1, "fine": 0}


@pytest.mark.parametrize(
    ("codes", "code"),
    [((), 0), ((0, 0), 0), ((0, 1), 1), ((1, 3), 3), ((3, 2), 2), ((2, 130, 3), 130)],
)
def test_the_most_important_of_several_commands_decides(codes, code):
    assert worst(*codes) == worst(*reversed(codes)) == code
