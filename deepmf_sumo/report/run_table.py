"""``runs.csv`` of a result folder, a row a run."""

import csv
import io
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.texts import of_cell

_NEEDED: Final = (
    "run_id", "status", "spec", "scene", "planner", "perception", "adversary", "version", "seed",
    "outcome", "opponent", "contact_time_s", "contact_speed_mps", "generation_s", "cycle_ms_median",
)  # fmt: skip
"""Columns that readers ask for; those of all versions."""
_LARGEST: Final = 2**28
_ANEW: Final = "write it anew with --resume"


def runs_of(folder: Path) -> list[dict[str, str]]:
    """The rows of ``runs.csv``, in its order.

    Raises UsageError where there is no such file, or it is damaged or cut short: part of the runs
    must not pass for all of them.
    """
    file = folder / "runs.csv"
    if not file.is_file():
        begun = (folder / "manifest.json").is_file()
        rest = "finish it with --resume" if begun else "give the --out of an earlier command"
        raise UsageError(f"{folder} is no complete result folder: it has no runs.csv; {rest}.")
    rows = rows_of(file)
    lost = [name for name in _NEEDED if rows and name not in rows[0]]
    if lost:
        raise UsageError(f"{file} has no column '{lost[0]}': it is not of deepmf-sumo.")
    return rows


def rows_of(file: Path) -> list[dict[str, str]]:
    """Rows of any table of a result folder. Raises UsageError as `runs_of` does."""
    try:
        text = files.text(file, _LARGEST)
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise UsageError(f"{file} is damaged ({error}); {_ANEW}.") from None
    if not text.endswith("\n"):
        raise UsageError(f"{file} is cut short; {_ANEW}.")
    for number, row in enumerate(rows, 1):
        if None in row or None in row.values():
            raise UsageError(f"{file} is damaged: row {number} has other columns; {_ANEW}.")
    return [{name: of_cell(text) for name, text in row.items()} for row in rows]
