"""Figures of a result folder, as PNG and SVG, in widths of print; see `draw_all`."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.report.figures import attacks, methods, scores, sectors, style
from deepmf_sumo.report.figures.attacks import write_timelines
from deepmf_sumo.report.figures.style import Sheet, Skipped
from deepmf_sumo.results.reader import Results

__all__ = ["draw_all", "write_timelines"]

FIGURES: Final[dict[str, Callable[[Results], Sheet | Skipped]]] = {
    "figure_3_scores": scores.draw,
    "figure_4_attacks": attacks.draw,
    "figure_5_sectors": sectors.draw,
    "figure_6_methods": methods.draw_methods,
    "rate_naturalness": methods.draw_tradeoff,
    "rate_budget": methods.draw_budget,
    "timelines": attacks.draw_timelines,
}


def draw_all(out: Path) -> list[Path]:
    """Draw what the runs of a result folder allow into ``out/figures``.

    ``figures/index.md`` says of each figure what it shows and of which runs, or why it is missing.

    Returns the files, the index last. Raises UsageError where ``out`` is not a result folder.
    """
    found = Results.of(out)
    folder = out / "figures"
    folder.mkdir(exist_ok=True)
    written, lines = [], []
    for name, draw in FIGURES.items():
        with style.printed():
            drawn = draw(found)
            lines.append(_entry(name, drawn))
            if isinstance(drawn, Sheet):
                written += style.save(drawn.figure, folder / name)
            else:
                for suffix in (".png", ".svg"):  # of earlier runs in this folder
                    (folder / name).with_suffix(suffix).unlink(missing_ok=True)
    files.write(folder / "index.md", "\n".join(["# Figures", *lines, ""]))
    return [*written, folder / "index.md"]


def _entry(name: str, drawn: Sheet | Skipped) -> str:
    if isinstance(drawn, Skipped):
        return f"\n## {name}\n\nNot drawn: {drawn.reason}."
    runs = [f"Runs: {', '.join(drawn.runs)}"] if drawn.runs else []
    return "\n\n".join([f"\n## {name}", drawn.caption, *drawn.notes, *runs])
