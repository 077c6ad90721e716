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
@click.option(
    "--csv", "csv_file", type=click.Path(dir_okay=False, path_type=Path), help="Write it."
)
def command(folders: tuple[Path, ...], csv_file: Path | None) -> None:
    """Compare the result folders FOLDERS: a row a folder and spec, rates with 95 % intervals."""
    from deepmf_sumo.benchmark import files
    from deepmf_sumo.errors import OutputError
    from deepmf_sumo.report import comparison

    table = comparison.compare(folders)
    if csv_file:
        try:
            files.write(csv_file, table.to_csv(index=False, float_format="%.4g"))
        except OSError as error:
            raise OutputError(f"{csv_file} cannot be written: {error.strerror}.") from None
    for _, row in table.iterrows():
        title = " ".join(
            str(row[name]) for name in ("planner", "perception", "version") if row[name]
        )
        click.echo(f"{row['folder']}: {row['spec']} ({title})")
        numbers = row.drop(["folder", "spec", "planner", "perception", "version"]).dropna()
        click.echo("  " + "  ".join(f"{name} {value:.3g}" for name, value in numbers.items()))
