"""``deepmf-sumo init``: networks and specs to start from."""

from pathlib import Path

import click


@click.command(name="init")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
def command(folder: Path) -> None:
    """Lay out example networks and specs in FOLDER, ready to run and to edit.

    Existing files are never overwritten.
    """
    from deepmf_sumo.cli._starter import lay_out

    written = lay_out(folder)
    specs = sum(path.suffix == ".yaml" for path in written)
    click.echo(f"{len(written)} files in {folder}, {specs} specs among them. Next:")
    click.echo(f"  cd {folder} && deepmf-sumo run scenarios/*.yaml --out results")
