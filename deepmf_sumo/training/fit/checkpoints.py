"""State of a training on disk: checkpoints to resume from, and curves of the losses."""

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch

from deepmf_sumo import files
from deepmf_sumo.training.samples.dataset import Progress


def write(file: Path, content: bytes) -> None:
    """Write a file that appears complete; creates folders. Raises OSError, and leaves no part.

    If two processes write the same file, the last one stays.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    files.write(file, content)


_DIGEST_BYTES: Final = 32


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """The last two checkpoints of a training; each file starts with its own hash."""

    file: Path

    @property
    def previous(self) -> Path:
        """The checkpoint before the last one."""
        return self.file.with_name(f"{self.file.name}.previous")

    def save(self, state: dict[str, Any], report: Progress) -> None:
        """Write a checkpoint. If that fails, it is reported, and the last two checkpoints stay."""
        memory = io.BytesIO()
        torch.save(state, memory)
        content = memory.getvalue()
        newest = self.file.with_name(f"{self.file.name}.newest")
        try:
            write(newest, hashlib.sha256(content).digest() + content)
            if self.file.exists():
                self.file.replace(self.previous)
            newest.replace(self.file)
        except OSError as error:
            newest.unlink(missing_ok=True)
            report(
                f"warning: the checkpoint {self.file} cannot be written ({error.strerror});"
                " training continues, and the previous checkpoint stays"
            )

    def load(self, device: str, report: Progress) -> dict[str, Any] | None:
        """The last complete checkpoint; None if there is none."""
        damaged: list[Path] = []
        for file in (self.file, self.previous):
            state = _read(file, device)
            if state is not None:
                if damaged:
                    report(f"{damaged[0]} is damaged; the previous checkpoint is used")
                return state
            if file.exists():
                damaged.append(file)
        if damaged:
            report(f"{damaged[0]} is damaged, and there is no other; training starts from step 0")
        return None

    def clear(self) -> None:
        """Remove both at the end of the training."""
        self.file.unlink(missing_ok=True)
        self.previous.unlink(missing_ok=True)


def _read(file: Path, device: str) -> dict[str, Any] | None:
    try:
        content = files.content(file)
    except OSError:
        return None
    stored, payload = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(payload).digest() != stored:
        return None
    state: dict[str, Any] = torch.load(io.BytesIO(payload), weights_only=True, map_location=device)
    return state


class LearningCurves:
    """One row per evaluation on the held-out samples.

    Args:
        file: the table; event files go into a folder of the same name without its suffix.
        sources: names of the sources of held-out samples.
    """

    def __init__(self, file: Path, sources: Sequence[str], report: Progress) -> None:
        self.file, self.report = file, report
        self.columns = ["step", "loss", "held_out", *_columns(sources), "rate", "ms_a_step"]
        self.events: Any = None

    def begin(self, step: int) -> None:
        """Start at a step; later steps are dropped from the event files."""
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            return
        try:
            self.events = SummaryWriter(str(self.file.with_suffix("")), purge_step=step + 1)
        except OSError as error:
            self.report(f"warning: no event files for TensorBoard ({error.strerror})")

    def write(self, rows: Sequence[Sequence[float]]) -> None:
        """Write all rows to the table and the last one to the event files."""
        text = io.StringIO()
        shown = [[f"{value:.6g}" for value in row] for row in rows]
        csv.writer(text, lineterminator="\n").writerows([self.columns, *shown])
        try:
            write(self.file, text.getvalue().encode())
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
    """A name for each source; equal names are numbered."""
    names = [f"held_out {name}" for name in sources]
    return [
        name if names.count(name) == 1 else f"{name} ({number})"
        for number, name in enumerate(names, start=1)
    ]
