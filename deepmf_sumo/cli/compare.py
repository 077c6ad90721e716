"""``deepmf-sumo compare``: two results side by side, and where a difference comes from."""

from pathlib import Path

import click

from deepmf_sumo.cli._parameters import RESULTS, FiniteRange, format_option


@click.command(name="compare", short_help="Compare two results, with intervals.")
@click.argument("a", type=RESULTS)
@click.argument("b", type=RESULTS)
@format_option
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path),
    help="Write the tables to a folder, as CSV and Markdown.",
)  # fmt: skip
@click.option(
    "--quantity", "quantities", multiple=True, metavar="NAME",
    help="Compare this instead of the usual quantities; may be repeated.",
)  # fmt: skip
@click.option(
    "--confidence", type=FiniteRange(0.5, 1, max_open=True), default=0.95, show_default=True,
    help="Give all intervals of a table this simultaneous confidence level.",
)  # fmt: skip
def command(
    a: Path, b: Path, form: str, out: Path | None, quantities: tuple[str, ...], confidence: float
) -> None:
    """Compare the results B with the results A: two designs of a network, or two planners.

    A and B are folders of attack or run, or contain such folders, e.g. one for each seed. Runs of
    the same moment and seed are pairs.
    """
    from deepmf_sumo.cli import _risk_screen
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report.risk import two_sides as files
    from deepmf_sumo.results.risk import two_sides

    compared = two_sides.compare(a, b, quantities or two_sides.COMPARED, confidence)
    names = str(a), str(b)
    if form == "table":
        _risk_screen.show_comparison(compared, names)
    elif form == "md":
        click.echo(files.markdown(compared, names), nl=False)
    else:
        screen.emit(form, files.difference_rows(compared))
    if out:
        files.write(out, compared, names)
        click.echo(f"{out}/{files.TEXT}, {files.DIFFERENCES}, {files.ORIGINS}", err=form != "table")
