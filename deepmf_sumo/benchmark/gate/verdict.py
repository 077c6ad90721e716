"""Results, thresholds and baseline -> what a continuous-integration job says."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.benchmark.gate import comparison, limits, rows
from deepmf_sumo.benchmark.gate.comparison import Comparison
from deepmf_sumo.benchmark.gate.limits import Judgement
from deepmf_sumo.benchmark.gate.rows import Results, Row
from deepmf_sumo.benchmark.gate.thresholds import Baseline, Thresholds

BROKEN = 1
UNFIT = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What holds, what does not, and why.

    Attributes:
        comparisons: None without a baseline.
        notes: sentences on what a reader should know before trusting it.
    """

    results: Results
    judgements: list[Judgement]
    baseline: Path | None
    comparisons: list[Comparison] | None
    notes: list[str]

    @property
    def exit_code(self) -> int:
        """3 where runs failed, are missing, or too few for a judgement; else 1 or 0."""
        if any(one.state == "unfit" for one in self.judgements):
            return UNFIT
        return BROKEN if any(self.findings()) else 0

    def findings(self) -> Iterator[str]:
        """A sentence for each broken bound, regression and expectation."""
        for one in self.judgements:
            if one.state in {"broken", "unfit"}:
                yield sentence(one)
        for each in self.comparisons or ():
            if each.state == "worse":
                yield regression(each)
        for row in self.results.rows.values():
            for broken in row.broken:
                yield f"{row.run_id}: {broken}"

    def failures(self, row: Row) -> list[str]:
        """Why a run is a failure: its own expectations, and the bounds that it helped to break."""
        blamed = (
            one for one in self.judgements if row.run_id in one.blamed and one.state == "broken"
        )
        return [*row.broken, *(f"has part in {one.limit} of {one.group}" for one in blamed)]


def check(
    out: Path, thresholds: Thresholds, baseline: Path | None = None, renewed: Path | None = None
) -> Verdict:
    """Judge a result folder.

    Args:
        out: the result folder.
        thresholds: what is allowed.
        baseline: goes before the one that the thresholds name.
        renewed: written from these results, whatever they are worth; a baseline that is renewed is
            not compared with.

    Raises UsageError for a folder, a baseline or a group of thresholds that cannot be used, and
    OutputError.
    """
    found = rows.read(out)
    judgements = limits.judge(thresholds, list(found.rows.values()))
    named = thresholds.baseline.results
    place = baseline or (Path(named) if named else None)
    comparisons, notes = None, []
    if renewed:
        rows.write(renewed, found)
        if place and place.resolve() == renewed.resolve():
            place, notes = None, [f"{renewed} is written anew, so nothing is compared with it"]
    if place:
        old = rows.read(place)
        comparisons = comparison.compare(thresholds.baseline, found, old)
        notes = list(_notes(thresholds.baseline, found, old, len(comparisons)))
    return Verdict(
        results=found,
        judgements=judgements,
        baseline=place,
        comparisons=comparisons,
        notes=notes,
    )


def sentence(one: Judgement) -> str:
    """``all runs: max_av_collision_rate is 0.4 (0.2 to 0.6, 10 runs), allowed 0.3``."""
    if one.value is None:
        return f"{one.group}: {one.limit} cannot be judged: no run has a value"
    value, interval = figure(one.value, one.unit), ""
    if one.interval:
        interval = f"{one.interval[0]:.2g} to {one.interval[1]:.2g}, "
    word = "at least" if one.limit.startswith("min_") else "at most"
    bound = figure(one.bound, one.unit)
    return (
        f"{one.group}: {one.limit} is {value} ({interval}{one.runs} runs), allowed {word} {bound}"
    )


def regression(one: Comparison) -> str:
    """``all runs: av_collision_rate was 0.1 and is 0.4: +0.3 (+0.1 to +0.5; 40 pairs)``."""
    told = f"was {_mean(one.found.old, one.unit)} and is {_mean(one.found.new, one.unit)}"
    return f"{one.group}: {one.quantity} {told}: {change(one)}"


def change(one: Comparison) -> str:
    """The difference with its interval, and of how many."""
    words = {"pairs": "pairs", "scenes": "scenes with other seeds", "nothing": "without pairs"}
    what = f"{one.found.count} {words[one.found.by]}"
    if one.found.difference is None:
        return f"nothing to compare ({what})"
    mean, low, high = one.found.difference
    if low is None or high is None:
        return f"{mean:+.3g}, too few to tell ({what})"
    return f"{mean:+.3g} ({low:+.3g} to {high:+.3g}; {what})"


def _mean(value: float | None, unit: str) -> str:
    return "-" if value is None else figure(value, unit)


def figure(value: float, unit: str) -> str:
    """A number with its unit; shares have none."""
    return f"{value:.3g}" if unit in {"", "1"} else f"{value:.3g} {unit}"


def _notes(wanted: Baseline, new: Results, old: Results, compared: int) -> Iterator[str]:
    changed = comparison.attack_changed(new, old)
    if changed:
        yield (
            f"the attack is set up differently in {changed} pairs (adversary, its settings or"
            " weights): differences may be the attack's, not the AV's"
        )
    alone = len(new.rows.keys() - old.rows.keys()), len(old.rows.keys() - new.rows.keys())
    if any(alone):
        yield f"{alone[0]} runs are new, {alone[1]} of the baseline are not there any more"
    yield f"all {compared} intervals hold together with {100 * wanted.confidence:g} %"


__all__ = ["Verdict", "change", "check", "figure", "regression", "sentence"]
