"""``table.md`` and ``table.tex``: the paper's tables of a benchmark, and more."""

from pathlib import Path

from deepmf_sumo import files
from deepmf_sumo.report.tables import latex, markdown, notes
from deepmf_sumo.report.tables.content import read
from deepmf_sumo.report.tables.layouts import tables_of


def write(out: Path) -> list[Path]:
    """Write both from the CSV tables of a benchmark's folder. Raises UsageError for any other."""
    content = read(out)
    tables = tables_of(content)
    texts = {
        "table.md": markdown.document(content.layout.name, tables, notes.of(content)),
        "table.tex": latex.document(tables, notes.of(content)),
    }
    for name, text in texts.items():
        files.write(out / name, text)
    return [out / name for name in texts]
