"""A verdict as JUnit XML: a test case a run (scene and seed), and one a threshold and comparison.

``failure``: a broken expectation, threshold or comparison; ``error``: a run that failed or is
missing, too few runs, or a comparison that cannot tell; ``skipped``: nobody to attack, or nothing
to judge by.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET  # written, never parsed

from deepmf_sumo.benchmark import files
from deepmf_sumo.benchmark.gate import verdict as sentences
from deepmf_sumo.benchmark.gate.limits import UNFINISHED
from deepmf_sumo.benchmark.gate.rows import Row
from deepmf_sumo.benchmark.gate.verdict import Verdict
from deepmf_sumo.benchmark.junit import clean
from deepmf_sumo.errors import OutputError


def write(path: Path, verdict: Verdict) -> None:
    """Write the file. Raises OutputError."""
    root = ET.Element("testsuites", name="deepmf-sumo")
    _gate(root, verdict)
    suites: dict[str, list[Row]] = {}
    for row in verdict.results.rows.values():
        suites.setdefault(row.spec, []).append(row)
    tolerated = _tolerated(verdict)
    for name, rows in suites.items():
        suite = _suite(root, name)
        for row in rows:
            _run(suite, row, verdict, tolerated=tolerated)
    for suite in root:
        _counts(suite, [suite])
    _counts(root, list(root))
    ET.indent(root)
    content = b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n"
    try:
        files.write(path, content)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}.") from None


def _gate(root: ET.Element, verdict: Verdict) -> None:
    """A suite of the thresholds, and one of the comparisons."""
    suite = _suite(root, "thresholds")
    for one in verdict.judgements:
        case = _case(suite, one.group, one.limit)
        text = sentences.sentence(one)
        if one.state == "no value":
            _mark(case, "skipped", text)
        elif one.state != "held":
            _mark(case, "error" if one.state == "unfit" else "failure", text)
    if verdict.comparisons is None:
        return
    suite = _suite(root, "baseline")
    for each in verdict.comparisons:
        if each.state == "not judged":
            continue
        case = _case(suite, f"baseline: {each.group}", each.quantity)
        if each.state == "worse":
            _mark(case, "failure", sentences.regression(each))
        elif each.state == "cannot tell":
            _mark(case, "error", sentences.undecided(each))


def _run(suite: ET.Element, row: Row, verdict: Verdict, *, tolerated: bool) -> None:
    case = _case(suite, _classname(row), f"{row.scene} seed {row.seed}", row.wall_s)
    failures = verdict.failures(row)
    if failures:  # in one element: most servers show the first alone
        _mark(case, "failure", "; ".join(failures))
    if row.status in UNFINISHED and not tolerated:
        _mark(case, "error", f"{row.status}: {row.reason}")
    elif row.status in UNFINISHED:
        _mark(case, "skipped", f"allowed by max_failed_runs: {row.status}: {row.reason}")
    elif not (row.judged or failures):
        _mark(case, "skipped", row.reason)
    out = ET.SubElement(case, "system-out")
    values = ", ".join(f"{name} {value:g}" for name, value in row.values.items())
    out.text = clean(f"{values or '-'}; files: {verdict.results.source}/runs/{row.run_id}")


def _tolerated(verdict: Verdict) -> bool:
    """Whether no more runs failed than are allowed."""
    return not any(
        one.limit == "max_failed_runs" and one.state == "unfit" for one in verdict.judgements
    )


def _classname(row: Row) -> str:
    """What tells equal scenes and seeds apart: spec, method and planner, each named once."""
    return " / ".join(dict.fromkeys(part for part in (row.spec, row.method, row.planner) if part))


def _suite(root: ET.Element, name: str) -> ET.Element:
    return ET.SubElement(root, "testsuite", name=clean(name))


def _case(suite: ET.Element, classname: str, name: str, seconds: float = 0.0) -> ET.Element:
    return ET.SubElement(
        suite, "testcase", classname=clean(classname), name=clean(name), time=f"{seconds:.3f}"
    )


def _mark(case: ET.Element, kind: str, message: str) -> None:
    ET.SubElement(case, kind, message=clean(message))


def _counts(element: ET.Element, suites: Sequence[ET.Element]) -> None:
    cases = [case for suite in suites for case in suite.findall("testcase")]
    seconds = sum(float(case.get("time", "0")) for case in cases)
    element.set("tests", str(len(cases)))
    for kind, name in (("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
        element.set(name, str(sum(case.find(kind) is not None for case in cases)))
    element.set("time", f"{seconds:.3f}")
