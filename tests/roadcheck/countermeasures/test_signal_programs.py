"""Signal programs after a change, phase by phase, written down by hand."""

import xml.etree.ElementTree as ET

import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.roadcheck.countermeasures import signals
from deepmf_sumo.roadcheck.countermeasures.document import Change


def program(cycle, **values):
    """A ``tlLogic`` of phases ``seconds:state``."""
    found = ET.Element("tlLogic", id="a", programID="0", **values)
    for phase in cycle.split():
        seconds, state = phase.split(":")
        ET.SubElement(found, "phase", duration=seconds, state=state)
    return found


def after(phases, lefts=(), foes=(), **keys):
    meet = {frozenset(pair) for pair in foes}
    _, found = signals.changed(
        "a", program(phases), Change(signal="a", **keys), lefts,
        lambda one, other: frozenset((one, other)) in meet,
    )  # fmt: skip
    return " ".join(map(str, found))


@pytest.mark.parametrize(
    ("cycle", "keys", "wanted"),
    [
        # nothing between conflicting greens: both are put in, and the cycle stays 30 s
        (
            "15:GGrr 15:rrGG",
            {"yellow_s": 3.0, "all_red_s": 2.0},
            "10:GGrr 3:yyrr 2:rrrr 10:rrGG 3:rryy 2:rrrr",
        ),
        ("31:GGrr 3:yyrr 31:rrGG 3:rryy", {"yellow_s": 4.0}, "30:GGrr 4:yyrr 30:rrGG 4:rryy"),
        ("31:GGrr 5:yyrr 31:rrGG 5:rryy", {"yellow_s": 4.0}, "31:GGrr 5:yyrr 31:rrGG 5:rryy"),
        # one way keeps its green while the other ends
        (
            "31:GGrr 3:yGrr 20:rGGr 3:ryyr 30:rrrG 3:rrry",
            {"all_red_s": 1.0},
            "30:GGrr 3:yGrr 1:rGrr 19:rGGr 3:ryyr 1:rrrr 29:rrrG 3:rrry 1:rrrr",
        ),
        (
            "31:GGrr 3:yyrr 1:rrrr 31:rrGG 3:rryy 1:rrrr",
            {"all_red_s": 2.0, "yellow_s": 4.0, "cycle": "longer"},
            "31:GGrr 4:yyrr 2:rrrr 31:rrGG 4:rryy 2:rrrr",
        ),
    ],
)
def test_yellow_and_all_red(cycle, keys, wanted):
    assert after(cycle, **keys) == wanted


def test_a_permissive_left_turn_gets_a_green_of_its_own():
    left = {"lefts": [2], "foes": [(2, 1)], "protected_left_s": 8.0}
    assert after("25:GGg 5:yyy 2:rrr", **left) == "10:GGr 5:yyr 2:rrr 8:rrG 5:rry 2:rrr"
    short = after("25:GGg 5:yyy 2:rrr", **left, yellow_s=3.0)
    assert short == "12:GGr 5:yyr 2:rrr 8:rrG 3:rry 2:rrr"
    longer = after("25:GGg 5:yyy 2:rrr", **left, cycle="longer")
    assert longer == "25:GGr 5:yyr 2:rrr 8:rrG 5:rry 2:rrr"


