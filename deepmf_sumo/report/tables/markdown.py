"""Tables -> Markdown."""

from collections.abc import Sequence

from deepmf_sumo.report.tables.layouts import Cell, Table


def document(title: str, tables: Sequence[Table], notes: Sequence[str]) -> str:
    """One file with all tables, the notes below them."""
    parts = [f"# {title}", *(_table(table) for table in tables), "## Notes"]
    return "\n\n".join([*parts, "\n".join(f"- {note}" for note in notes)]) + "\n"


def _table(table: Table) -> str:
    lines = [f"## {table.title}", "", _line(table.heads), _line(["---"] * len(table.heads))]
    for planner, rows in table.blocks:
        lines.append(_line([f"**{planner}**", *[""] * (len(table.heads) - 1)]))
        lines += [_line([method, *map(_cell, cells)]) for method, cells in rows]
    return "\n".join(lines)


def _cell(cell: Cell) -> str:
    return f"**{cell.text}**" if cell.best else cell.text


def _line(values: Sequence[str]) -> str:
    return f"| {' | '.join(value.replace('|', '/') for value in values)} |"
