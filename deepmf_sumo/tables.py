"""Tables as CSV and Markdown."""

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files, texts
from deepmf_sumo.errors import UsageError

Cell = Callable[[Any], str]

_LARGEST: Final = 2**28


_SIX_DIGITS_BELOW: Final = 1e3
_PLAIN_BELOW: Final = 1e12


def cell(value: Any) -> str:
    """A value in a CSV table: None is empty, text is never a formula.

    Numbers have six digits, or three decimals where six digits would cut those: coordinates of a
    network that is not shifted to its origin are millions of metres.
    """
    if not isinstance(value, float):
        return exact(value)
    if _SIX_DIGITS_BELOW <= abs(value) < _PLAIN_BELOW:
        return f"{value:.3f}".rstrip("0").rstrip(".")
    return f"{value:.6g}"


def exact(value: Any) -> str:
    """A value in a CSV table as `cell`, but numbers have all digits."""
    return "" if value is None else texts.cell(str(value))


def to_csv(
    rows: Iterable[Mapping[str, Any]], columns: Sequence[str] = (), *, cell: Cell = cell
) -> str:
    """Rows as CSV below a line of headings.

    Args:
        rows: by column.
        columns: their order; that of the first row where none are given. Without them a table
            without rows is empty.
        cell: text of a value.
    """
    listed = list(rows)
    names = columns or list(listed[0] if listed else ())
    text = io.StringIO()
    if names:
        writer = csv.DictWriter(text, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: cell(value) for name, value in row.items()} for row in listed)
    return text.getvalue()


def read_csv(file: Path, again: str = "write it again with --resume") -> list[dict[str, str]]:
    """Rows of a CSV table, as text.

    Raises UsageError where the table is damaged or cut short: part of the rows must not pass for
    all of them. ``again`` says in the message how to make it again.
    """
    try:
        text = files.text(file, _LARGEST)
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise UsageError(f"{file} is damaged ({error}); {again}.") from None
    if not text.endswith("\n"):
        raise UsageError(f"{file} is cut short; {again}.")
    for number, row in enumerate(rows, 1):
        if None in row or None in row.values():
            raise UsageError(f"{file} is damaged: row {number} has other columns; {again}.")
    return [{name: texts.of_cell(text) for name, text in row.items()} for row in rows]


def to_markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(text.replace('|', '/') for text in line)} |" for line in lines]


__all__ = ["cell", "exact", "read_csv", "to_csv", "to_markdown"]