@pytest.mark.parametrize(
    ("cycle", "foes", "wanted"),
    [
        # it has a green of its own behind the permissive one, as netconvert makes it, or before it
        ("29:GGg 5:yyg 6:rrG 5:rry", [(2, 1)], "27:GGr 5:yyr 8:rrG 5:rry"),
        ("29:GGg 5:yyg 9:rrG 5:rry", [(2, 1)], "29:GGr 5:yyr 9:rrG 5:rry"),
        ("6:rrG 5:rry 29:GGg 5:yyg", [(2, 1)], "8:rrG 5:rry 27:GGr 5:yyr"),
        ("6:rrG 29:GGg 5:yyy 2:rrr", [(2, 1)], "8:rrG 5:rry 2:rrr 20:GGr 5:yyr 2:rrr"),
        # it begins at the end of the cycle and goes on at the beginning
        ("3:rrG 5:rry 29:GGg 5:yyr 3:rrG", [(2, 1)], "5:rrG 5:rry 27:GGr 5:yyr 3:rrG"),
        # others that give way to it do not make it permissive
        ("29:GGg 5:yyg 9:rgG 5:ryy", [(2, 1)], "29:GGr 5:yyr 9:rgG 5:ryy"),
        # a phase in which nothing meets it is its own, whatever the letter
        ("29:GGg 5:yyg 9:rrg 5:rry", [(2, 1)], "29:GGr 5:yyr 9:rrg 5:rry"),
        # the longest of several greens gives time
        ("36:GGg 5:GGg 5:yyy", [(2, 1)], "23:GGr 5:GGr 5:yyr 8:rrG 5:rry"),
        ("20:GGg 9:GGg 5:yyg 6:rrG 5:rry", [(2, 1)], "18:GGr 9:GGr 5:yyr 8:rrG 5:rry"),
        ("9:GGg 20:GGg 5:yyg 6:rrG 5:rry", [(2, 1)], "9:GGr 18:GGr 5:yyr 8:rrG 5:rry"),
        # of its own stretch
        (
            "50:GGgrr 5:yyyrr 20:rrrGg 5:rrryy", [(2, 1), (4, 3)],
            "37:GGrrr 5:yyrrr 8:rrGrr 5:rryrr 7:rrrGr 5:rrryr 8:rrrrG 5:rrrry",
        ),
        # where nobody goes on, a program without yellow stays as it is
        ("29:GGg 5:yyg 9:rrG 2:rrr", [(2, 1)], "29:GGr 5:yyr 9:rrG 2:rrr"),
        # all get one that had to wait in any of them
        ("30:gGgG 10:rGgG 3:ryyy", [(0, 1), (2, 3)], "19:rGrG 10:rGrG 3:ryry 8:GrGr 3:yryr"),
        # one has a green of its own, the other has none
        ("40:GgGg 5:ygyy 6:rGrr 5:ryrr", [(1, 2), (3, 0)],
         "25:GrGr 5:yryr 8:rrrG 5:rrry 8:rGrr 5:ryrr"),
    ],
)  # fmt: skip
def test_the_green_that_a_left_turn_has_becomes_its_only_one(cycle, foes, wanted):
    """``foes``: each with the left turn first."""
    lefts = [left for left, _ in foes]
    assert after(cycle, lefts=lefts, foes=foes, protected_left_s=8.0) == wanted


@pytest.mark.parametrize(
    ("cycle", "keys", "told"),
    [
        ("10:Gr 10:rG", {"yellow_s": 6.0}, "green of 10 s .* would leave 4 s"),
        ("25:GGG 5:yyy 2:rrr", {"protected_left_s": 8.0, "lefts": [2]}, "no left turn has green"),
        (
            "40:gGGg 5:yyyy",
            {"protected_left_s": 8.0, "lefts": [0, 3], "foes": [(0, 3), (0, 2), (1, 3)]},
            "left turns of links 0 and 3 meet",
        ),
    ],
)
def test_what_cannot_be_changed_is_said(cycle, keys, told):
    with pytest.raises(UsageError, match=told):
        after(cycle, **keys)


def test_only_plain_cycles_are_changed():
    jumps = program("15:GGrr 15:rrGG")
    jumps[0].set("next", "1 0")
    with pytest.raises(UsageError, match="not a plain cycle"):
        signals.changed("a", jumps, Change(signal="a", yellow_s=3.0), (), lambda *_: False)


def with_longer_yellow(kind):
    """Of greens of 31 s that name a least and a greatest time, with 4 s of yellow for 3 s."""
    cycle = program("31:Gr 3:yr 31:rG 3:ry", type=kind)
    for phase in (cycle[0], cycle[2]):
        phase.set("minDur", "5")
        phase.set("maxDur", "50")
    _, found = signals.changed("a", cycle, Change(signal="a", yellow_s=4.0), (), lambda *_: False)
    signals.write(cycle, found)
    return cycle


def test_an_actuated_light_keeps_its_greens():
    cycle = with_longer_yellow("actuated")
    assert [one.get("duration") for one in cycle] == ["31", "4", "31", "4"]
    assert (cycle[0].get("minDur"), cycle[0].get("maxDur")) == ("5", "50")


def test_a_static_light_ignores_the_least_times_of_its_phases():
    """As SUMO does: the cycle stays as long as it is."""
    cycle = with_longer_yellow("static")
    assert [one.get("duration") for one in cycle] == ["30", "4", "30", "4"]


def test_a_green_of_its_own_ends_with_yellow_where_the_program_has_none():
    left = {"lefts": [2], "foes": [(2, 1)], "protected_left_s": 8.0}
    assert after("25:GGg 25:rrr", **left) == "14:GGr 25:rrr 8:rrG 3:rry"
    assert after("25:GGg 25:rrr", **left, yellow_s=4.0).endswith("8:rrG 4:rry")
