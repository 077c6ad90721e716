import re
from pathlib import Path

import pytest

from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.results.gate import thresholds
from deepmf_sumo.results.quantities import RULES
from deepmf_sumo.results.run_sets import frame_of

from tests.support.gate_doubles import row


def load(tmp_path, text):
    file = tmp_path / "thresholds.yaml"
    file.write_text(f"version: 1\n{text}")
    return thresholds.load(file)


def judge(tmp_path, text, rows):
    found = thresholds.judge(load(tmp_path, text), frame_of(rows))
    return {(one.group, one.limit): one for one in found}


def hits(number, of=10):
    return [
        row("a", seed, av_collision_rate=float(seed < number), collision_rate=float(seed < number))
        for seed in range(of)
    ]


@pytest.mark.parametrize(("number", "state"), [(3, "held"), (4, "broken")])
def test_a_rate(tmp_path, number, state):
    found = judge(tmp_path, "max_av_collision_rate: 0.3", hits(number))
    one = found["all runs", "max_av_collision_rate"]
    assert (one.state, one.value, one.runs) == (state, number / 10, 10)
    assert one.interval[0] < one.value < one.interval[1]
    assert one.blamed == (tuple(f"made up--a--{n}" for n in range(4)) if number == 4 else ())


def test_a_percentile_is_the_value_of_a_run(tmp_path):
    rows = [row("a", seed, ttc_s=0.1 * seed) for seed in range(40)]
    one = judge(tmp_path, "min_ttc_p05: 0.15", rows)["all runs", "min_ttc_p05"]
    assert (one.value, one.state) == (pytest.approx(0.1), "broken")
    assert one.blamed == ("made up--a--0", "made up--a--1")
    assert judge(tmp_path, "min_ttc_p05: 0.1", rows)["all runs", "min_ttc_p05"].state == "held"


def test_the_worst_hit(tmp_path):
    rows = [row("a", 0, delta_v_mps=2.0), row("a", 1, delta_v_mps=5.0), row("a", 2)]
    one = judge(tmp_path, "max_delta_v_mps: 4", rows)["all runs", "max_delta_v_mps"]
    assert (one.value, one.state, one.runs, one.blamed) == (5.0, "broken", 2, ("made up--a--1",))


@pytest.mark.parametrize(("number", "state"), [(0, "no value"), (2, "unfit")])
def test_nothing_happened_or_nothing_was_measured(tmp_path, number, state):
    """Without hits none is avoidable; hits without a verdict on them are no basis."""
    one = judge(tmp_path, "max_avoidable_rate: 0.5", hits(number))["all runs", "max_avoidable_rate"]
    assert (one.state, one.value) == (state, None)


def test_a_gap_that_was_not_measured_is_no_basis(tmp_path):
    assert judge(tmp_path, "min_gap_p05: 1", hits(0))["all runs", "min_gap_p05"].state == "unfit"


def test_failed_runs_and_too_few(tmp_path):
    lost = row(run_id="x", status="timeout", judged=False)
    found = judge(tmp_path, "min_judged_runs: 2", [row(), lost])
    assert found["all runs", "max_failed_runs"].state == "unfit"
    assert found["all runs", "max_failed_runs"].blamed == ("x",)
    assert found["all runs", "min_judged_runs"].state == "unfit"
    found = judge(tmp_path, "max_failed_runs: 1", [row(), lost])
    assert found["all runs", "max_failed_runs"].state == "held"


def test_groups(tmp_path):
    rows = [row("north", 0, av_collision_rate=1.0), row("south", 0, av_collision_rate=0.0)]
    text = """
max_av_collision_rate: 0.5
networks: {nor*: {max_av_collision_rate: 0.2}, south: {max_av_collision_rate: 0.0}}
planners: {idm*: {max_av_collision_rate: 0.9}}
specs: {made up: {max_av_collision_rate: 0.4}}
"""
    found = judge(tmp_path, text, rows)
    states = {group: one.state for (group, limit), one in found.items() if "rate" in limit}
    assert states == {
        "all runs": "held",
        "spec made up": "broken",
        "network nor*": "broken",
        "network south": "held",
        "planner idm*": "held",
    }


def test_a_group_without_runs_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"network 'nroth': no run .* Did you mean 'north'"):
        judge(tmp_path, "networks: {nroth: {max_failed_runs: 0}}", [row("north")])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("max_av_colision_rate: 0.1", r"yaml:2: .*Did you mean 'max_av_collision_rate'"),
        ("max_av_collision_rate: 1.5", r"yaml:2: key 'max_av_collision_rate': 1.5"),
        ("max_av_collision_rate: .nan", r"yaml:2: key 'max_av_collision_rate'"),
        ("max_failed_runs: -1", r"yaml:2: key 'max_failed_runs'"),
        ("min_ttc_p05: 10.0", r"yaml:2: key 'min_ttc_p05'"),
        ("planners: {idm: {baseline: x}}", r"yaml:2: key 'planners.idm.baseline': unknown key"),
        ("baseline: {quantities: [speed]}", r"'speed' is not a quantity"),
        ("baseline: {tolerance: {speed: 1}}", r"'speed' is not a quantity"),
        ("baseline: {quantities: []}", r"key 'baseline.quantities'"),
    ],
)
def test_wrong_files(tmp_path, text, told):
    with pytest.raises(SpecError, match=told):
        load(tmp_path, text)


