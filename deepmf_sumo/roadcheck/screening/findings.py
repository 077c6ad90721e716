"""What a rule finds: cases at movements and lanes, and findings, one for each rule and junction."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, Literal

Severity = Literal["error", "warning"]
SEVERITIES: Final[tuple[Severity, ...]] = ("error", "warning")
"""The most severe first."""

Rule = Literal[
    "conflicting_greens", "no_priority", "overlap", "yellow", "intergreen", "merge",
    "permissive_left", "signal_speed", "right_before_left", "missing_link", "tight_turn",
    "speed_step",
]  # fmt: skip
RULES: Final[tuple[Rule, ...]] = (
    "conflicting_greens", "no_priority", "overlap", "yellow", "intergreen", "merge",
    "permissive_left", "signal_speed", "right_before_left", "missing_link", "tight_turn",
    "speed_step",
)  # fmt: skip
"""In the order in which findings of one severity are listed."""

COLUMNS: Final = (
    "severity", "rule", "junction", "edges", "finding", "measured", "required", "unit", "cases",
    "source", "title",
)  # fmt: skip
"""Columns of ``screen.csv``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One movement, lane or pair of movements that does not hold a rule.

    Attributes:
        edges: ids of the edges that it is about.
        said: a sentence without its place and its full stop.
        measured, required: in ``unit``.
        source: where the required value is from.
    """

    rule: Rule
    severity: Severity
    junction: str
    edges: tuple[str, ...]
    said: str
    measured: float
    required: float
    unit: str
    source: str

    @property
    def rank(self) -> tuple[int, float, tuple[str, ...], str]:
        """The worst first: by severity, then by how far the value is off."""
        off = abs(self.measured - self.required)
        return SEVERITIES.index(self.severity), -round(off, 6), self.edges, self.said


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """All cases of a rule at a junction; ``worst`` is the one that is told.

    Attributes:
        edges: of all cases. cases: how many. title: readable name of the junction.
    """

    worst: Case
    edges: tuple[str, ...]
    cases: int
    title: str

    @property
    def severity(self) -> Severity:
        """Of the worst case."""
        return self.worst.severity

    @property
    def sentence(self) -> str:
        """The worst case, its place, and how many more there are."""
        more = f" ({self.cases - 1} more of the kind here)" if self.cases > 1 else ""
        return f"{self.title}: {self.worst.said}{more}."

    def columns(self) -> dict[str, Any]:
        """By name, see `COLUMNS`."""
        return {
            "severity": self.severity,
            "rule": self.worst.rule,
            "junction": self.worst.junction,
            "edges": " ".join(self.edges),
            "finding": self.sentence,
            "measured": round(self.worst.measured, 3),
            "required": round(self.worst.required, 3),
            "unit": self.worst.unit,
            "cases": self.cases,
            "source": self.worst.source,
            "title": self.title,
        }


@dataclass(slots=True)
class Judged:
    """What rules have found so far; ``not_judged``: how many could not be judged, by reason."""

    cases: list[Case] = field(default_factory=list)
    not_judged: Counter[str] = field(default_factory=Counter)


def grouped(cases: Iterable[Case], titles: dict[str, str]) -> list[Finding]:
    """One finding for each rule and junction, the worst first; ``titles`` by junction."""
    groups: dict[tuple[str, str], list[Case]] = defaultdict(list)
    for one in cases:
        groups[one.rule, one.junction].append(one)
    found = [
        Finding(
            worst=min(group, key=lambda one: one.rank),
            edges=tuple(sorted({edge for one in group for edge in one.edges})),
            cases=len(group),
            title=titles[junction],
        )
        for (_, junction), group in groups.items()
    ]
    return sorted(found, key=_worst_first)


def _worst_first(one: Finding) -> tuple[int, int, float, str]:
    rank = one.worst.rank
    return rank[0], RULES.index(one.worst.rule), rank[1], one.worst.junction


def at_least(findings: Iterable[Finding], severity: Severity) -> int:
    """How many are at least so severe."""
    return sum(SEVERITIES.index(one.severity) <= SEVERITIES.index(severity) for one in findings)
