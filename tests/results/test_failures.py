"""Failures: the words for a hit, errors of planners, and groups with the worst first."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from deepmf_sumo import files
from deepmf_sumo.cli import main
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.report import failures as words
from deepmf_sumo.results import failures as module
from deepmf_sumo.results.failures import Failure, failure_of
from deepmf_sumo.results.groups import grouped
from deepmf_sumo.results.reader import Results, Run

from tests.support import gate_doubles, worth_doubles
from tests.support.result_folders import Folder


def run(run_id, status="ok", error="", folder=Path("nowhere")):
    names = ("run_id", "method", "planner", "scene", "adversary", "version", "outcome")
    values = dict.fromkeys(names, "") | {"run_id": run_id, "part": "main", "seed": 0}
    return Run(folder=folder, row={"error": error}, status=status, **values)


@pytest.mark.parametrize(
    ("status", "error", "kind"),
    [
        ("failed", "planner_error: ZeroDivisionError: a bug (see log.txt)", "planner crashed"),
        ("failed", "planner_error: the planner ended its process (SIGSEGV; see log.txt).",
         "planner crashed"),
        ("failed", "planner_error: p.py ended with exit code 3 before it answered step 12.",
         "planner crashed"),
        ("failed", "planner_error: p.py did not answer step 12 within 1 s.", "planner hung"),
        ("failed", "planner_error: RuntimeError: the lidar did not answer (see log.txt)",
         "planner crashed"),
        ("timeout", "longer than 600 s", "run timed out"),
        ("failed", "planner_error: speed_mps at step 12 is nan, not a finite number.",
         "planner answered nonsense"),
        ("failed", "SUMO refused something", None),
        ("skipped", "no such record", None),
    ],
)  # fmt: skip
def test_errors_of_a_planner_are_failures_of_their_own(status, error, kind):
    found = failure_of(run("a", status, error))
    assert (found and found.kind) == kind
    if found:
        assert words.sentence(grouped([found], 4)[0]).startswith(f"The {kind}: ")


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ("crashed", "planner crashed"),
        ("hung", "planner hung"),
        ("nonsense", "planner answered nonsense"),
        ("", None),
    ],
)
def test_a_fault_is_what_was_raised_whatever_the_words(tmp_path, fault, kind):
    """Words of a planner or an adversary may be those of any of our messages."""
    words_of_all = "planner_error: the planner ended its process, did not answer step 1 within 1 s."
    values = gate_doubles.failed() | {"error": words_of_all, "planner_fault": fault}
    (tmp_path / "result.json").write_text(json.dumps(values))
    found = failure_of(run("a", "failed", words_of_all, tmp_path))
    assert (found and found.kind) == kind


def test_a_fault_survives_the_way_between_processes():
    error = pickle.loads(pickle.dumps(PlannerError("late", kind="hung")))
    assert (error.kind, str(error)) == ("hung", "planner_error: late")
    assert PlannerError("what").kind == "nonsense"


def hit(name, rung="B", by=("cc", "search"), delta_v=5.0, ordinary=1.0, **more):
    values = {
        "conflict": "crossing", "side": "left", "action": "held speed", "onset_s": 2.0,
        "delta_v_mps": delta_v, "ordinary_mps2": ordinary,
        "worth": worth_doubles.worth(rung, by) if rung else None,
    }  # fmt: skip
    return Failure(run=run(name), kind="hit", **values | more)


def test_groups_are_ranked_by_error_avoidability_severity_and_ordinary_motion():
    crash = Failure(run=run("crash"), kind="planner crashed", reason="a bug")
    found = [
        hit("fated", "D", (), 20.0),
        hit("silly", "C", delta_v=30.0),
        hit("unknown", "", delta_v=40.0),
        hit("wild", ordinary=4.0, side="right"),
        hit("calm", ordinary=0.5),
        hit("same", delta_v=3.0),
        hit("fast", delta_v=9.0, conflict="head-on"),
        hit("by three", by=("cc", "fsm", "search"), delta_v=2.0),
        hit("own error", "A", (), 1.0),
        crash,
        Failure(run=run("slow"), kind="run timed out", reason="it took longer than 600 s"),
    ]
    groups = grouped(found, 40)
    names = [[one.run.run_id for one in group.failures] for group in groups]
    assert names == [
        ["crash"], ["own error"], ["by three"], ["fast"], ["calm", "same"], ["wild"], ["unknown"],
        ["silly"], ["fated"], ["slow"],
    ]  # fmt: skip
    values = groups[4].values()
    assert (values["runs"], values["of"], values["example"]) == (2, 40, "calm")
    assert (values["worth"], values["rung"], values["finding"]) == ("avoidable (B)", "B", True)
    assert values["avoided_by"] == ["cc", "search"]
    assert words.row(groups[4])[::2] == (
        "2 of 40",
        "avoidable (B)",
        "held speed",
        "cc, search",
        "5.0",
    )
    assert [group.kind for group in groups[-4:]] == [
        "not judged", "no finding", "no finding", "out of time",
    ]  # fmt: skip


def finding(name, change="waits for the gap", rung="A", **more):
    """A finding with its cause."""
    values = {
        "what": "to wait for the gap", "last_moment_s": {"cc": 2.1, "rss": 1.8, "search": 0.4},
        "av_error": "took_priority", "reasons": ("took_priority",),
    }  # fmt: skip
    one = hit(name, rung, change=change, **values | more)
    key = one.av_error, one.opponent_error, one.conflict or "", change
    return replace(one, cause=key)


def test_findings_of_one_cause_are_one_row_and_what_happened_most_often_is_first():
    found = [
        finding("rare", conflict="merging", delta_v=9.0),
        finding("one", side="left"),
        finding("two", side="right", action="braked", by=("rss",), delta_v=4.0),
        finding(
            "avoidable", change="brakes harder", rung="B", av_error="", opponent_error="cut_in"
        ),
        finding("other change", change="reacts", delta_v=2.0),
        hit("apart", "C", reasons=("av_stood",), delta_v=20.0),
    ]
    groups = grouped(found, 20)
    names = [[one.run.run_id for one in group.failures] for group in groups]
    assert names == [["one", "two"], ["rare"], ["other change"], ["avoidable"], ["apart"]]
    assert words.summary(groups) == "4 distinct causes in 5 findings"
    assert words.summary(grouped(found[-1:], 1)) == ""
    values = groups[0].values()
    assert (values["change"], values["av_error"]) == ("waits for the gap", "took_priority")
    assert values["last_moment_s"] == {"cc": 2.1, "rss": 1.8, "search": 0.4}


def test_the_sentence_of_a_finding_names_the_smallest_change_and_the_last_moment():
    turn = {"conflict": "left turn across path", "turned": "AV", "side": "ahead"}
    told = words.sentence(grouped([finding("a", priority="opponent", **turn)], 1)[0])
    assert told == (
        "The AV turned left in front of an oncoming car, which had priority. It would have been"
        " enough to wait for the gap; the last moment to act was 1.8 s before the hit."
    )
    none = finding("a", "none", what="", last_moment_s={"cc": None}, conflict="crossing")
    assert words.sentence(grouped([none], 1)[0]).endswith(
        "; no change of the AV that was tried would have avoided it."
    )
    search = finding("a", last_moment_s={"cc": None, "search": 0.4})
    assert "the last moment to act was 0.4 s before" in words.sentence(grouped([search], 1)[0])


@pytest.mark.parametrize("reason", words._CONTRIVED)
def test_a_contrived_hit_says_why(reason):
    told = words.sentence(
        grouped([hit("a", "C", reasons=(reason,), opponent="truck or bus")], 1)[0]
    )
    assert ". It is contrived: " in told
    assert "{" not in told


def test_an_error_at_another_step_is_the_same_and_another_error_is_not():
    found = [
        Failure(run=run(name), kind="planner crashed", reason=reason)
        for name, reason in (("a", "bug at step 12"), ("b", "bug at step 3"), ("c", "other bug"))
    ]
    names = [[one.run.run_id for one in group.failures] for group in grouped(found, 3)]
    assert names == [["a", "b"], ["c"]]


def sentence(**more):
    return words.sentence(grouped([hit("a", **more)], 1)[0])


def test_the_sentence_is_that_of_an_engineer():
    assert sentence(conflict="left turn across path", turned="AV", onset_s=2.1, side="ahead") == (
        "The AV turned left in front of an oncoming car. The danger showed 2.1 s before the hit; a"
        " careful driver would have waited."
    )
    assert sentence(priority="AV", by=("search",)) == (
        "A car from the left without priority crossed in front of the AV, and the AV held its"
        " speed. The danger showed 2.0 s before the hit; only braking or steering immediately"
        " would have avoided it."
    )
    assert sentence(
        conflict="rear-end", turned="AV", side="behind", action="braked", braking_mps2=3.2,
        late=True, onset_s=None, rung="D", by=(),
    ) == (
        "A car behind ran into the AV, which braked late with up to 3 m/s2; no driver could have"
        " avoided it."
    )  # fmt: skip
    assert "braked with up to 1 m/s2" in sentence(action="braked", braking_mps2=0.4)
    turning = {"conflict": "left turn across path", "turned": "AV", "side": "ahead"}
    assert sentence(**turning, action="stood", rung="D", by=()) == (
        "The AV waited to turn left, and an oncoming car came into its way. The danger showed 2.0 s"
        " before the hit; no driver could have avoided it."
    )
    assert sentence(**turning, action="stopped").startswith(
        "The AV turned left in front of an oncoming car and stopped. The danger"
    )
    assert sentence(**turning, strayed=True).startswith(
        "The AV turned left, and an oncoming car left its lane and came into its way."
    )
    assert sentence(conflict="crossing", strayed=True).startswith(
        "A car from the left left its lane and came into the way of the AV, and the AV held"
    )
    assert sentence(rung="D", by=(), ran_red=True).endswith(" avoided it. The car ran a red light.")


@pytest.mark.parametrize("conflict", words._CAREFUL)
@pytest.mark.parametrize("turned", ["AV", "opponent", ""])
@pytest.mark.parametrize("by", [(), ("search",), ("fsm", "rss"), ("cc", "fsm", "rss", "search")])
def test_each_failure_has_a_sentence(conflict, turned, by):
    told = sentence(conflict=conflict, turned=turned, by=by)
    assert told.endswith(".")
    assert "None" not in told


@pytest.fixture
def folder(tmp_path, starts_sumo):  # recordings are read in a process of their own
    made = Folder(tmp_path)
    metrics = worth_doubles.metrics() | {"opponent_rms_acceleration": 0.8, "accident_type": 1.0}
    for scene in ("one", "two"):
        made.add(scene, metrics=metrics)
    made.add("miss", hit=False)
    made.fail("failed")
    return made.out


def test_failures_of_a_result_folder(folder):
    found = list(module.failures(Results.open(folder)))
    assert [one is not None for _, one, _ in found] == [True, True, False, False]
    failure = found[0][1]
    assert failure.worth == worth_doubles.worth()
    assert 0 < failure.onset_s <= 3.0
    assert failure.conflict in words._CAREFUL


@pytest.mark.sumo
def test_the_onset_of_a_turn_is_not_before_it(tmp_path):
    """The opponent was elsewhere since 0.3 s; its turn began at 1.5 s."""
    made = Folder(tmp_path)
    made.add("one", speed=14.0)
    (run,) = Results.open(made.out).runs
    assert failure_of(run).onset_s == pytest.approx(3.0 - 0.3)
    turn = {"opponent": "b", "begin_s": 1.5, "end_s": 3.0, "ended": "contact",
            "outcome": "av_opponent", "hit_speed_mps": 1.0, "metrics": {}}  # fmt: skip
    file = run.folder / "result.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"turns": [turn]}))
    (run,) = Results.open(made.out).runs
    assert failure_of(run).onset_s == pytest.approx(1.5)


def test_a_run_that_cannot_be_read_is_named(folder, capsys):
    file = folder / "runs" / "00-one" / "tracks.csv.gz"
    files.write(file, file.read_bytes()[:40])
    assert main.run(["show", str(folder), "--failures"]) == 0
    said = capsys.readouterr()
    assert "00-one cannot be described" in said.err
    assert "1 of 4" in said.out


def test_the_groups_are_data(folder, capsys):
    assert main.run(["show", str(folder), "--failures", "--format", "json"]) == 0
    [group] = json.loads(capsys.readouterr().out)
    assert group["run_ids"] == ["00-one", "01-two"]
    assert (group["runs"], group["of"], group["kind"]) == (2, 4, "hit")
    assert ". It would have been enough to brake fully" in group["sentence"]
    assert group["change"] == "reacts"
    assert group["folder"] == str(folder / "runs" / "00-one")
    assert main.run(["show", str(folder), "--failures", "--format", "csv"]) == 0
    said = capsys.readouterr().out
    assert "00-one 01-two" in said
    assert not set("[]{}") & set(said)
    assert main.run(["show", str(folder), "--failures", "--all"]) == 2


def test_a_folder_without_failures_says_so(tmp_path, capsys):
    made = Folder(tmp_path)
    made.add("miss", hit=False)
    assert main.run(["show", str(made.out), "--failures"]) == 0
    assert capsys.readouterr().out.strip() == "no failures in 1 run"


def test_groups_of_several_folders_name_the_folder_of_their_example(folder, capsys):
    assert main.run(["show", str(folder), "--failures"]) == 0
    assert str(folder) not in capsys.readouterr().out
    assert main.run(["show", str(folder), str(folder), "--failures"]) == 0
    said = capsys.readouterr().out
    assert str(folder / "runs" / "00-one") in said.replace("\n", "")
    assert "4 of 8" in said
