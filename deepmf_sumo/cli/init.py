"""``deepmf-sumo init``: the networks and specs that come with the package, to start from."""

import shutil
import tempfile
from pathlib import Path

import click

import deepmf_sumo
from deepmf_sumo.errors import OutputError, UsageError


@click.command(name="init", short_help="Copy example networks and specs to a folder.")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
def command(folder: Path) -> None:
    """Copy example networks and specs to FOLDER, ready to run and to edit.

    Existing files are never overwritten.
    """
    written = lay_out(folder)
    specs = sum(path.suffix == ".yaml" for path in written)
    click.echo(f"{len(written)} files in {folder}, {specs} specs among them. Next:")
    click.echo(f"  cd {folder} && deepmf-sumo run scenarios/*.yaml --out results")


FOLDERS = ("scenarios", "suite", "sumo_nets")
"""Side by side, because specs name their network by a path relative to themselves."""


def starter_home() -> Path:
    """Folder that holds the networks and specs: package data, or the top of a checkout.

    Raises UsageError if the installation has neither.
    """
    package = Path(deepmf_sumo.__file__).resolve().parent
    for home in (package / "starter", package.parent):
        if all((home / folder).is_dir() for folder in FOLDERS):
            return home
    raise UsageError(
        f"The installation in {package} lacks the starter files ({', '.join(FOLDERS)}): "
        "install deepmf-sumo again."
    )


def starter_files() -> tuple[Path, ...]:
    """Files to lay out, relative to `starter_home`, sorted."""
    home = starter_home()
    found = (path for folder in FOLDERS for path in (home / folder).rglob("*") if path.is_file())
    return tuple(sorted(p.relative_to(home) for p in found if "__pycache__" not in p.parts))


def lay_out(target: Path) -> tuple[Path, ...]:
    """Copy all starter files into ``target`` (made if missing): all of them or none.

    Returns the files written. Raises UsageError naming the first file that exists already, and
    OutputError if the folder cannot be written.
    """
    files = starter_files()
    for file in files:
        if (target / file).exists():
            raise UsageError(
                f"{target / file} exists already and is left as it is: choose another folder, or "
                "move it away."
            )
    try:
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target, prefix=".init-") as staging:
            for file in files:
                copy = Path(staging) / file
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(starter_home() / file, copy)
            return _move_all(files, Path(staging), target)
    except OSError as error:
        raise OutputError(f"{target} cannot be written: {error.strerror or error}.") from None


def _move_all(files: tuple[Path, ...], staging: Path, target: Path) -> tuple[Path, ...]:
    """Rename the staged files into place; what was placed is taken back if one fails."""
    placed: list[Path] = []
    try:
        for file in files:
            (target / file).parent.mkdir(parents=True, exist_ok=True)
            placed.append((staging / file).replace(target / file))
    except BaseException:
        for path in placed:
            path.unlink(missing_ok=True)
        raise
    return tuple(placed)
