import xml.etree.ElementTree as ET
from itertools import combinations_with_replacement

import pytest

from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.results import gate
from deepmf_sumo.results.gate import verdict as verdict_module
from deepmf_sumo.results.gate.verdict import write_junit

from tests.support import gate_doubles


def thresholds(tmp_path, text=""):
    file = tmp_path / "t.yaml"
    file.write_text(f"version: 1\n{text}\n")
    found = gate.load(file)
    alone = found.baseline.model_copy(update={"quantities": ("impact_mps",)})
    return found.model_copy(update={"baseline": alone})


@pytest.fixture
def out(tmp_path):
    """Two hits of five attacked runs, one with a broken expectation, one with nobody to attack."""
    runs = [gate_doubles.result("a", seed, hit=seed < 2) for seed in range(5)]
    runs[4]["expectations_broken"] = ["min_gap is 2, expected at least 3"]
    runs.append(gate_doubles.result("empty", opponent=None, metrics={}))
    return gate_doubles.write_folder(tmp_path / "out", runs)


def cases(path):
    """By name: the kinds of children, apart from output; and the counts of the root."""
    root = ET.parse(path).getroot()
    found = {
        f"{case.get('classname')}: {case.get('name')}": {
            child.tag: child.get("message") for child in case if child.tag != "system-out"
        }
        for case in root.iter("testcase")
    }
    counts = [int(root.get(name)) for name in ("tests", "failures", "errors", "skipped")]
    return found, counts


def test_exit_codes(tmp_path, out):
    assert gate.check(out, thresholds(tmp_path)).exit_code == 1  # the expectation
    good = gate_doubles.write_folder(tmp_path / "good", [gate_doubles.result()])
    assert gate.check(good, thresholds(tmp_path)).exit_code == 0
    limits = thresholds(tmp_path, "max_av_collision_rate: 0")
    assert gate.check(good, limits).exit_code == 0
    assert gate.check(out, limits).exit_code == 1
    half = gate_doubles.write_folder(tmp_path / "half", [gate_doubles.result()], ["m--later--0"])
    assert gate.check(half, limits).exit_code == 3
    assert gate.check(half, thresholds(tmp_path, "max_failed_runs: 1")).exit_code == 0


def test_no_run_that_says_anything_is_no_pass(tmp_path):
    nobody = gate_doubles.result(opponent=None, metrics={})
    out = gate_doubles.write_folder(tmp_path / "out", [nobody])
    assert gate.check(out, thresholds(tmp_path)).exit_code == 3
    assert gate.check(out, thresholds(tmp_path, "min_judged_runs: 0")).exit_code == 0


def test_junit_of_a_broken_threshold(tmp_path, out):
    verdict = gate.check(out, thresholds(tmp_path, "max_av_collision_rate: 0.2"))
    write_junit(tmp_path / "junit.xml", verdict)
    found, counts = cases(tmp_path / "junit.xml")
    run = "made up / idm lane: "
    assert found[f"{run}a seed 0"] == {
        "failure": "contributes to max_av_collision_rate of all runs"
    }
    assert found[f"{run}a seed 2"] == {}
    assert found[f"{run}a seed 4"] == {"failure": "min_gap is 2, expected at least 3"}
    assert found[f"{run}empty seed 0"] == {"skipped": "no vehicle to attack"}
    assert "0.4" in found["all runs: max_av_collision_rate"]["failure"]
    assert found["all runs: max_failed_runs"] == {}
    assert counts == [9, 4, 0, 1]


def test_junit_of_failed_runs(tmp_path):
    runs = [gate_doubles.result(), gate_doubles.failed("b"), gate_doubles.failed("c", 0, "timeout")]
    out = gate_doubles.write_folder(tmp_path / "out", runs)
    write_junit(tmp_path / "junit.xml", gate.check(out, thresholds(tmp_path)))
    found, counts = cases(tmp_path / "junit.xml")
    run = "made up / idm lane: "
    assert found[f"{run}b seed 0"] == {"error": "failed: SUMO refused"}
    assert found[f"{run}c seed 0"] == {"error": "timeout: SUMO refused"}
    assert counts == [5, 0, 3, 0]
    allowed = gate.check(out, thresholds(tmp_path, "max_failed_runs: 2"))
    write_junit(tmp_path / "junit.xml", allowed)
    found, counts = cases(tmp_path / "junit.xml")
    assert "allowed by max_failed_runs" in found[f"{run}b seed 0"]["skipped"]
    assert counts == [5, 0, 0, 2]


