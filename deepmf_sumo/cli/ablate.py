"""``deepmf-sumo ablate``: what each part of the networks and of the attack gains and costs."""

import sys
from pathlib import Path
from typing import Any

import click

from deepmf_sumo.errors import exit_code


@click.command(
    name="ablate", short_help="Measure what each part of DeepMF contributes.", hidden=True
)
@click.argument("file", metavar="PLAN", type=click.Path(path_type=Path))
@click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="Override a key.")
@click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Write weights, figures, runs and tables here; finished parts are kept.",
)
@click.option(
    "--jobs", "-j", type=click.IntRange(1, 256), default=1, show_default=True,
    help="Use this number of processes to compute features and to attack.",
)  # fmt: skip
@click.option(
    "--threads", type=click.IntRange(min=1),
    help="Train with this number of CPU threads.  [default: torch's own]",
)  # fmt: skip
@click.option(
    "--device", type=click.Choice(["cpu", "cuda", "auto"]), default="cpu", show_default=True,
    help="Train on this device; auto: on a GPU where there is one.",
)  # fmt: skip
@click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    help="Keep computed features in this folder.  [default: under the weights home]",
)
@click.pass_context
def command(
    ctx: click.Context, /, file: Path, sets: tuple[str, ...], out: Path, jobs: int, **settings: Any
) -> None:
    """Train, evaluate and attack with each variant of PLAN: a table of quality and cost.

    Writes ablation.csv and ablation.md after each variant. The same command resumes an interrupted
    study.
    """
    from deepmf_sumo import ablation
    from deepmf_sumo.cli._screen import show_ablation

    plan = ablation.load(file, sets)
    called = " ".join(["deepmf-sumo", *sys.argv[1:]])
    options = ablation.Options(out=out, jobs=jobs, command=called, **settings)
    rows, notes = [], []
    for row in ablation.run(plan, options, lambda line: click.echo(line, err=True)):
        rows.append(row)
        notes = ablation.notes(plan, jobs, rows)
        ablation.write(out, notes, rows)
    show_ablation(notes, rows, out)
    failed = any(attacked.failed for row in rows for attacked in row.attacks)
    ctx.exit(exit_code("failed") if failed else 0)
