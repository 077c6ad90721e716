"""Tables -> Markdown."""

from collections.abc import Sequence

from deepmf_sumo.report.tables.layouts import Cell, Table
from deepmf_sumo.tables import to_markdown


def document(title: str, tables: Sequence[Table], notes: Sequence[str]) -> str:
    """One file with all tables, the notes below them."""
    parts = [f"# {title}", *(_table(table) for table in tables), "## Notes"]
    return "\n\n".join([*parts, "\n".join(f"- {note}" for note in notes)]) + "\n"


def _table(table: Table) -> str:
    rows: list[list[str]] = []
    for planner, methods in table.blocks:
        rows.append([f"**{planner}**", *[""] * (len(table.heads) - 1)])
        rows += [[method, *map(_cell, cells)] for method, cells in methods]
    return "\n".join([f"## {table.title}", "", *to_markdown(table.heads, rows)])


def _cell(cell: Cell) -> str:
    return f"**{cell.text}**" if cell.best else cell.text