@pytest.mark.slow_unit
def test_red_in_junit_means_a_bad_exit_code(tmp_path):
    """Over all mixtures of statuses and bounds: no red case with 0, no green file with 1 or 3."""
    kinds = {
        "ok": gate_doubles.result,
        "hit": lambda scene, seed: gate_doubles.result(scene, seed, hit=True),
        "failed": gate_doubles.failed,
        "nobody": lambda scene, seed: gate_doubles.result(scene, seed, opponent=None, metrics={}),
    }
    bounds = ("", "max_av_collision_rate: 0.4", "max_failed_runs: 1", "max_avoidable_rate: 0.5")
    for number, picked in enumerate(combinations_with_replacement(kinds, 3)):
        runs = [kinds[kind]("a", seed) for seed, kind in enumerate(picked)]
        out = gate_doubles.write_folder(tmp_path / f"out{number}", runs)
        verdict = gate.check(out, thresholds(tmp_path, bounds[number % 4]))
        write_junit(tmp_path / "junit.xml", verdict)
        _, (_, failures, errors, _) = cases(tmp_path / "junit.xml")
        assert (errors > 0) == (verdict.exit_code == 3), picked
        if not errors:
            assert (failures > 0) == (verdict.exit_code == 1), picked


def test_a_case_has_one_verdict(tmp_path):
    """A broken expectation of a run with nobody to attack is a failure, not skipped besides."""
    broken = ["outcome is none, expected av_opponent"]
    runs = [gate_doubles.result(opponent=None, metrics={}, expectations_broken=broken)]
    out = gate_doubles.write_folder(tmp_path / "out", runs)
    write_junit(tmp_path / "junit.xml", gate.check(out, thresholds(tmp_path, "min_judged_runs: 0")))
    found, counts = cases(tmp_path / "junit.xml")
    assert found["made up / idm lane: a seed 0"] == {"failure": broken[0]}
    assert counts == [3, 1, 0, 0]


def test_text_that_xml_forbids(tmp_path):
    bad = gate_doubles.failed() | {"error": "a \x00 <null> & more"}
    out = gate_doubles.write_folder(tmp_path / "out", [bad])
    write_junit(tmp_path / "junit.xml", gate.check(out, thresholds(tmp_path)))
    found, _ = cases(tmp_path / "junit.xml")
    assert "<null> & more" in found["made up / idm lane: a seed 0"]["error"]


def test_baseline_of_the_thresholds_and_of_the_command(tmp_path, out):
    worse = [gate_doubles.result(f"s{number}", hit=True) for number in range(20)]
    better = [gate_doubles.result(f"s{number}") for number in range(20)]
    new = gate_doubles.write_folder(tmp_path / "new", worse)
    old = gate_doubles.write_folder(tmp_path / "old", better)
    gate.check(old, thresholds(tmp_path), renewed=tmp_path / "b.json")
    verdict = gate.check(new, thresholds(tmp_path, "baseline: b.json"))
    states = {one.quantity: one.state for one in verdict.comparisons}
    assert states["impact_mps"] == "worse"
    assert states["av_collision_rate"] == states["min_gap_m"] == "not judged"
    assert verdict.exit_code == 1
    [finding] = verdict.findings()
    assert finding.startswith("all runs: impact_mps was 0 m/s and is 6 m/s: +6 (+2.")
    assert "; 20 pairs); most in 's0' (+6), 's1' (+6)" in finding
    write_junit(tmp_path / "junit.xml", verdict)
    found, _ = cases(tmp_path / "junit.xml")
    assert "failure" in found["baseline: all runs: impact_mps"]
    assert "baseline: all runs: min_gap_m" not in found
    same = gate.check(new, thresholds(tmp_path, "baseline: b.json"), baseline=new)
    assert {one.state for one in same.comparisons} == {"within margin", "not judged"}
    assert same.exit_code == 0


