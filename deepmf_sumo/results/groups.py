"""Failures in groups, the worst first."""

import re
from collections import defaultdict
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from statistics import median
from typing import Any, Final, Literal, get_args

from deepmf_sumo.results import findings
from deepmf_sumo.results.failures import Failure

Class = Literal["planner", "finding", "not judged", "no finding", "out of time"]
"""Of failures, the worst first; ``no finding``: contrived and unavoidable hits."""
CLASSES: Final[tuple[Class, ...]] = get_args(Class)
_NUMBER: Final = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
_UNKNOWN: Final = 99.0
"""Motion of which nothing is known is not ordinary."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureGroup:
    """Failures of one kind, the clearest first: that is the example.

    Attributes:
        of: runs that were looked at, failures or not.
    """

    failures: tuple[Failure, ...]
    of: int

    @property
    def example(self) -> Failure:
        """What all of them have in common."""
        return self.failures[0]

    @property
    def avoided_by(self) -> str:
        """Who would have avoided it from the onset on, in words; empty where that is not known."""
        return findings.by_whom(self.example.worth)

    @property
    def worth(self) -> str:
        """What its hits are worth, in words; empty for failures that are no hits."""
        return findings.said(self.example.worth) if self.example.kind == "hit" else ""

    @property
    def kind(self) -> Class:
        """What its failures are."""
        return class_of(self.example)

    @property
    def onset_s(self) -> float | None:
        """Median time from the onset, from which the AV could have avoided it, to the contact."""
        known = [one.onset_s for one in self.failures if one.onset_s is not None]
        return median(known) if known else None

    @property
    def delta_v_mps(self) -> float:
        """Largest of the group."""
        return max(one.delta_v_mps for one in self.failures)

    def values(self) -> dict[str, Any]:
        """The group as data."""
        example, hit = self.example, self.example.kind == "hit"
        return {
            "kind": example.kind,
            "conflict": example.conflict,
            "from": example.side,
            "priority": example.priority or None,
            "av": example.action,
            "worth": self.worth or None,
            "rung": example.worth.rung if example.worth else None,
            "finding": self.kind == "finding" if hit else None,
            "avoided_by": list(drivers) if (drivers := _drivers(example)) is not None else None,
            "av_error": example.av_error or None,
            "opponent_error": example.opponent_error or None,
            "change": example.change or None,
            "last_moment_s": dict(example.last_moment_s) or None,
            "onset_s": self.onset_s,
            "delta_v_mps": round(self.delta_v_mps, 3) if hit else None,
            "opponent_rms_mps2": example.ordinary_mps2,
            "runs": len(self.failures),
            "of": self.of,
            "example": example.run.run_id,
            "folder": str(example.run.folder),
            "reason": example.reason or None,
            "run_ids": [one.run.run_id for one in self.failures],
        }


def class_of(failure: Failure) -> Class:
    """What a failure is: hits by their worth, see `findings`."""
    if failure.kind == "run timed out":
        return "out of time"
    if failure.kind != "hit":
        return "planner"
    if failure.worth is None:
        return "not judged"
    return "finding" if failure.worth.finding else "no finding"


def _drivers(failure: Failure) -> tuple[str, ...] | None:
    return failure.worth.avoided_by if failure.worth else None


def grouped(failures: Iterable[Failure], of: int) -> list[FailureGroup]:
    """Groups of the failures of a number of runs, the worst first.

    Errors of the planner come first, then findings, of which each group has one cause: errors of
    the AV before avoidable hits, what happened more often before what happened less often, then by
    how many drivers avoid them, delta-v, and how ordinary the opponent's motion is. Contrived and
    unavoidable hits follow, and last the runs that were out of time, which may be the machine's
    fault.
    """
    found: dict[Hashable, list[Failure]] = defaultdict(list)
    for failure in failures:
        found[_key(failure)].append(failure)
    groups = [FailureGroup(failures=tuple(sorted(one, key=_rank)), of=of) for one in found.values()]
    return sorted(groups, key=_order)


def causes(groups: Iterable[FailureGroup]) -> tuple[int, int]:
    """The number of distinct causes, and of the findings that have one of them."""
    found = [len(group.failures) for group in groups if group.example.cause]
    return len(found), sum(found)


def _order(group: FailureGroup) -> tuple[Any, ...]:
    place, rung, *rest = _rank(group.example)
    often = -len(group.failures) if group.example.cause else 0
    return (place, rung, often, *rest, -len(group.failures))


def _key(failure: Failure) -> Hashable:
    """Findings of one cause: who erred how, the kind of conflict, the smallest change."""
    if failure.cause:
        return failure.cause
    return (
        failure.kind,
        _NUMBER.sub("#", failure.reason),  # the same error at another step
        failure.conflict,
        failure.side,
        failure.priority,
        failure.turned,
        failure.ran_red,
        failure.action,
        failure.worth.rung if failure.worth else None,
        class_of(failure),
        _drivers(failure),
    )


def _rank(failure: Failure) -> tuple[Any, ...]:
    rung = failure.worth.rung if failure.worth else None
    drivers = len(_drivers(failure) or ())
    ordinary = _UNKNOWN if failure.ordinary_mps2 is None else failure.ordinary_mps2
    return (
        CLASSES.index(class_of(failure)), rung or "", -drivers, -failure.delta_v_mps, ordinary,
        failure.run.run_id,
    )  # fmt: skip
