"""A finished benchmark's folder -> its readable tables and its figures."""

from pathlib import Path

from deepmf_sumo.report import tables


def finish(out: Path, *, figures: bool = True) -> list[Path]:
    """Write tables and figures from the runs in the folder; returns their files.

    Raises UsageError where it is not a benchmark's folder.
    """
    made = tables.write(out)
    if figures:
        from deepmf_sumo.report.figures import draw_all  # brings matplotlib along

        made += draw_all(out)
    return made
