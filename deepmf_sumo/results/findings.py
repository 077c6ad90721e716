"""What a hit is worth, as its result tells it: its rung on the ladder, and the words for that.

The ladder itself is `judge.ladder`. Readers ask `worth`, and say it with `said` and `counted`;
nothing else decides or names what a hit is worth. Results of versions without a ladder have no
rungs: there a *valid* hit counts as a finding, and `earlier_note` says so.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from deepmf_sumo.judge.ladder import FINDINGS, RUNGS, Rung

APART: Final = tuple(rung for rung in RUNGS if rung not in FINDINGS)
"""Hits that are shown beside the findings, and are none."""

NAMES: Final[Mapping[Rung, str]] = {
    "A": "error of the AV", "B": "avoidable", "C": "contrived", "D": "unavoidable",
}  # fmt: skip
NOT_JUDGED: Final = "not judged"
MEANINGS: Final[Mapping[Rung, str]] = {
    "A": "the AV made the error, and the opponent kept the rules",
    "B": "the opponent made an error that drivers make, both erred, or neither, and a driver"
    " avoids the hit",
    "C": "it says little: the AV stood or crept, the hit was light, or the opponent drove as no"
    " driver does",
    "D": "no reference driver avoids the hit",
}
DRIVERS: Final[Mapping[str, str]] = {
    "cc": "a careful driver", "fsm": "the fuzzy safety model",
    "rss": "a driver that brakes as RSS requires",
    "vru": "a driver who brakes for people", "search": "braking or steering immediately",
}  # fmt: skip
"""What avoids a hit, by its name in metrics (``avoided_by_cc``) and verdicts."""


def cause_of(result: Mapping[str, Any], conflict: str | None) -> tuple[str, ...] | None:
    """What findings of one cause have in common: who erred how, the conflict, the change.

    Args:
        result: of a run, with its verdict and its cause.
        conflict: its kind.

    None where the run has no finding, or its cause is not known.
    """
    verdict, cause = result.get("finding"), result.get("cause")
    if not verdict or not cause or verdict["rung"] not in FINDINGS:
        return None
    return verdict["av_error"], verdict["opponent_error"], conflict or "", cause["change"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """What a hit is worth.

    Attributes:
        rung: None in results of versions without a ladder.
        finding: whether it counts: rung A or B; in earlier results a valid hit.
        avoided_by: names of `DRIVERS` that avoid the hit, in their order; None: not known.
    """

    rung: Rung | None
    finding: bool
    avoided_by: tuple[str, ...] | None = None


def worth(metrics: Mapping[str, float | None]) -> Worth | None:
    """What a hit with these metrics is worth; None where that was not, or could not be judged."""
    known = {driver: metrics.get(f"avoided_by_{driver}") for driver in DRIVERS}
    judged = any(value is not None for value in known.values())
    by = tuple(driver for driver, value in known.items() if value) if judged else None
    number = metrics.get("rung")
    if number is not None:
        rung = RUNGS[round(number)]
        return Worth(rung=rung, finding=rung in FINDINGS, avoided_by=by)
    valid = None if "finding" in metrics else metrics.get("valid_collision")
    return None if valid is None else Worth(rung=None, finding=valid >= 1, avoided_by=by)


def finding(metrics: Mapping[str, float | None]) -> float | None:
    """1 for an attacked run with a finding, else 0; None where that is not known."""
    name = "finding" if "finding" in metrics else "valid_collision"
    value = metrics.get(name)
    return None if value is None else float(value >= 1)


def earlier(metrics: Mapping[str, Any]) -> bool:
    """Whether the metrics are of a version without a ladder that judged hits as valid or not."""
    return "finding" not in metrics and "valid_collision" in metrics


def earlier_note(old: int, among: int) -> str:
    """A sentence on hits that an earlier version judged without a ladder; empty for none."""
    if not old:
        return ""
    return (
        f"an earlier version judged {old} of {among} hits, without the ladder: its valid hits count"
        " as findings; run them again to have their rungs"
    )


def said(one: Worth | None) -> str:
    """A hit's worth in words, e.g. ``avoidable (B)``."""
    if one is None:
        return NOT_JUDGED
    if one.rung is None:
        return "valid" if one.finding else "not valid"
    return f"{NAMES[one.rung]} ({one.rung})"


