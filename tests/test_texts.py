import csv
import io

import pytest

from deepmf_sumo import texts

FORMULAS = [
    "=1+1",
    "=cmd|'/C calc'!A0",
    "+1+1",
    "-1-1",
    "@SUM(A1)",
    "\t=1",
    "\r=1",
    "-",
    "-E1",
    "-1#A",
    "-1#2+3",
    "'=1",
    "''@",
]
PLAIN = [
    "-123#0",
    "-123456789",
    "-12#10_1",
    "-7_0",
    "",
    "av",
    "-5.17",
    "+3",
    "1e-3",
    "-inf",
    "'",
    "'a'",
    "a=b",
    "1-2",
    "#1",
    "-0",
]


@pytest.mark.parametrize("text", FORMULAS)
def test_no_cell_begins_a_formula(text):
    assert texts.cell(text)[0] == "'"


@pytest.mark.parametrize("text", PLAIN)
def test_what_is_none_stays_as_it_is(text):
    assert texts.cell(text) == text


@pytest.mark.parametrize("text", FORMULAS + PLAIN)
def test_the_text_comes_back(text):
    table = io.StringIO(newline="")
    csv.writer(table).writerow([texts.cell(text), "x"])
    [[cell, _]] = csv.reader(io.StringIO(table.getvalue(), newline=""))
    assert texts.of_cell(cell) == text
