"""What `benchmark` and `reproduce` share: their options, and how they run a plan."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

_OPTIONS: Final = (
    click.option(
        "--set", "sets", metavar="KEY=VALUE", multiple=True, help="Override a plan's key."
    ),
    click.option(
        "--without", metavar="METHOD", multiple=True, help="Leave a method of the plan out."
    ),
    click.option("--jobs", "-j", type=click.IntRange(1, 256), default=1, show_default=True),
    click.option(
        "--out",
        type=click.Path(file_okay=False, path_type=Path),
        default=Path("benchmark"),
        show_default=True,
    ),
    click.option("--resume", is_flag=True, help="Keep equal runs that are in the folder already."),
    click.option("--shard", metavar="I/N", help="Only every N-th run, from the I-th on."),
    click.option(
        "--max-minutes",
        metavar="M",
        type=click.FloatRange(min=0, min_open=True),
        help="Begin no run after M minutes; --resume goes on.",
    ),
    click.option(
        "--timeout",
        metavar="S",
        type=click.FloatRange(min=0, min_open=True),
        default=600.0,
        show_default=True,
        help="Seconds that one run may take.",
    ),
    click.option(
        "--memory",
        metavar="MB",
        type=click.FloatRange(min=0, min_open=True),
        default=4096.0,
        show_default=True,
        help="Memory that one run may take.",
    ),
    click.option("--pictures", is_flag=True, help="Draw a picture of every run."),
    click.option("--sumo", is_flag=True, help="Write a folder a run that sumo-gui opens."),
    click.option("--figures/--no-figures", default=True, show_default=True),
)


def options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: the options that `execute` takes."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def execute(
    file: Path,
    *,
    sets: tuple[str, ...],
    without: tuple[str, ...],
    jobs: int,
    out: Path,
    resume: bool,
    shard: str | None,
    max_minutes: float | None,
    timeout: float,
    memory: float,
    pictures: bool,
    sumo: bool,
    figures: bool,
) -> int:
    """Run a plan, write its tables and figures, show the table; returns the exit code."""
    from deepmf_sumo.benchmark import batch, study
    from deepmf_sumo.cli.screen.runs import progress
    from deepmf_sumo.report.picture import draw

    sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
    wanted = batch.Options(
        out=out,
        jobs=jobs,
        timeout_s=timeout,
        memory_mb=memory,
        minutes=max_minutes,
        draw=draw if pictures else None,
        sumo=sumo,
        resume=resume,
    )
    loaded = study.load(file, sets, without)
    part = study.Shard.parse(shard) if shard else None
    with progress() as tell:
        results = study.run(loaded, wanted, tell, part)
    return _finish(out, results, part, figures=figures)


def _finish(out: Path, results: list[Any], part: Any, *, figures: bool) -> int:
    """Readable tables and figures, and the table on the screen; returns the exit code."""
    from deepmf_sumo.benchmark import batch, study
    from deepmf_sumo.benchmark.memory import watched
    from deepmf_sumo.cli.main import INTERRUPTED
    from deepmf_sumo.cli.screen import benchmark as screen
    from deepmf_sumo.report import benchmark as report

    made = report.finish(out, figures=figures)
    expected = study.expected(out, part)
    screen.show(out, results, expected, made)
    if not watched():
        click.echo("deepmf-sumo: this system does not show memory: no --memory limit", err=True)
    return INTERRUPTED if len(results) < expected else batch.exit_code(results)
