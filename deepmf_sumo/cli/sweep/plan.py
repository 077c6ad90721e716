"""A plan -> a benchmark's folder: what `benchmark` and `reproduce` do."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import click

from deepmf_sumo.cli.sweep.ending import end
from deepmf_sumo.cli.sweep.options import Sweep

_OPTIONS: Final = (
    click.option(
        "--set", "sets", metavar="KEY=VALUE", multiple=True, help="Override a plan's key."
    ),
    click.option(
        "--without", metavar="METHOD", multiple=True, help="Leave a method of the plan out."
    ),
    click.option("--sumo", is_flag=True, help="Write a folder a run that sumo-gui opens."),
    click.option("--figures/--no-figures", default=True, show_default=True),
)


def plan_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: the options of a plan, beside those of every sweep."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def execute(
    file: Path,
    sweep: Sweep,
    *,
    sets: tuple[str, ...],
    without: tuple[str, ...],
    sumo: bool,
    figures: bool,
) -> int:
    """Run a plan, write its tables and figures, show the table; returns the exit code."""
    from deepmf_sumo.benchmark import study
    from deepmf_sumo.cli.screen import benchmark as screen
    from deepmf_sumo.cli.screen.runs import progress
    from deepmf_sumo.report import benchmark as report

    wanted = sweep.begin(sumo=sumo)
    loaded = study.load(file, sets, without)
    with progress() as tell:
        results = study.run(loaded, replace(wanted, shard=None), tell, wanted.shard)
    made = report.finish(sweep.out, figures=figures)
    expected = study.expected(sweep.out, wanted.shard)
    screen.show(sweep.out, results, expected, made)
    return end(sweep, results, expected - len(results))