def test_a_baseline_that_can_never_alarm_is_no_verdict(tmp_path):
    """One spec, whatever its seeds: it says how many specs are needed, and nothing is green."""
    old, new = (
        gate_doubles.write_folder(
            tmp_path / name, [gate_doubles.result("a", seed, hit=hit) for seed in range(20)]
        )
        for name, hit in (("old", False), ("new", True))
    )
    for out in (old, new):
        verdict = gate.check(out, thresholds(tmp_path), baseline=old)
        assert verdict.exit_code == 3
        [finding] = verdict.findings()
        assert "1 spec can never show a change: at least 5 specs are needed" in finding
        assert f"{finding}." in verdict_module.text(verdict)
        write_junit(tmp_path / "junit.xml", verdict)
        found, counts = cases(tmp_path / "junit.xml")
        assert "at least 5 specs" in found["baseline: all runs: impact_mps"]["error"]
        assert counts == [23, 0, 1, 0]
    broken = gate.check(new, thresholds(tmp_path, "max_av_collision_rate: 0.5"), baseline=old)
    assert broken.exit_code == 1  # a broken threshold is a verdict


def test_what_runs_leave_open_is_no_verdict_and_says_how_many_would_tell(tmp_path):
    """Four of five specs are hit now, one is not any more."""
    old, new = (
        gate_doubles.write_folder(
            tmp_path / name,
            [
                gate_doubles.result("a", spec=f"spec {number}", hit=number in hit)
                for number in range(5)
            ],
        )
        for name, hit in (("old", {0}), ("new", {1, 2, 3, 4}))
    )
    verdict = gate.check(new, thresholds(tmp_path), baseline=old)
    assert verdict.exit_code == 3
    [finding] = verdict.findings()
    assert finding == (
        "all runs: impact_mps was 1.2 m/s and is 4.8 m/s: +3.6 (-7.38 to +11.3; 5 pairs):"
        " cannot tell: it may be worse by more than 3 m/s, and may be no worse; about 22 specs"
        " would tell"
    )


def test_a_baseline_that_is_renewed_is_not_compared_with(tmp_path, out):
    limits = thresholds(tmp_path, "baseline: b.json")
    with pytest.raises(UsageError, match=r"b\.json: no such file"):
        gate.check(out, limits)
    verdict = gate.check(out, limits, renewed=tmp_path / "b.json")
    assert verdict.comparisons is None
    assert "written again" in verdict.notes[0]
    assert gate.check(out, limits).comparisons is not None


def test_another_attack_is_told(tmp_path, out):
    gate.check(out, thresholds(tmp_path), renewed=tmp_path / "b.json")
    runs = [gate_doubles.result("a", seed, weights="mine") for seed in range(3)]
    new = gate_doubles.write_folder(tmp_path / "new", runs)
    verdict = gate.check(new, thresholds(tmp_path, "baseline: b.json"))
    assert verdict.apart == ["weights was 'open' and is 'mine' (3 runs)"]
    assert verdict.exit_code == 3
    fewer = [gate_doubles.result("a", seed) for seed in range(3)]
    short = gate_doubles.write_folder(tmp_path / "short", fewer)
    notes = gate.check(short, thresholds(tmp_path, "baseline: b.json")).notes
    assert any("new runs: 0; runs of the baseline that are gone: 3" in note for note in notes)


def test_summary(tmp_path, out):
    gate.check(out, thresholds(tmp_path), renewed=tmp_path / "b.json")
    limits = thresholds(tmp_path, "max_av_collision_rate: 0.2\nbaseline: b.json")
    text = verdict_module.text(gate.check(out, limits))
    assert text.startswith(
        "## deepmf-sumo: failed\n\n6 runs: 5 judged, 1 with no vehicle to attack\n"
    )
    line = "| all runs | max_av_collision_rate | 0.2 | 0.4 (0.01 to 0.98) | 5 | **broken** |"
    assert line in text
    assert "- `made-up--a--0`: contributes to max_av_collision_rate of all runs" in text
    assert (
        "| all runs | min_gap_m | 1.2 m | 1.2 m | +0 (-19 to +19; 5 pairs of 1 spec) | not judged |"
        in text
    )


