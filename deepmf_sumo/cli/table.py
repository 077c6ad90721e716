"""``deepmf-sumo table``: what result folders say, side by side."""

from pathlib import Path

import click


@click.command("table")
@click.argument(
    "folders",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
)
@click.option("--all", "everything", is_flag=True, help="All metrics, not only the main ones.")
@click.option(
    "--csv", "csv_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it."
)
def command(folders: tuple[Path, ...], everything: bool, csv_file: Path | None) -> None:
    """Show the result folders FOLDERS side by side, each spec of a folder on its own.

    Rates have 95 % intervals. Means are of the runs that have a value; under the table stands why
    others have none.
    """
    from deepmf_sumo import files
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report import comparison
    from deepmf_sumo.report.comparison import side_by_side

    groups = comparison.groups(folders)
    if csv_file:
        table = comparison.compare(groups)
        with files.writing(csv_file):
            files.write(csv_file, table.to_csv(index=False, float_format="%.4g"))
    screen.show_results(side_by_side(groups, everything=everything))
