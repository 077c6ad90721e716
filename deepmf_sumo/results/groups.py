"""Failures in groups, the worst first."""

import re
from collections import defaultdict
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from statistics import median
from typing import Any, Final, Literal

from deepmf_sumo.judge.avoidability.grading import GRADES
from deepmf_sumo.results.failures import Failure

AvoidedBy = Literal["careful driver", "emergency manoeuvre", "no driver", ""]
_AVOIDED_BY: Final[dict[str, AvoidedBy]] = {
    "A": "no driver",
    "B": "emergency manoeuvre",
    "C": "careful driver",
    "D": "careful driver",
}
_NUMBER: Final = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
_UNKNOWN: Final = 99.0
"""Motion of which nothing is known is not ordinary."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
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
    def avoided_by(self) -> AvoidedBy:
        """What would have avoided it from the onset on; empty where that is not known."""
        return avoided_by(self.example)

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
            "avoided_by": self.avoided_by or None,
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


def avoided_by(failure: Failure) -> AvoidedBy:
    """What would have avoided a failure: the mildest that is enough."""
    return _AVOIDED_BY[failure.grade] if failure.grade else ""


def grouped(failures: Iterable[Failure], of: int) -> list[Group]:
    """Groups of the failures of a number of runs, the worst first.

    Errors of the planner come first, then hits by avoidability, delta-v, and how ordinary the
    opponent's motion is, and last the runs that were out of time, which may be the machine's fault.
    """
    found: dict[Hashable, list[Failure]] = defaultdict(list)
    for failure in failures:
        found[_key(failure)].append(failure)
    groups = [Group(failures=tuple(sorted(one, key=_rank)), of=of) for one in found.values()]
    return sorted(groups, key=lambda group: (_rank(group.example), -len(group.failures)))


def _key(failure: Failure) -> Hashable:
    return (
        failure.kind,
        _NUMBER.sub("#", failure.reason),  # the same error at another step
        failure.conflict,
        failure.side,
        failure.priority,
        failure.turned,
        failure.ran_red,
        failure.action,
        avoided_by(failure),
    )


def _rank(failure: Failure) -> tuple[Any, ...]:
    grade = -1 if failure.grade is None else GRADES.index(failure.grade)
    ordinary = _UNKNOWN if failure.ordinary_mps2 is None else failure.ordinary_mps2
    place = {"hit": 1, "run timed out": 2}.get(failure.kind, 0)
    return (place, -grade, -failure.delta_v_mps, ordinary, failure.run.run_id)
