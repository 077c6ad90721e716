"""A verdict as Markdown, for the page of a job."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.benchmark.gate import verdict as sentences
from deepmf_sumo.benchmark.gate.limits import UNFINISHED
from deepmf_sumo.benchmark.gate.rows import Row
from deepmf_sumo.benchmark.gate.verdict import Verdict, difference, figure
from deepmf_sumo.tables import to_markdown

LONGEST_LIST: Final = 20
_TITLES: Final = {0: "passed", 1: "failed", 3: "no verdict"}
_MARKS: Final = {"held": "held", "broken": "**broken**", "unfit": "**no basis**"}


def write(path: Path, verdict: Verdict) -> None:
    """Add it to the end of a file, as job pages expect. Raises OutputError."""
    with files.writing(path):
        before = path.read_text("utf-8") if path.is_file() else ""
        files.write(path, before + text(verdict))


def text(verdict: Verdict) -> str:
    """Title, tables, and the runs to look at; long lists are cut, and the cut is said."""
    rows = list(verdict.results.rows.values())
    lines = [f"## deepmf-sumo: {_TITLES[verdict.exit_code]}", "", counts(rows), ""]
    lines += to_markdown(
        ("group", "threshold", "allowed", "measured", "runs", ""), thresholds(verdict)
    )
    if verdict.comparisons is not None:
        lines += ["", f"Against `{verdict.baseline}`:", ""]
        lines += to_markdown(
            ("group", "quantity", "was", "is", "difference", ""), comparisons(verdict)
        )
    lines += [f"\n{note}." for note in verdict.notes]
    undecided = [one for one in verdict.comparisons or () if one.state == "cannot tell"]
    lines += [f"\n{sentences.undecided(one)}." for one in undecided[:LONGEST_LIST]]
    for title, found in (
        ("Runs with part in it", _blamed(verdict)),
        ("Runs without result", _unfinished(rows)),
    ):
        if found:
            lines += ["", f"### {title}", "", *found[:LONGEST_LIST]]
            more = len(found) - LONGEST_LIST
            lines += [f"- and {more} more"] if more > 0 else []
    return "\n".join(lines) + "\n\n"


def counts(rows: Sequence[Row]) -> str:
    """``40 runs: 36 judged, 3 with nobody to attack, 1 without result``."""
    unfinished = sum(row.status in UNFINISHED for row in rows)
    skipped = sum(row.status == "skipped" for row in rows)
    judged = sum(row.judged for row in rows)
    nobody = len(rows) - unfinished - skipped - judged
    told = [f"{judged} judged"]
    told += [f"{nobody} with nobody to attack"] if nobody else []
    told += [f"{skipped} skipped"] if skipped else []
    told += [f"{unfinished} failed or missing"] if unfinished else []
    return f"{len(rows)} runs: {', '.join(told)}"


def thresholds(verdict: Verdict) -> Iterator[tuple[str, ...]]:
    """Cells of the table of thresholds."""
    for one in verdict.judgements:
        value = "-" if one.value is None else figure(one.value, one.unit)
        if one.interval:
            value += f" ({one.interval[0]:.2g} to {one.interval[1]:.2g})"
        bound = figure(one.bound, one.unit)
        yield (one.group, one.limit, bound, value, str(one.runs), _MARKS.get(one.state, one.state))


def comparisons(verdict: Verdict) -> Iterator[tuple[str, ...]]:
    """Cells of the table of comparisons."""
    for one in verdict.comparisons or ():
        ends = (
            "-" if end is None else figure(end, one.unit) for end in (one.found.old, one.found.new)
        )
        state = f"**{one.state}**" if one.state in {"worse", "cannot tell"} else one.state
        yield (one.group, one.quantity, *ends, difference(one.found), state)


def _blamed(verdict: Verdict) -> list[str]:
    return [
        f"- `{row.run_id}`: {'; '.join(found)}"
        for row in verdict.results.rows.values()
        if (found := verdict.failures(row))
    ]


def _unfinished(rows: Iterable[Row]) -> list[str]:
    return [
        f"- `{row.run_id}`: {row.status}, {row.reason}" for row in rows if row.status in UNFINISHED
    ]