def test_summary_is_added_and_long_lists_are_cut(tmp_path):
    runs = [gate_doubles.result("a", seed, hit=True) for seed in range(50)]
    out = gate_doubles.write_folder(tmp_path / "out", runs)
    verdict = gate.check(out, thresholds(tmp_path, "max_av_collision_rate: 0.2"))
    file = tmp_path / "page.md"
    file.write_text("before\n\n")
    verdict_module.write_summary(file, verdict)
    text = file.read_text()
    assert text.startswith("before\n\n## deepmf-sumo: failed")
    assert text.count("- `made-up") == 20
    assert "- and 30 more" in text
    with pytest.raises(OutputError, match="cannot be written"):
        verdict_module.write_summary(tmp_path / "no" / "page.md", verdict)
    with pytest.raises(OutputError, match="cannot be written"):
        write_junit(tmp_path / "no" / "junit.xml", verdict)


def test_a_broken_rule_is_told_with_its_kind_and_runs(tmp_path):
    runs = [gate_doubles.result("a", seed) for seed in range(3)]
    runs[1]["metrics"]["av_red_run"] = {"value": 1.0}
    runs[2]["plain"] = {"av_frozen": {"value": 0.5}}
    verdict = gate.check(gate_doubles.write_folder(tmp_path / "new", runs), thresholds(tmp_path))
    assert verdict.exit_code == 1
    red, frozen = verdict.findings()
    what = "red run: av_red_run_rate is 1 (1 run), allowed at most 0"
    assert red == f"all runs: {what}; in made-up--a--1"
    what = "frozen command: av_frozen_s is 0.5 s (1 run), allowed at most 0.25 s"
    assert frozen == f"all runs: {what}; in made-up--a--2"


def test_a_rule_that_the_baseline_breaks_too_is_shown_and_no_failure(tmp_path):
    runs = [gate_doubles.result("a", seed, spec=f"spec {seed}") for seed in range(20)]
    runs[3]["metrics"]["av_red_run"] = {"value": 1.0}
    old = gate_doubles.write_folder(tmp_path / "old", runs)
    new = gate_doubles.write_folder(tmp_path / "new", runs)
    verdict = gate.check(new, thresholds(tmp_path), old)
    assert "as before" in verdict_module.text(verdict)
    assert not any("red run" in sentence for sentence in verdict.findings())
    write_junit(tmp_path / "junit.xml", verdict)
    assert cases(tmp_path / "junit.xml")[0]["all runs: av_red_run_rate"] == {}


def test_a_quantity_that_is_worse_in_most_pairs_is_a_failure_of_its_own(tmp_path):
    runs = [gate_doubles.result("a", 0, spec=f"spec {number}") for number in range(40)]
    for number, one in enumerate(runs):
        one["metrics"]["av_time_gap_min"] = {"value": 2.0 + number % 3}
    old = gate_doubles.write_folder(tmp_path / "old", runs)
    for one in runs[:16]:
        one["metrics"]["av_time_gap_min"]["value"] -= 0.3
    new = gate_doubles.write_folder(tmp_path / "new", runs)
    verdict = gate.check(new, gate.load(None), old)
    assert verdict.exit_code == 1
    [told] = [one for one in verdict.findings() if "cannot tell" not in one]
    name = "pairs with worse av_inverse_time_gap_per_s"
    assert told.startswith(f"all runs: short time gap: {name} was 0 and is 0.4: +0.4 (")
    assert "; most in 'spec 0' (+1), " in told
    assert f"| {name} |" in verdict_module.text(verdict)
    write_junit(tmp_path / "junit.xml", verdict)
    assert [*cases(tmp_path / "junit.xml")[0][f"baseline: all runs: {name}"]] == ["failure"]
    assert gate.check(old, gate.load(None), new).leanings == []
