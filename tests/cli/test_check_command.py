import json

import pytest

from deepmf_sumo.cli import main

from tests.support import gate_doubles

DRIVING = ("planner_hardest_braking", "av_ttc_min", "av_time_gap_min")


@pytest.fixture
def out(tmp_path):
    runs = [gate_doubles.result("a", seed, hit=seed < 2) for seed in range(5)]
    return gate_doubles.write_folder(tmp_path / "out", runs)


def check(tmp_path, out, text, *more):
    file = tmp_path / "t.yaml"
    file.write_text(f"version: 1\n{text}\n")
    return main.run(["check", str(out), "-t", str(file), *map(str, more)])


def test_all_files_are_written(tmp_path, out, capsys):
    junit, page, base = (tmp_path / name for name in ("gate.xml", "page.md", "base.json"))
    code = check(
        tmp_path, out, "max_av_collision_rate: 0.1",
        "--junit", junit, "--summary", page, "--write-baseline", base,
    )  # fmt: skip
    assert code == 1
    assert all(file.stat().st_size for file in (junit, page, base))
    shown = capsys.readouterr().out
    assert "5 runs: 5 judged" in shown
    assert "max_av_collision_rate is 0.4 (0.01 to 0.98, 5 runs), allowed at most 0.1" in shown
    assert check(tmp_path, out, "baseline: {quantities: [impact_mps]}", "--baseline", base) == 3
    shown = capsys.readouterr().out
    assert "cannot tell: 1 spec can never show a change: at least 5 specs are needed" in shown


def test_enough_specs_against_themselves_pass(tmp_path, capsys):
    def of(specs):
        runs = [gate_doubles.result("a", spec=f"spec {number}") for number in range(specs)]
        return gate_doubles.write_folder(tmp_path / f"{specs}", runs)

    few, enough, judged = of(5), of(19), "baseline: {results: X, quantities: [impact_mps]}"
    assert check(tmp_path, few, judged.replace("X", str(few))) == 3
    shown = capsys.readouterr().out
    assert "+0 (-9.01 to +9.01; 5 pairs)" in shown
    assert "about 19 specs would tell" in shown
    assert check(tmp_path, enough, judged.replace("X", str(enough))) == 0
    assert "+0 (-2.92 to +2.92; 19 pairs)" in capsys.readouterr().out


def test_names_with_brackets_and_stars_are_shown(tmp_path, out, capsys):
    assert check(tmp_path, out, "planners: {'idm*': {max_failed_runs: 0}}") == 0
    assert "planner idm*" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("max_colision_rate: 0.1", "Did you mean 'max_collision_rate'?"),
        ("specs: {mad up: {min_judged_runs: 1}}", "Did you mean 'made up'?"),
        ("baseline: nowhere.json", "nowhere.json: no such file or folder"),
    ],
)
def test_bad_input_is_a_line(tmp_path, out, capsys, text, told):
    assert check(tmp_path, out, text) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_half_a_folder_is_no_verdict(tmp_path, capsys):
    out = gate_doubles.write_folder(tmp_path / "half", [gate_doubles.result()], ["m--later--0"])
    assert check(tmp_path, out, "") == 3
    assert "max_failed_runs is 1 (2 runs), allowed at most 0" in capsys.readouterr().out
    (out / "manifest.json").unlink()
    assert check(tmp_path, out, "") == 2
    assert "is not a result folder" in capsys.readouterr().err


def test_a_regression_names_the_situations_and_needs_no_thresholds(tmp_path, capsys):
    def folder(name, hits):
        runs = [gate_doubles.result("a", spec=f"spec {n}", hit=n < hits) for n in range(45)]
        for run in runs:
            run["metrics"] |= {one: {"value": 2.0} for one in DRIVING}
        return gate_doubles.write_folder(tmp_path / name, runs)

    old, new = folder("old", 0), folder("new", 36)
    assert main.run(["check", str(new), "--baseline", str(old)]) == 1
    shown = capsys.readouterr().out
    named = shown.split("most in ")[1]
    assert all(f"'spec {n}' (+" in named for n in range(5))  # the first five, all alike
    assert "spec 7" not in named
    assert main.run(["check", str(new), "--baseline", str(new)]) == 0
    assert "most in" not in capsys.readouterr().out


def test_rows_have_all_that_the_exit_code_is_of(tmp_path, capsys):
    runs = [gate_doubles.result("a", spec=f"spec {number}") for number in range(40)]
    for run in runs:
        run["metrics"]["av_time_gap_min"] = {"value": 2.0}
    old = gate_doubles.write_folder(tmp_path / "old", runs)
    for run in runs[:16]:
        run["metrics"]["av_time_gap_min"] = {"value": 1.7}
    runs[-1]["expectations_broken"] = ["outcome was none, expected av_opponent"]
    new = gate_doubles.write_folder(tmp_path / "new", runs)
    judged = "baseline: {quantities: [av_inverse_time_gap_per_s]}"
    assert check(tmp_path, new, judged, "--baseline", old, "--format", "json") == 1
    rows = {row["quantity"]: row for row in json.loads(capsys.readouterr().out)}
    worse = rows["pairs with worse av_inverse_time_gap_per_s"]
    assert (worse["was"], worse["value"], worse["state"]) == (0.0, 0.4, "worse")
    broken = rows["outcome was none, expected av_opponent"]
    assert (broken["kind"], broken["group"], broken["state"]) == (
        "expectation",
        "spec-39--a--0",
        "broken",
    )


def test_nothing_to_judge_by_is_an_error(out, capsys):
    assert main.run(["check", str(out)]) == 2
    assert "--thresholds or --baseline" in capsys.readouterr().err