def test_a_file_without_version(tmp_path):
    file = tmp_path / "t.yaml"
    file.write_text("max_failed_runs: 1\n")
    with pytest.raises(SpecError, match="version"):
        thresholds.load(file)


def test_the_baseline_lies_beside_the_file(tmp_path):
    assert load(tmp_path, "baseline: b.json").baseline.results == str(tmp_path / "b.json")
    assert load(tmp_path, "baseline: {confidence: 0.9}").baseline.results is None


@pytest.mark.parametrize(
    ("text", "now"),
    [
        ("max_valid_collision_rate: 0.1", "write 'max_finding_rate'"),
        ("planners: {idm: {max_valid_collision_rate: 0.1}}", "write 'max_finding_rate'"),
        ("baseline: {quantities: [valid_collision_rate]}", "write 'finding_rate'"),
    ],
)
def test_a_name_of_an_earlier_version_names_that_of_today(tmp_path, text, now):
    with pytest.raises(SpecError, match=now) as raised:
        load(tmp_path, text)
    assert "Known:" not in str(raised.value)


@pytest.mark.parametrize(("over", "state"), [(2.0, "held"), (2.01, "broken")])
def test_rules_have_limits_of_their_own(tmp_path, over, state):
    """What holds is one row; what is broken names the runs. Earlier results have no values."""
    rows = [row("a", 0, av_over_limit_mps=0.0, av_red_run_rate=0.0), row("b", 0, ttc_s=1.0)]
    rows.append(row("c", 0, av_over_limit_mps=over))
    found = judge(tmp_path, "", rows)
    kept = found.get(("all runs", thresholds.RULES_KEPT))
    broken = found.get(("all runs", "av_over_limit_mps"))
    assert [one.state for one in (kept, broken) if one] == [state]
    if broken:
        assert (broken.blamed, broken.runs, broken.bound) == (("made up--c--0",), 2, 2.0)
    assert len(judge(tmp_path, "", [row("b", 0, ttc_s=1.0)])) == 2  # failed and judged runs


def red_runs(scenes, of=30):
    return [row(f"s{n}", av_red_run_rate=float(n in scenes)) for n in range(of)]


@pytest.mark.parametrize(
    ("new", "old", "state"),
    [
        ([0, 1, 2], [3, 4, 5], "as before"), ([0], [1, 2], "as before"), (range(8), [9], "broken"),
        (range(3), [9], "as before"), ([4], [], "broken"), ([0, 1, 2], [0, 1, 2], "as before"),
    ],
)  # fmt: skip
def test_what_runs_of_the_baseline_break_too_is_broken_by_more_runs(tmp_path, new, old, state):
    """Sign test by hand: 8 against 1 are 0.02, 3 against 1 are 0.31."""
    sides = [frame_of(red_runs(one)) for one in (new, old)]
    [found] = [one for one in thresholds.judge(load(tmp_path, ""), *sides) if "red" in one.limit]
    assert (found.state, bool(found.blamed)) == (state, state == "broken")
    strict = load(tmp_path, "limits: {av_red_run_rate: 0}")
    [found] = [one for one in thresholds.judge(strict, *sides) if "red" in one.limit]
    assert found.state == "broken"


def test_other_moments_are_compared_by_how_many_break_a_limit(tmp_path):
    rows = [{**one, "scene": f"other {one['scene']}", "run_id": f"other {one['run_id']}"}
            for one in red_runs([0, 1])]  # fmt: skip
    sides = [frame_of(one) for one in (rows, red_runs([5]))]
    [found] = [one for one in thresholds.judge(load(tmp_path, ""), *sides) if "red" in one.limit]
    assert found.state == "as before"


def test_limits_of_quantities_can_be_set(tmp_path):
    rows = [row("a", 0, av_over_limit_mps=3.0, ttc_s=0.5)]
    found = judge(tmp_path, "limits: {av_over_limit_mps: 4, ttc_s: 1}", rows)
    assert found["all runs", "av_over_limit_mps"].state == "held"
    assert found["all runs", "ttc_s"].state == "broken"
    off = judge(tmp_path, "limits: {av_over_limit_mps: null}", rows)
    assert not any("over_limit" in limit for _, limit in off)
    unmeasured = judge(tmp_path, "limits: {av_off_lane_m: 1}", hits(0))
    assert unmeasured["all runs", "av_off_lane_m"].state == "unfit"


def test_groups_have_no_limits_by_default(tmp_path):
    rows = [row("a", 0, av_over_limit_mps=3.0)]
    found = judge(tmp_path, "networks: {a: {max_failed_runs: 0}}", rows)
    assert {group for group, limit in found if limit == "av_over_limit_mps"} == {"all runs"}


def test_the_page_on_thresholds_has_the_limits_of_the_program():
    page = (Path(__file__).resolve().parents[3] / "docs/reference/thresholds.md").read_text()
    told = {
        name: float(limit)
        for name, limit in re.findall(r"^\| `(av_\w+)` \| [^|]+ \| ([\d.]+)", page, re.MULTILINE)
    }
    assert told == {name: one.limit for name, one in RULES.items()}
