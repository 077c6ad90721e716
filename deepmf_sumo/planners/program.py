"""A program drives the AV: it reads views and writes commands, one line of JSON each.

The protocol is in `remote.protocol`. What the program writes to stderr goes to the run's
``log.txt``. A program that is late, ends, or answers with a command that cannot be driven fails the
run (`PlannerError`): no other planner takes over, so that every result is that of the planner that
was asked for.
"""

import os
import shutil
from functools import partial
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from deepmf_sumo.planners.remote.client import RemotePlanner, RemoteSettings
from deepmf_sumo.planners.remote.process import command_of, started


class Settings(RemoteSettings):
    """``file`` or ``command`` is needed.

    Attributes:
        file: the program, relative to the spec; without a ``command``, this Python runs ``.py``
            files.
        command: what runs the file, e.g. ``[node]``, or the whole command line.
        arguments: further arguments.
    """

    file: str | None = None
    command: tuple[str, ...] = Field(default=(), strict=False)
    arguments: tuple[str, ...] = Field(default=(), strict=False)

    @model_validator(mode="after")
    def _can_be_started(self) -> Self:
        if self.file is None and not self.command:
            raise ValueError("needs 'file' or 'command'")
        if self.file is not None and not Path(self.file).is_file():
            raise ValueError(f"there is no file '{self.file}'")
        first = command_of(self.file, self.command, self.arguments)[0]
        if shutil.which(first) is None:
            known = Path(first).is_file() and not os.access(first, os.X_OK)
            why = "is not executable" if known else "is not a program on the path"
            raise ValueError(f"'{first}' {why}")
        return self


def build(settings: Settings) -> RemotePlanner:
    """The planner."""
    command = command_of(settings.file, settings.command, settings.arguments)
    name = f"program '{Path(settings.file or command[0]).name}'"
    return RemotePlanner(name, settings, partial(started, name, command))
