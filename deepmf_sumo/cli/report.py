"""``deepmf-sumo report``: result folder -> one page for a browser."""

from pathlib import Path

import click

from deepmf_sumo.cli._parameters import results_argument


@click.command(name="report", short_help="Write a page with all runs and replays.")
@results_argument
@click.option("--open", "show", is_flag=True, help="Show the pages in the browser.")
def command(folders: tuple[Path, ...], show: bool) -> None:
    """Write report.html into each result folder OUT: all its runs, each with a replay.

    OUT may contain result folders, e.g. one for each seed. A page is one file and needs no network.
    """
    from deepmf_sumo.report import page
    from deepmf_sumo.results.reader import Results

    for folder in Results.open(*folders).folders:
        written = page.write(folder)
        click.echo(f"{written} ({written.stat().st_size / 1e6:.1f} MB)")
        if show:
            click.launch(str(written))
