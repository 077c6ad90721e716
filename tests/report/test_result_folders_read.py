"""``runs.csv``: whole, or one sentence."""

import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.report import figures, page, side_by_side
from deepmf_sumo.results import stored

WHOLE = """run_id,spec,scene,planner,adversary,perception,version,seed,opponent,contact_time_s,\
contact_speed_mps,generation_s,cycle_ms_median,status,outcome,error
a,s,one,idm,rule,,,0,,,,,,ok,none,
b,s,two,idm,rule,,,0,,,,,,failed,,"no, it
did not"
"""


def written(folder, text):
    (folder / "runs.csv").write_text(text)
    return folder


def test_rows_come_in_their_order(tmp_path):
    found = stored.rows_of(written(tmp_path, WHOLE))
    assert [row["run_id"] for row in found] == ["a", "b"]
    assert found[1]["error"] == "no, it\ndid not"


def test_no_runs_are_no_damage(tmp_path):
    assert stored.rows_of(written(tmp_path, WHOLE.splitlines()[0] + "\n")) == []


@pytest.mark.parametrize("read", [stored.rows_of, figures.draw_all, page.write])
def test_a_table_that_is_cut_anywhere_is_refused(tmp_path, read):
    """But for ends of rows, where what is left is a table of fewer runs."""
    for length in range(1, len(WHOLE), 1 if read is stored.rows_of else 40):
        text = WHOLE[:length]
        if text.count('"') % 2 == 0 and text.endswith("\n"):
            continue
        with pytest.raises(UsageError, match=r"runs\.csv is (cut short|damaged).*--resume"):
            read(written(tmp_path, text))


def test_so_it_is_by_table_too(tmp_path):
    with pytest.raises(UsageError, match="is cut short; write it again with --resume"):
        side_by_side.groups([written(tmp_path, WHOLE[:30])])


def test_columns_of_something_else_and_rows_of_another_length(tmp_path):
    with pytest.raises(UsageError, match="no column 'planner': it is not of deepmf-sumo"):
        stored.rows_of(written(tmp_path, "run_id,spec,scene,status\na,b,c,d\n"))
    without = WHOLE.replace("contact_time_s", "contact_time")
    with pytest.raises(UsageError, match="no column 'contact_time_s'"):
        stored.rows_of(written(tmp_path, without))
    with pytest.raises(UsageError, match="row 2 has other columns"):
        stored.rows_of(written(tmp_path, WHOLE.replace("b,s,two", "b,two")))


def test_a_folder_without_one_says_what_to_do(tmp_path):
    with pytest.raises(UsageError, match="give the --out of an earlier command"):
        stored.rows_of(tmp_path)
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(UsageError, match="finish it with --resume"):
        stored.rows_of(tmp_path)
