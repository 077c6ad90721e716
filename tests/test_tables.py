import csv
import io

import numpy as np
import pytest

from deepmf_sumo import tables
from deepmf_sumo.errors import UsageError, nearest


def test_values_have_six_digits_or_all_and_none_is_empty():
    rows = [{"a": 1 / 3, "b": None}, {"a": 2, "b": "=SUM(A1)"}]
    assert tables.to_csv(rows) == "a,b\n0.333333,\n2,'=SUM(A1)\n"
    assert tables.to_csv(rows[:1], cell=tables.exact) == f"a,b\n{1 / 3!r},\n"
    assert tables.to_csv(rows, ["b", "a"]).startswith("b,a\n,0.333333\n")


def test_a_table_without_rows_has_headings_if_they_are_given():
    assert tables.to_csv([]) == ""
    assert tables.to_csv([], ["a", "b"]) == "a,b\n"


def test_what_is_written_is_read_back(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text(tables.to_csv([{"a": "=1,\n2", "b": True}, {"a": "", "b": -1.5}]))
    assert tables.read_csv(file) == [{"a": "=1,\n2", "b": "True"}, {"a": "", "b": "-1.5"}]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a,b\n1,2", "is cut short"),
        ("a,b\n1\n", "row 1 has other columns"),
        ("a,b\n1,2,3\n", "row 1 has other columns"),
        ('a,b\n"1,2\n', "is damaged"),
    ],
)
def test_a_damaged_table_is_one_sentence_with_what_to_do(tmp_path, text, why):
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises(UsageError, match=rf"table\.csv .*{why}.*; do it again\."):
        tables.read_csv(file, "do it again")


def test_markdown_has_no_bars_of_others():
    assert tables.to_markdown(["a|b", "c"], [["1", "2|3"]]) == [
        "| a/b | c |",
        "| --- | --- |",
        "| 1 | 2/3 |",
    ]


def test_the_nearest_name_is_a_hint():
    assert nearest("adversry", ["planner", "adversary"]) == " Did you mean 'adversary'?"
    assert nearest("x", ["planner"]) == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (5_335_200.1234, "5335200.123"), (-499_968.5, "-499968.5"), (1234.5678, "1234.568"),
        (999.9996, "1000"), (0.000012345678, "1.23457e-05"), (1000.0, "1000"), (-0.0, "-0"),
        (1e300, "1e+300"), (float("nan"), "nan"), (float("inf"), "inf"), (86_400.05, "86400.05"),
    ],
)  # fmt: skip
def test_numbers_keep_millimetres(value, text):
    assert tables.cell(value) == text
    if np.isfinite(value):
        assert float(tables.cell(value)) == pytest.approx(value, rel=1e-5, abs=6e-4)


@pytest.mark.parametrize("shift_m", [0.0, 5_335_200.0])
def test_places_of_a_network_that_is_not_shifted_are_as_exact(shift_m):
    """A twin: the same rows, moved by a UTM offset."""
    rows = [{"x_m": 12.345 + shift_m, "y_m": 0.1 * step + shift_m} for step in range(50)]
    back = [
        {name: float(text) - shift_m for name, text in row.items()}
        for row in csv.DictReader(io.StringIO(tables.to_csv(rows)))
    ]
    for one, other in zip(rows, back, strict=True):
        assert other == pytest.approx(
            {key: value - shift_m for key, value in one.items()}, abs=6e-4
        )
