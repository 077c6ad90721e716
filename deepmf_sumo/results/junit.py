"""JUnit XML, which continuous-integration servers read: its writer, and the cases of runs."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal
from xml.etree import ElementTree as ET  # written, never parsed

from deepmf_sumo import files
from deepmf_sumo.results.findings import said
from deepmf_sumo.results.quantities import hit, worth
from deepmf_sumo.results.result import Result

FILE: Final = "junit.xml"
Kind = Literal["failure", "error", "skipped"]

_FORBIDDEN: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class Mark:
    """Why a test case did not pass; ``type`` is that of an error, where it has one."""

    kind: Kind
    message: str
    type: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TestCase:
    """A test case. ``output`` is its ``system-out``."""

    classname: str
    name: str
    seconds: float = 0.0
    marks: Sequence[Mark] = ()
    output: str = ""


def write(path: Path, results: Sequence[Result]) -> None:
    """Write a test case for each run, a suite for each spec.

    A broken expectation is a failure; a run that failed or timed out is an error. Raises OSError.
    """
    suites: dict[str, list[TestCase]] = {}
    for result in results:
        suites.setdefault(result["spec"], []).append(_case(result))
    write_suites(path, suites.items())


def write_suites(path: Path, suites: Iterable[tuple[str, Sequence[TestCase]]]) -> None:
    """Write the test cases of all suites, with their counts. Raises OSError."""
    listed = list(suites)
    every = [case for _, cases in listed for case in cases]
    root = ET.Element("testsuites", _counts("deepmf-sumo", every))
    for name, cases in listed:
        suite = ET.SubElement(root, "testsuite", _counts(name, cases))
        for case in cases:
            _add(suite, case)
    ET.indent(root)
    files.write(path, b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n")


def _case(result: Result) -> TestCase:
    marks = [Mark("failure", sentence) for sentence in result["expectations_broken"]]
    if result["status"] in {"failed", "timeout"}:
        marks.append(Mark("error", result["error"], result["status"]))
    elif result["status"] == "skipped":
        marks.append(Mark("skipped", result["error"]))
    return TestCase(
        classname=result["spec"],
        name=result["run_id"],
        seconds=result["timings"]["wall_s"],
        marks=marks,
        output=f"outcome: {_outcome(result)}; files: runs/{result['run_id']}",
    )


def _outcome(result: Result) -> str:
    """With the worth of a hit."""
    if "outcome" not in result:
        return "-"
    return f"{result['outcome']}, {said(worth(result))}" if hit(result) else result["outcome"]


def _add(suite: ET.Element, case: TestCase) -> None:
    names = {"classname": _clean(case.classname), "name": _clean(case.name)}
    element = ET.SubElement(suite, "testcase", names, time=f"{case.seconds:.3f}")
    for mark in case.marks:
        of_type = {"type": mark.type} if mark.type else {}
        ET.SubElement(element, mark.kind, of_type, message=_clean(mark.message))
    if case.output:
        ET.SubElement(element, "system-out").text = _clean(case.output)


def _counts(name: str, cases: Sequence[TestCase]) -> dict[str, str]:
    kinds = [{mark.kind for mark in case.marks} for case in cases]
    return {
        "name": _clean(name),
        "tests": str(len(cases)),
        "failures": str(sum("failure" in found for found in kinds)),
        "errors": str(sum("error" in found for found in kinds)),
        "skipped": str(sum("skipped" in found for found in kinds)),
        "time": f"{sum(case.seconds for case in cases):.3f}",
    }


def _clean(text: str) -> str:
    """Without the characters that XML forbids."""
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)
