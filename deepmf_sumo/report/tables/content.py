"""What the readable tables are made of: the CSV tables of a benchmark's folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.benchmark.study import Layout, read_layout, tables
from deepmf_sumo.tables import read_csv

Row = dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """Rows as text, in the plan's order; an empty cell is not known."""

    layout: Layout
    main: Sequence[Row]
    differences: Sequence[Row]
    equal_seconds: Sequence[Row]


def read(out: Path) -> Content:
    """Read the tables. Raises UsageError where the folder has none."""
    return Content(
        layout=read_layout(out),
        main=_rows(out / tables.MAIN),
        differences=_rows(out / tables.DIFFERENCES),
        equal_seconds=_rows(out / tables.EQUAL_SECONDS, needed=False),
    )


def _rows(file: Path, *, needed: bool = True) -> list[Row]:
    if not file.is_file() and not needed:
        return []
    return read_csv(file)
