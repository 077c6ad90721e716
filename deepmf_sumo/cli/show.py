"""``deepmf-sumo show``: the results of folders, side by side."""

from pathlib import Path

import click

from deepmf_sumo.cli._parameters import format_option


@click.command("show", short_help="Show results side by side.")
@click.argument(
    "folders", metavar="OUT...", nargs=-1, required=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
)  # fmt: skip
@click.option("--all", "everything", is_flag=True, help="Show all metrics, not only the main ones.")
@format_option
@click.option(
    "--csv", "csv_file", type=click.Path(dir_okay=False, path_type=Path), hidden=True,
    help="Write the rows to this file.",
)  # fmt: skip
def command(folders: tuple[Path, ...], everything: bool, form: str, csv_file: Path | None) -> None:
    """Show the result folders OUT... side by side, each spec of a folder separately.

    Rates have 95 % intervals. Means are of the runs that have a value; below the table it says why
    others have none.
    """
    from deepmf_sumo import files
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report import comparison

    groups = comparison.groups(folders)
    if csv_file or form != "table":
        table = comparison.compare(groups)
    if csv_file:
        with files.writing(csv_file):
            files.write(csv_file, table.to_csv(index=False, float_format="%.4g"))
    if form == "table":
        screen.show_results(comparison.side_by_side(groups, everything=everything))
    else:
        rows = table.astype(object).where(table.notna(), None).to_dict("records")
        screen.emit(form, [{str(key): value for key, value in row.items()} for row in rows])
