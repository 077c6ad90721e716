"""Results as JUnit XML, a test case a run: what continuous-integration servers read."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET  # written, never parsed

from deepmf_sumo.benchmark import files
from deepmf_sumo.benchmark.result import Result

_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write(path: Path, results: Sequence[Result]) -> None:
    """A broken expectation is a failure; a run that failed or timed out is an error."""
    suites: dict[str, list[Result]] = {}
    for result in results:
        suites.setdefault(result["spec"], []).append(result)
    root = ET.Element("testsuites", _counts("deepmf-sumo", results))
    for name, members in suites.items():
        suite = ET.SubElement(root, "testsuite", _counts(name, members))
        for result in members:
            _case(suite, result)
    ET.indent(root)
    files.write(path, b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n")


def _case(suite: ET.Element, result: Result) -> None:
    attributes = {
        "classname": clean(result["spec"]),
        "name": result["run_id"],
        "time": f"{result['timings']['wall_s']:.3f}",
    }
    case = ET.SubElement(suite, "testcase", attributes)
    for sentence in result["expectations_broken"]:
        ET.SubElement(case, "failure", message=clean(sentence))
    if result["status"] in {"failed", "timeout"}:
        ET.SubElement(case, "error", type=result["status"], message=clean(result["error"]))
    elif result["status"] == "skipped":
        ET.SubElement(case, "skipped", message=clean(result["error"]))
    out = ET.SubElement(case, "system-out")
    out.text = f"outcome: {result.get('outcome', '-')}; files: runs/{result['run_id']}"


def _counts(name: str, results: Sequence[Result]) -> dict[str, Any]:
    statuses = [result["status"] for result in results]
    return {
        "name": clean(name),
        "tests": str(len(results)),
        "failures": str(sum(bool(result["expectations_broken"]) for result in results)),
        "errors": str(statuses.count("failed") + statuses.count("timeout")),
        "skipped": str(statuses.count("skipped")),
        "time": f"{sum(result['timings']['wall_s'] for result in results):.3f}",
    }


def clean(text: str) -> str:
    """Without the characters that XML forbids."""
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)
