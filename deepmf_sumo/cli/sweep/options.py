"""The options of every sweep, and what they ask for."""

import functools
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import click

from deepmf_sumo.cli._parameters import FiniteRange

_POSITIVE: Final = FiniteRange(min=0, min_open=True)
_GIVEN: Final = click.Path(exists=True, path_type=Path)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How runs are done, where their results go, and how they are judged; an option each."""

    jobs: int | None
    executor: str
    out: Path
    resume: bool
    overwrite: bool
    shard: str | None
    max_minutes: float | None
    timeout: float
    memory: float
    gui: bool
    pictures: bool
    junit: bool
    thresholds: Path | None
    baseline: Path | None

    def begin(self, **more: Any) -> Any:
        """Options of a batch, ``more`` of them the command's own.

        Raises UsageError for what would show only after hours of runs: a shard, an executor,
        thresholds or a baseline that are wrong; OutputError for a folder that cannot be used.
        """
        from deepmf_sumo.benchmark import batch, executors
        from deepmf_sumo.benchmark.shards import Shard
        from deepmf_sumo.cli.sweep import judging
        from deepmf_sumo.report.picture import draw

        sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
        judging.check(self)
        self._check_gui()
        shard = Shard.parse(self.shard) if self.shard else None
        executor = executors.chosen(self.executor, self.jobs)
        self._check_place()
        executor.check()
        return batch.Options(
            out=self.out,
            executor=self.executor,
            jobs=1 if self.gui else self.jobs,
            timeout_s=None if self.gui else self.timeout,
            memory_mb=None if self.gui else self.memory,
            minutes=self.max_minutes,
            shard=shard,
            draw=draw if self.pictures else None,
            gui=self.gui,
            junit=self.junit,
            resume=self.resume,
            overwrite=self.overwrite,
            **more,
        )

    def _check_place(self) -> None:
        from deepmf_sumo.benchmark import store
        from deepmf_sumo.errors import UsageError

        if self.resume and self.overwrite:
            raise UsageError(
                "--resume keeps the results in the folder, and --overwrite deletes them: leave one"
                " of them out."
            )
        store.check(self.out, resume=self.resume, overwrite=self.overwrite)

    def _check_gui(self) -> None:
        from deepmf_sumo.errors import UsageError

        if self.gui and self.executor != "local":
            raise UsageError(
                f"--gui shows runs on this machine: leave --executor {self.executor} out."
            )
        needs_one = sys.platform not in {"win32", "darwin"}
        display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
        if self.gui and needs_one and not display:  # the run would wait for sumo-gui for ever
            raise UsageError(
                "--gui: there is no display (DISPLAY is not set); leave it out, or put xvfb-run -a"
                " before the command."
            )


def options(*, out: str, pictures: bool) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: a command's last parameter is ``sweep``, with the values of the shared options.

    Args:
        out: the result folder where none is named.
        pictures: whether each run is drawn unless asked otherwise.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def called(*args: Any, **values: Any) -> Any:
            shared = {field.name: values.pop(field.name) for field in fields(Sweep)}
            return command(*args, **values, sweep=Sweep(**shared))

        decorated: Callable[..., Any] = called
        for option in reversed((*_place(out), *_limits(), *_shown(pictures), *_judged())):
            decorated = option(decorated)
        return decorated

    return decorate


def _place(out: str) -> tuple[Callable[..., Any], ...]:
    """Where runs are done, and where their results go."""
    return (
        click.option(
            "--jobs", "-j", type=click.IntRange(1, 4096),
            help="Runs at a time.  [default: 1; with Ray all its processors]",
        ),
        click.option(
            "--executor", metavar="WHERE", default="local", show_default=True,
            help="local, ray (this machine's cluster), or ray://HOST:PORT.",
        ),
        click.option("--out", type=click.Path(path_type=Path), default=out, show_default=True),
        click.option(
            "--resume", is_flag=True, help="Keep equal runs that are in the folder already."
        ),
        click.option(
            "--overwrite", is_flag=True, help="Delete the results that the folder holds."
        ),
        click.option(
            "--shard", metavar="I/N",
            help="Only every N-th run, from the I-th on; `deepmf-sumo merge` joins the shards.",
        ),
    )  # fmt: skip


def _limits() -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--max-minutes", metavar="M", type=_POSITIVE,
            help="Begin no run after M minutes; ends with 130, and --resume goes on.",
        ),
        click.option(
            "--timeout", metavar="S", type=_POSITIVE, default=600.0, show_default=True,
            help="Seconds that one run may take.",
        ),
        click.option(
            "--memory", metavar="MB", type=_POSITIVE, default=4096.0, show_default=True,
            help="Memory that one run may take.",
        ),
    )  # fmt: skip


def _shown(pictures: bool) -> tuple[Callable[..., Any], ...]:
    return (
        click.option("--gui", is_flag=True, help="Show each run in sumo-gui, one at a time."),
        click.option(
            "--pictures/--no-pictures", default=pictures, show_default=True,
            help="Draw a picture of every run.",
        ),
        click.option("--junit", is_flag=True, help="Write junit.xml."),
    )  # fmt: skip


def _judged() -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--thresholds", metavar="FILE", type=_GIVEN,
            help="Judge the results as `deepmf-sumo check` does, and end with its exit code.",
        ),
        click.option(
            "--baseline", metavar="RESULTS", type=_GIVEN,
            help="With --thresholds: earlier results to compare with.",
        ),
    )  # fmt: skip
