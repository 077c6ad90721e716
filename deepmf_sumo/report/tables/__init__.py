"""``table.md`` and ``table.tex``: the paper's tables of a benchmark, and more."""

from pathlib import Path

from deepmf_sumo import files
from deepmf_sumo.report.tables.layouts import read_content, tables_of
from deepmf_sumo.report.tables.text import latex_document, markdown_document, notes_of


def write(out: Path) -> list[Path]:
    """Write both from the CSV tables of a benchmark's folder. Raises UsageError for any other."""
    content = read_content(out)
    tables = tables_of(content)
    texts = {
        "table.md": markdown_document(content.layout.name, tables, notes_of(content)),
        "table.tex": latex_document(tables, notes_of(content)),
    }
    for name, text in texts.items():
        files.write(out / name, text)
    return [out / name for name in texts]
