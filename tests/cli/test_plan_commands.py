"""Plans and `merge` as they are called."""

import pytest
from click.testing import CliRunner

from deepmf_sumo.cli import merge, run
from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.study.sweep import workers

from tests.support import tiny_plan

NO_FIGURES = ("--set", "sweep.figures=false")


def call(command, *arguments):
    return CliRunner().invoke(command, list(map(str, arguments)), catch_exceptions=False)


def test_a_shard_is_merged_to_tables_that_say_what_is_missing(tiny, tmp_path):
    plan, one, out = tiny_plan.write(tiny), tmp_path / "2", tmp_path / "half"
    done = call(run.command, plan, "--out", one, "--shard", "2/2", *NO_FIGURES)
    assert done.exit_code == 0, done.output
    assert "4 runs: 4 ok" in done.output
    done = call(merge.command, out, one)
    assert done.exit_code == 130
    assert "4 not begun: --resume does them" in done.output
    assert "Table II." in (out / "table.md").read_text()
    assert (out / "figures" / "index.md").is_file()


def test_a_plan_of_one_method_has_tables_too(tiny, tmp_path):
    done = call(
        run.command, tiny_plan.write(tiny), "--out", tmp_path / "one", *NO_FIGURES,
        "--set", "methods={none: none}", "--set", "tables={}",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert (tmp_path / "one" / "table.md").is_file()
    assert len((tmp_path / "one" / "differences.csv").read_text().splitlines()) == 1


def test_wrong_calls_run_nothing(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "run", None)
    plan = tiny_plan.write(tiny)
    out = tmp_path / "out"
    for wrong in (["--shard", "9/2"], ["--without", "nobody"], ["--set", "methods={}"]):
        with pytest.raises(UsageError):
            call(run.command, plan, "--out", out, *wrong)
    with pytest.raises(UsageError, match="this shard of them is empty"):
        call(run.command, plan, "--out", out, "--shard", "9/9")
    with pytest.raises(SpecError, match="holds no recorded scene"):
        call(run.command, "paper", "--set", f"source.recording={tmp_path}", "--out", out)
    assert not out.exists()
