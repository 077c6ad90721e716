"""A verdict as JUnit XML: a test case a run (scene and seed), and one a threshold and comparison.

``failure``: a broken expectation, threshold or comparison; ``error``: a run that failed or is
missing, too few runs, or a comparison that cannot tell; ``skipped``: nobody to attack, or nothing
to judge by.
"""

from pathlib import Path

from deepmf_sumo import files
from deepmf_sumo.benchmark.gate import verdict as sentences
from deepmf_sumo.benchmark.gate.comparison import Comparison
from deepmf_sumo.benchmark.gate.limits import UNFINISHED, Judgement
from deepmf_sumo.benchmark.gate.rows import Row
from deepmf_sumo.benchmark.gate.verdict import Verdict
from deepmf_sumo.benchmark.junit import Mark, TestCase, write_suites


def write(path: Path, verdict: Verdict) -> None:
    """Write the file. Raises OutputError."""
    suites = [("thresholds", [_threshold(one) for one in verdict.judgements])]
    if verdict.comparisons is not None:
        judged = [one for one in verdict.comparisons if one.state != "not judged"]
        suites.append(("baseline", [_comparison(one) for one in judged]))
    by_spec: dict[str, list[TestCase]] = {}
    tolerated = _tolerated(verdict)
    for row in verdict.results.rows.values():
        by_spec.setdefault(row.spec, []).append(_run(row, verdict, tolerated=tolerated))
    with files.writing(path):
        write_suites(path, [*suites, *by_spec.items()])


def _threshold(one: Judgement) -> TestCase:
    text, marks = sentences.sentence(one), []
    if one.state == "no value":
        marks = [Mark("skipped", text)]
    elif one.state != "held":
        marks = [Mark("error" if one.state == "unfit" else "failure", text)]
    return TestCase(classname=one.group, name=one.limit, marks=marks)


def _comparison(one: Comparison) -> TestCase:
    marks = []
    if one.state == "worse":
        marks = [Mark("failure", sentences.regression(one))]
    elif one.state == "cannot tell":
        marks = [Mark("error", sentences.undecided(one))]
    return TestCase(classname=f"baseline: {one.group}", name=one.quantity, marks=marks)


def _run(row: Row, verdict: Verdict, *, tolerated: bool) -> TestCase:
    failures = verdict.failures(row)
    # in one element: most servers show the first alone
    marks = [Mark("failure", "; ".join(failures))] if failures else []
    if row.status in UNFINISHED and not tolerated:
        marks.append(Mark("error", f"{row.status}: {row.reason}"))
    elif row.status in UNFINISHED:
        allowed = f"allowed by max_failed_runs: {row.status}: {row.reason}"
        marks.append(Mark("skipped", allowed))
    elif not (row.judged or failures):
        marks.append(Mark("skipped", row.reason))
    values = ", ".join(f"{name} {value:g}" for name, value in row.values.items())
    return TestCase(
        classname=_classname(row),
        name=f"{row.scene} seed {row.seed}",
        seconds=row.wall_s,
        marks=marks,
        output=f"{values or '-'}; files: {verdict.results.source}/runs/{row.run_id}",
    )


def _tolerated(verdict: Verdict) -> bool:
    """Whether no more runs failed than are allowed."""
    return not any(
        one.limit == "max_failed_runs" and one.state == "unfit" for one in verdict.judgements
    )


def _classname(row: Row) -> str:
    """What tells equal scenes and seeds apart: spec, method and planner, each named once."""
    return " / ".join(dict.fromkeys(part for part in (row.spec, row.method, row.planner) if part))
