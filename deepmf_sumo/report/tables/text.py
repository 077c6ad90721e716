"""The notes below the tables: definitions, units, bins and denominators."""

import inspect
from collections.abc import Sequence
from typing import Final

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics.statistics import BINS
from deepmf_sumo.report.tables import layouts
from deepmf_sumo.report.tables.layouts import Content, MethodTable, TableCell, TextRow
from deepmf_sumo.results.quantities import COLUMNS, Quantity
from deepmf_sumo.study.plans.layout import PlanLayout
from deepmf_sumo.study.plans.tables import STATUSES
from deepmf_sumo.tables import to_markdown

_RATES: Final = (
    "Rates are of attacked runs: those that succeeded and had a vehicle to attack with. Intervals"
    " are 95 %, and about other scenes: a scene counts once in them, with all its seeds."
)

_FEW_SCENES: Final = 10
"""With fewer scenes, intervals say little."""

_POOLED: Final = (
    "pooled_kl, pooled_jsd [nat], pooled_wasserstein [m/s2]: smoothed accelerations of all runs at"
    " once, attacks against recordings; Savitzky-Golay filter of 1.1 s on both,"
    f" {BINS} bins of 0.1 m/s2 on [-10.05, 10.05], values outside in the end bins, 1e-10 added to"
    " each count."
)
_DIVERSITY: Final = (
    "diversity_m: mean distance of the opponents' trajectories at equal times, over all pairs of"
    " runs, in the frame of the AV's first pose; diversity_within_scenes_m: of the attacks on one"
    " scene (several seeds). sectors_hit: how many of the AV's eight sectors of 45 degrees were"
    " hit; sectors_effective: exponential of their entropy. accidents.csv has all counts."
)


def notes_of(content: Content) -> list[str]:
    """Sentences, one a line."""
    layout = content.layout
    seeds = ", ".join(map(str, layout.plan["seeds"]))
    run_on = (
        f"{len(layout.scenes)} scenes of {layout.plan['duration_s']:g} s, seeds {seeds}, weights"
        f" {layout.plan['weights']}; deepmf-sumo {layout.version}."
    )
    lines = [
        run_on,
        _RATES,
        *_cautions(layout),
        *layouts.notes(layout),
        *layouts.of(layout),
        *_runs(content.main),
        *(_definition(column, content.main) for column in COLUMNS),
        _POOLED,
        _DIVERSITY,
        *_unmeasured(content.main),
    ]
    return [line for line in lines if line]


def _cautions(layout: PlanLayout) -> list[str]:
    """What makes intervals wide."""
    lines = []
    if len(layout.scenes) < _FEW_SCENES:
        lines.append(f"Of {len(layout.scenes)} scenes intervals are wide.")
    return lines


def _runs(rows: Sequence[TextRow]) -> list[str]:
    """Runs that are in no mean, by method and planner."""
    lines = []
    for row in rows:
        parts = {name: int(row[name]) for name in (*STATUSES[1:], "nobody_to_attack", "unfinished")}
        counts = ", ".join(f"{count} {name}" for name, count in parts.items() if count)
        if counts:
            name = f"{row['method']} on {row['planner']}"
            counts = counts.replace("nobody_to_attack", "with no vehicle to attack")
            lines.append(f"{name}: of {row['runs']} runs {counts}.")
    return lines


def _definition(column: Quantity, rows: Sequence[TextRow]) -> str:
    """Name, unit, what is averaged, the metric's own definition, and denominators."""
    counts = [int(row[f"n_{column.name}"]) for row in rows]
    if not any(counts):
        return ""
    of = f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else str(counts[0])
    unit = "" if column.unit == "1" else f" [{column.unit}]"
    metric = f" of {column.metric}: {_metric(column.metric)}" if column.metric else ""
    return f"{column.name}{unit}: {column.definition}{metric}. Runs a row: {of}."


def _metric(name: str) -> str:
    """The definition of a metric; of another package's, which may have none, its docstring."""
    found = plugins.load("metrics", name)
    text = getattr(found, "definition", None) or getattr(found, "DEFINITION", None)
    return " ".join(str(text or inspect.getdoc(found) or "").split())


def _unmeasured(rows: Sequence[TextRow]) -> list[str]:
    empty = [
        column.name for column in COLUMNS if not any(int(row[f"n_{column.name}"]) for row in rows)
    ]
    return [f"Not measured, or defined in no run: {', '.join(empty)}."] if empty else []


_SPECIAL: Final = {
    "\\": r"\textbackslash{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
}


def latex_document(tables: Sequence[MethodTable], notes: Sequence[str]) -> str:
    """One file with all tables, the notes below them."""
    items = "\n".join(rf"\item {_escaped(note)}" for note in notes)
    listed = f"\\begin{{itemize}}\n{items}\n\\end{{itemize}}"
    return "\n\n".join([*(_table(table) for table in tables), listed]) + "\n"


def _table(table: MethodTable) -> str:
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


def _cell(cell: TableCell) -> str:
    text = _escaped(cell.text)
    return rf"\textbf{{{text}}}" if cell.best else text


def _line(values: Sequence[str]) -> str:
    return f"{' & '.join(values)} \\\\"


def _escaped(text: str) -> str:
    return "".join(_SPECIAL.get(character, character) for character in text)


def markdown_document(title: str, tables: Sequence[MethodTable], notes: Sequence[str]) -> str:
    """One file with all tables, the notes below them."""
    parts = [f"# {title}", *(_markdown_table(table) for table in tables), "## Notes"]
    return "\n\n".join([*parts, "\n".join(f"- {note}" for note in notes)]) + "\n"


def _markdown_table(table: MethodTable) -> str:
    rows: list[list[str]] = []
    for planner, methods in table.blocks:
        rows.append([f"**{planner}**", *[""] * (len(table.heads) - 1)])
        rows += [[method, *map(_markdown_cell, cells)] for method, cells in methods]
    return "\n".join([f"## {table.title}", "", *to_markdown(table.heads, rows)])


def _markdown_cell(cell: TableCell) -> str:
    return f"**{cell.text}**" if cell.best else cell.text