def tried(tries: Sequence[str]) -> str:
    """Several tries of an attack in words, e.g. ``4 tries: miss, hit C, hit B``; else empty."""
    if len(tries) < 2:
        return ""
    each = ", ".join(one if one == "miss" else f"hit {one}" for one in tries)
    return f"{len(tries)} tries: {each}"


def by_whom(one: Worth | None, *, words: bool = False) -> str:
    """Who avoids a hit, e.g. ``cc, search``; empty where that is not known."""
    if one is None or one.avoided_by is None:
        return ""
    named = (f"{DRIVERS[name]} ({name})" if words else name for name in one.avoided_by)
    return ", ".join(named) or "no driver"


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """How many hits are worth what.

    Attributes:
        rungs: hits by rung; all rungs are there.
        avoided_by: of the hits of rung B, by driver: a hit counts for each that avoids it.
        valid, others: of versions without a ladder, hits that are valid there, and the others.
        unjudged: hits whose worth is not known.
    """

    rungs: Mapping[Rung, int]
    avoided_by: Mapping[str, int]
    valid: int = 0
    others: int = 0
    unjudged: int = 0

    @property
    def hits(self) -> int:
        """All of them."""
        return sum(self.rungs.values()) + self.valid + self.others + self.unjudged

    @property
    def findings(self) -> int:
        """Rungs A and B, and the valid hits of earlier versions."""
        return self.rungs["A"] + self.rungs["B"] + self.valid

    @property
    def judged(self) -> int:
        """Hits whose worth is known."""
        return self.hits - self.unjudged


def count(hits: Iterable[Worth | None]) -> Count:
    """Count hits by their worth; None: not judged."""
    of = list(hits)
    known = [one for one in of if one is not None]
    rungs = Counter(one.rung for one in known)
    by = Counter(name for one in known if one.rung == "B" for name in one.avoided_by or ())
    return Count(
        rungs={rung: rungs[rung] for rung in RUNGS},
        avoided_by={name: by[name] for name in DRIVERS if by[name]},
        valid=sum(one.rung is None and one.finding for one in known),
        others=sum(one.rung is None and not one.finding for one in known),
        unjudged=len(of) - len(known),
    )


def counted(found: Count) -> str:
    """The hits by their worth, e.g. ``3 findings: 1 by an error of the AV (A), ...``."""
    if not found.hits:
        return "no findings"
    parts = []
    laddered = any(found.rungs.values())
    if laddered:
        by = ", ".join(f"{name} {number}" for name, number in found.avoided_by.items())
        whom = f"; avoided by {by}" if by else ""
        parts = [
            f"{found.rungs['A']} by an {NAMES['A']} (A)",
            f"{found.rungs['B']} {NAMES['B']} (B{whom})",
        ]
    if found.valid:
        parts.append(f"{found.valid} of an earlier version, which knows no ladder (valid hits)")
    apart = [f"{found.rungs[rung]} {NAMES[rung]} ({rung})" for rung in APART] if laddered else []
    if found.others:
        apart.append(f"{found.others} not valid in an earlier version")
    if found.unjudged:
        apart.append(f"{found.unjudged} not judged")
    head = f"{found.findings or 'no'} finding{'s' * (found.findings != 1)}"
    told = f"{head}: {', '.join(parts)}" if parts else head
    return f"{told}; apart from these {', '.join(apart)}" if apart else told


def legend(found: Count) -> list[str]:
    """What the rungs and drivers of a count are, one sentence each; those that occur."""
    rungs = [f"{rung}: {MEANINGS[rung]}" for rung in RUNGS if found.rungs[rung]]
    return rungs + [f"{name}: {DRIVERS[name]}" for name in found.avoided_by]
