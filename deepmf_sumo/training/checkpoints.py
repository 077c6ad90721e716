"""Where a training stands, on disk: two files, so that a damaged one does not cost the run."""

import hashlib
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch

from deepmf_sumo.training.cache import Progress

_DIGEST_BYTES: Final = 32


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """The last checkpoint of a training, and the one before; a file begins with its own hash."""

    file: Path

    @property
    def previous(self) -> Path:
        """The checkpoint before the last one."""
        return self.file.with_name(f"{self.file.name}.previous")

    def save(self, state: dict[str, Any], report: Progress) -> bool:
        """Whether it was written. A full disk costs this checkpoint only: those before stay."""
        memory = io.BytesIO()
        torch.save(state, memory)
        content = memory.getvalue()
        beside = self.file.with_name(f"{self.file.name}.{os.getpid()}")
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with beside.open("wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
                file.flush()
                os.fsync(file.fileno())
            if self.file.exists():
                self.file.replace(self.previous)
            beside.replace(self.file)
        except OSError as error:
            beside.unlink(missing_ok=True)
            report(
                f"warning: the checkpoint {self.file} cannot be written ({error.strerror});"
                " training goes on, and the checkpoint before stays"
            )
            return False
        return True

    def load(self, device: str, report: Progress) -> dict[str, Any] | None:
        """The last checkpoint that is whole; None where there is none."""
        damaged: list[Path] = []
        for file in (self.file, self.previous):
            state = _read(file, device)
            if state is not None:
                if damaged:
                    report(f"{damaged[0]} is damaged; the checkpoint before it is used")
                return state
            if file.exists():
                damaged.append(file)
        if damaged:
            report(f"{damaged[0]} is damaged, and there is no other; training starts anew")
        return None

    def clear(self) -> None:
        """Remove both: the training has ended."""
        self.file.unlink(missing_ok=True)
        self.previous.unlink(missing_ok=True)


def _read(file: Path, device: str) -> dict[str, Any] | None:
    try:
        content = file.read_bytes()
    except OSError:
        return None
    stored, payload = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(payload).digest() != stored:
        return None
    state: dict[str, Any] = torch.load(io.BytesIO(payload), weights_only=True, map_location=device)
    return state
