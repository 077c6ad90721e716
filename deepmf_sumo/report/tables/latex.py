"""Tables -> LaTeX, to be input by a document; needs no package."""

from collections.abc import Sequence
from typing import Final

from deepmf_sumo.report.tables.layouts import Cell, Table

_SPECIAL: Final = {
    "\\": r"\textbackslash{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
}


def document(tables: Sequence[Table], notes: Sequence[str]) -> str:
    """One file with all tables, the notes below them."""
    items = "\n".join(rf"\item {_escaped(note)}" for note in notes)
    listed = f"\\begin{{itemize}}\n{items}\n\\end{{itemize}}"
    return "\n\n".join([*(_table(table) for table in tables), listed]) + "\n"


def _table(table: Table) -> str:
    columns = "l" + "c" * (len(table.heads) - 1)
    lines = [
        r"\begin{table*}[ht]",
        r"\centering",
        rf"\caption{{{_escaped(table.title)}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\hline",
        _line([_escaped(head) for head in table.heads]),
    ]
    for planner, rows in table.blocks:
        lines += [
            r"\hline",
            rf"\multicolumn{{{len(table.heads)}}}{{l}}{{\textbf{{{_escaped(planner)}}}}} \\",
            r"\hline",
            *(_line([_escaped(method), *map(_cell, cells)]) for method, cells in rows),
        ]
    return "\n".join([*lines, r"\hline", r"\end{tabular}", r"\end{table*}"])


def _cell(cell: Cell) -> str:
    text = _escaped(cell.text)
    return rf"\textbf{{{text}}}" if cell.best else text


def _line(values: Sequence[str]) -> str:
    return f"{' & '.join(values)} \\\\"


def _escaped(text: str) -> str:
    return "".join(_SPECIAL.get(character, character) for character in text)
