"""Whether two result folders hold the same, timings and machine facts apart."""

import csv
import json
import re
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.results.result import TIMINGS
from deepmf_sumo.study.plans.tables import TIMINGS as TABLE_TIMINGS

IGNORED: Final = {"log.txt", "report.html", "table.md", "table.tex"}
"""Files that tell of the machine; the readable tables are those of the CSV files, with times."""

_TIMED: Final = {*TIMINGS, *TABLE_TIMINGS, "cycle_ms"}


def same(folder_a: Path, folder_b: Path) -> bool:
    """Whether two result folders hold the same files with the same content."""
    return not differences(folder_a, folder_b)


def differences(folder_a: Path, folder_b: Path) -> list[str]:
    """Relative paths of the files that differ or are in one folder alone, sorted."""
    files_a, files_b = _files(folder_a), _files(folder_b)
    common = files_a & files_b
    changed = {name for name in common if _content(folder_a / name) != _content(folder_b / name)}
    return sorted((files_a ^ files_b) | changed)


def _files(folder: Path) -> set[str]:
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.is_file() and path.name not in IGNORED
    }


def _content(path: Path) -> Any:
    """What of a file must be equal."""
    if path.suffix == ".json":
        values = json.loads(path.read_text("utf-8"))
        return {key: value for key, value in values.items() if key not in {"timings", "machine"}}
    if path.suffix == ".jsonl":
        lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
        return [{key: value for key, value in line.items() if key != "plan_ms"} for line in lines]
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return [
            [(key, row[key]) for key in row if key not in _TIMED]
            for row in rows
            if row.get("quantity") not in _TIMED
        ]
    content = path.read_bytes()
    if path.name == "junit.xml":
        return re.sub(rb' time="[^"]*"', b"", content)
    if path.suffix in {".xml", ".sumocfg"}:  # SUMO's programs date their files in a comment
        return re.sub(rb"<!--.*?-->", b"", content, flags=re.DOTALL)
    return content
