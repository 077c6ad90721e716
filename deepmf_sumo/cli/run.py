"""``deepmf-sumo run``: specs or a plan -> result folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import Seeds
from deepmf_sumo.cli._sweep import (
    Sweep,
    exit_code_of,
    options,
    set_option,
    show_runs,
    sweep_keys,
    write_page,
)
from deepmf_sumo.errors import UsageError

if TYPE_CHECKING:
    from deepmf_sumo.spec import Spec
    from deepmf_sumo.study.plans import Loaded


@click.command(name="run", short_help="Run specs, or a plan of methods and planners.")
@click.argument(
    "files", metavar="SPEC...|PLAN", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@set_option
@click.option("--seed", type=click.IntRange(min=0), help="Run with this seed.")
@click.option(
    "--seeds", metavar="SEEDS", type=Seeds(),
    help="Run every spec with each of these seeds, e.g. 1-20 or 1,5,9-12.",
)  # fmt: skip
@click.option(
    "-k",
    "name_filter",
    metavar="TEXT",
    default="",
    help="Make only the runs of specs whose id contains TEXT.",
)
@click.option(
    "--without", metavar="METHOD", multiple=True,
    help="Leave a method of the plan out; may be repeated.",
)  # fmt: skip
@click.option("--scenes", is_flag=True, help="Also write each run as a scene, scene.npz.")
@click.option("--report", is_flag=True, help="Write report.html: all runs, each with a replay.")
@options(out="results")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    files: tuple[Path, ...],
    seed: int | None,
    seeds: tuple[int, ...] | None,
    name_filter: str,
    without: tuple[str, ...],
    scenes: bool,
    report: bool,
    sets: tuple[str, ...],
    **wanted: Any,
) -> None:
    """Run every SPEC, or a PLAN, and write a result folder: tables, and a folder for each run.

    A PLAN compares methods x planners x scenes x seeds and gets tables (CSV, Markdown, LaTeX) and
    figures; it is run by itself. `paper` is the plan of the paper's tables:
    deepmf-sumo run paper --set source.recording=DIR.
    """
    from deepmf_sumo.cli._moments import announce_moments
    from deepmf_sumo.cli._screen import progress
    from deepmf_sumo.study import plans

    planned = any(map(plans.is_plan, files))
    keys, rest = sweep_keys(sets, "risk", *([] if planned else ["figures"]))
    _check_seeds(seed, seeds, rest)
    if planned:
        _check_alone(files, name_filter)
        chosen = list(seeds or (() if seed is None else (seed,)))
        over = [*rest, *([f"seeds={chosen}"] if chosen else [])]
        sweep = Sweep.begin(wanted, keys, pictures=False, scenes=scenes, sumo=False)
        plan = plans.load(files[0], over, without)
        ctx.exit(_run_plan(plan, sweep, page=report))
    if without:
        raise UsageError("--without is for a plan: specs have one method each.")
    sweep = Sweep.begin(wanted, keys, pictures=True, name_filter=name_filter, scenes=scenes)
    specs = _loaded(files, rest, seed, seeds)
    with progress() as show:
        results = plans.run_specs(specs, sweep.options, show, announce_moments)
    if report:
        write_page(sweep.options.out)
    ctx.exit(show_runs(sweep, results))


def _check_seeds(seed: int | None, seeds: tuple[int, ...] | None, sets: Sequence[str]) -> None:
    """Raise UsageError where seeds are said in two ways, of which one would be ignored."""
    keys = {one.partition("=")[0].strip() for one in sets} & {"seed", "seeds"}
    if seeds and (seed is not None or keys):
        other = f"--set {min(keys)}=..." if keys else "--seed"
        raise UsageError(f"--seeds goes without --seed and without {other}: leave one out.")
    if seed is not None and keys:
        raise UsageError(f"--seed goes without --set {min(keys)}=...: leave one out.")


def _check_alone(files: Sequence[Path], name_filter: str) -> None:
    if len(files) > 1:
        raise UsageError(f"{files[0]}, ...: a plan is run by itself; give one file.")
    if name_filter:
        raise UsageError("-k is for specs; --without, or --set, leaves out parts of a plan.")


def _loaded(
    files: Sequence[Path], sets: Sequence[str], seed: int | None, seeds: Sequence[int] | None
) -> "list[Spec]":
    """The specs, each with each of the seeds."""
    from deepmf_sumo.spec import load

    over = [*sets, *([] if seed is None else [f"seed={seed}"])]
    specs = [load(path, over) for path in files]
    if not seeds:
        return specs
    return [one.model_copy(update={"seed": each}) for one in specs for each in seeds]


def _run_plan(plan: "Loaded", sweep: Sweep, *, page: bool) -> int:
    """Run a plan, write its tables and figures, show the table; returns the exit code."""
    from deepmf_sumo.cli._moments import announce_moments
    from deepmf_sumo.cli._screen import progress, show_study
    from deepmf_sumo.report import benchmark
    from deepmf_sumo.study import plans

    with progress() as report:
        results = plans.run(plan, sweep.options, report, announce_moments)
    out = sweep.options.out
    made = benchmark.finish(out, figures=sweep.keys.figures)
    if page:
        write_page(out)
    expected = plans.expected(out, sweep.options.shard)
    show_study(out, results, expected, made)
    return exit_code_of(sweep, results, expected - len(results))
