"""Tables of evidence as text: what was attacked, how it went, and why something never was."""

from typing import Any, Final

from deepmf_sumo.results.risk.coverage import EvidenceCell
from deepmf_sumo.results.statistics import Interval

HEADINGS: Final = (
    "", "attacks", "conflicts (95 %)", "hits (95 %)", "findings (95 %)", "causes",
    "if none, why",
)  # fmt: skip
NOTE: Final = (
    "An attack counts in each row that it belongs to: rows do not add up. What was not attacked, or"
    " without a finding, is not shown to be safe."
)


def row(cell: EvidenceCell) -> tuple[str, ...]:
    """A cell in the order of `HEADINGS`."""
    if not cell.attacks:
        return name(cell), "0", "-", "-", "-", "-", cell.reason
    return (
        name(cell),
        str(cell.attacks),
        _counted(cell.conflicts, cell.conflict_rate),
        _counted(cell.hits, cell.hit_rate),
        _counted(cell.findings, cell.finding_rate),
        str(cell.causes),
        "",
    )


def name(cell: EvidenceCell) -> str:
    """What the row is about, with its subject where the table has several."""
    plain = cell.table in {"conflict", "rule"} or cell.subject == cell.table
    return cell.name if plain else f"{cell.subject}: {cell.name}"


def _counted(count: int, rate: Interval | None) -> str:
    if rate is None:
        return f"{count} (not judged)"
    return f"{count} ({100 * rate.low:.0f} to {100 * rate.high:.0f} %)"


def values(cell: EvidenceCell) -> dict[str, Any]:
    """A cell as a row of ``coverage.csv``: rates with their 95 % intervals, None where none is."""
    rates = {
        f"{name}_rate{end}": value
        for name in ("conflict", "hit", "finding")
        for end, value in zip(
            ("", "_lo", "_hi"), getattr(cell, f"{name}_rate") or (None,) * 3, strict=True
        )
    }
    own = ("table", "subject", "name", "title", "sites", "vehicles_per_hour", "attacks",
           "conflicts", "hits", "findings", "causes")  # fmt: skip
    return {**{key: getattr(cell, key) for key in own}, **rates, "reason": cell.reason}
