"""What `export` and the option ``--export`` of a sweep say."""

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import click

from deepmf_sumo.texts import shown

if TYPE_CHECKING:
    from deepmf_sumo.results.exports import Export

_LISTED: Final = 5
"""Ids of runs in a line."""


def show_exports(name: str, found: "Sequence[Export]") -> None:
    """What was written, and a line for each reason why a run was not."""
    from deepmf_sumo.report.table import counted

    written = [one for one in found if one.outcome == "written"]
    click.echo(f"{name}: {len(written)} of {counted(len(found), 'run')} written")
    if written:
        more = f" and {len(written) - 1} more" * (len(written) > 1)
        click.echo(shown(f"{written[0].path}{more}"))
    for outcome, word in (("written", "note"), ("left out", "left out"), ("failed", "failed")):
        for reason, ids in _by_reason(found, outcome).items():
            some = ", ".join(ids[:_LISTED]) + (", ..." if len(ids) > _LISTED else "")
            line = f"{word}: {counted(len(ids), 'run')}: {reason}: {some}"
            click.echo(shown(line), err=outcome == "failed")


def _by_reason(found: "Sequence[Export]", outcome: str) -> dict[str, list[str]]:
    ids = defaultdict(list)
    for one in found:
        if one.outcome == outcome and one.reason:
            ids[one.reason].append(one.run_id)
    return ids
