"""``deepmf-sumo report``: result folder -> one page for a browser."""

from pathlib import Path

import click


@click.command(name="report", short_help="Write a page with all runs and replays.")
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--open", "show", is_flag=True, help="Show the page in the browser.")
def command(out: Path, show: bool) -> None:
    """Write OUT/report.html: all runs of a result folder, each with a replay.

    OUT is what run, attack or merge wrote. The page is one file and needs no network.
    """
    from deepmf_sumo.report import page

    written = page.write(out)
    click.echo(f"{written} ({written.stat().st_size / 1e6:.1f} MB)")
    if show:
        click.launch(str(written))
