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
