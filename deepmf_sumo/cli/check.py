"""``deepmf-sumo check``: a result folder against thresholds and a baseline."""

from pathlib import Path

import click

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(name="check")
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--thresholds", "-t", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    required=True, help="What is allowed, in YAML.",
)  # fmt: skip
@click.option(
    "--baseline", type=click.Path(exists=True, path_type=Path),
    help="Earlier results: a file of --write-baseline, or a result folder.",
)  # fmt: skip
@click.option("--junit", type=_FILE, help="Write JUnit XML.")
@click.option("--summary", type=_FILE, help="Add a Markdown summary to a file.")
@click.option("--write-baseline", type=_FILE, help="Write what later jobs compare with.")
@click.pass_context
def command(
    ctx: click.Context,
    out: Path,
    thresholds: Path,
    baseline: Path | None,
    junit: Path | None,
    summary: Path | None,
    write_baseline: Path | None,
) -> None:
    """Judge the result folder OUT, for continuous integration.

    \b
    Exit codes: 0 all holds; 1 a threshold or an expectation is broken, or something is worse than
    the baseline; 2 a file is wrong; 3 no verdict: runs failed or are missing, too few say
    anything, or they cannot tell whether something is worse than the baseline.
    """
    from deepmf_sumo import gate
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.gate import verdict as junit_xml
    from deepmf_sumo.gate import verdict as markdown

    verdict = gate.check(out, gate.load(thresholds), baseline, write_baseline)
    screen.show_verdict(verdict)
    if junit:
        junit_xml.write_junit(junit, verdict)
    if summary:
        markdown.write_summary(summary, verdict)
    ctx.exit(verdict.exit_code)
