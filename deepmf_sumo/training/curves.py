"""How the losses go: a table beside the weights, and event files where TensorBoard is installed."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deepmf_sumo.training import files
from deepmf_sumo.training.cache import Progress


class Curves:
    """One row each time that the held-out samples are looked at.

    Args:
        file: the table; event files go into a folder of the same name without ending.
        sources: names of the sources of held-out samples.
    """

    def __init__(self, file: Path, sources: Sequence[str], report: Progress) -> None:
        self.file, self.report = file, report
        self.columns = ["step", "loss", "held_out", *_columns(sources), "rate", "ms_a_step"]
        self.events: Any = None

    def begin(self, step: int) -> None:
        """Start at a step; what event files hold of later steps is dropped."""
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            return
        try:
            self.events = SummaryWriter(str(self.file.with_suffix("")), purge_step=step + 1)
        except OSError as error:
            self.report(f"warning: no event files for TensorBoard ({error.strerror})")

    def write(self, rows: Sequence[Sequence[float]]) -> None:
        """All rows to the table, the last one to the event files; values as in ``columns``."""
        text = io.StringIO()
        shown = [[f"{value:.6g}" for value in row] for row in rows]
        csv.writer(text, lineterminator="\n").writerows([self.columns, *shown])
        try:
            files.write(self.file, text.getvalue().encode())
            if self.events is not None:
                for name, value in zip(self.columns[1:], rows[-1][1:], strict=True):
                    self.events.add_scalar(name, value, int(rows[-1][0]))
                self.events.flush()
        except OSError as error:
            self.report(f"warning: {self.file} cannot be written ({error.strerror})")

    def end(self) -> None:
        """Close the event files."""
        if self.events is not None:
            self.events.close()


def _columns(sources: Sequence[str]) -> list[str]:
    """A name for each source; numbered where two are equal."""
    names = [f"held_out {name}" for name in sources]
    return [
        name if names.count(name) == 1 else f"{name} ({number})"
        for number, name in enumerate(names, start=1)
    ]
