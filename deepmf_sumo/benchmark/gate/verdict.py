"""Results, thresholds and baseline -> what a continuous-integration job says."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.benchmark.gate import comparison, limits, rows
from deepmf_sumo.benchmark.gate.comparison import Comparison
from deepmf_sumo.benchmark.gate.limits import Judgement
from deepmf_sumo.benchmark.gate.matching import Matched
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
        """3 where runs failed or are missing; else 1 for what is broken or worse.

        Without such, 3 where a comparison cannot tell, and 0.
        """
        if any(one.state == "unfit" for one in self.judgements):
            return UNFIT
        if any(self._broken()):
            return BROKEN
        return UNFIT if any(self._open()) else 0

    def findings(self) -> Iterator[str]:
        """A sentence for each broken bound, regression, expectation and open comparison."""
        yield from (sentence(one) for one in self.judgements if one.state == "unfit")
        yield from self._broken()
        yield from self._open()

    def _broken(self) -> Iterator[str]:
        yield from (sentence(one) for one in self.judgements if one.state == "broken")
        for each in self.comparisons or ():
            if each.state == "worse":
                yield regression(each)
        for row in self.results.rows.values():
            for broken in row.broken:
                yield f"{row.run_id}: {broken}"

    def _open(self) -> Iterator[str]:
        for each in self.comparisons or ():
            if each.state == "cannot tell":
                yield undecided(each)

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
        compared = sum(one.state != "not judged" for one in comparisons)
        notes = list(_notes(thresholds.baseline, found, old, compared))
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
    return f"{one.group}: {one.quantity} {told}: {difference(one.found)}"


def undecided(one: Comparison) -> str:
    """What the runs leave open, and how many would tell."""
    found = one.found
    if found.difference is None:
        why = "no run of both sides has a value"
    elif found.units < found.fewest:
        why = (
            f"{units(found, found.units)} can never show a change: at least"
            f" {units(found, found.fewest)} are needed"
        )
    else:
        size = figure(one.rule_out, one.unit)
        why = f"it may be worse by more than {size}, and may be no worse"
        if one.needed:
            why += f"; about {units(found, one.needed)} would tell"
    return f"{regression(one)}: cannot tell: {why}"


def difference(found: Matched) -> str:
    """``+0.3 (+0.1 to +0.5; 40 pairs of 8 specs)``."""
    what = {
        "pairs": f"{found.count} pair{_s(found.count)}",
        "scenes": f"{units(found, found.count)} with other seeds",
        "nothing": f"{units(found, found.count)} without pairs",
    }[found.by]
    if found.by == "pairs" and found.units != found.count:
        what += f" of {units(found, found.units)}"
    if found.difference is None:
        return f"nothing to compare ({what})"
    mean, low, high = found.difference
    if low is None or high is None:
        return f"{mean:+.3g} ({what})"
    return f"{mean:+.3g} ({low:+.3g} to {high:+.3g}; {what})"


def units(found: Matched, count: int) -> str:
    """``5 specs``, or scenes."""
    return f"{count} {'spec' if found.specs else 'scene'}{_s(count)}"


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def _mean(value: float | None, unit: str) -> str:
    return "-" if value is None else figure(value, unit)


def figure(value: float, unit: str) -> str:
    """A number with its unit; shares have none."""
    return f"{value:.3g}" if unit in {"", "1"} else f"{value:.3g} {unit}"


def _notes(wanted: Baseline, new: Results, old: Results, compared: int) -> Iterator[str]:
    changed, names = comparison.attack_changed(new, old)
    if changed:
        yield (
            f"the attack is set up differently in {changed} pairs ({', '.join(names)}):"
            " differences may be the attack's, not the AV's"
        )
    alone = len(new.rows.keys() - old.rows.keys()), len(old.rows.keys() - new.rows.keys())
    if any(alone):
        yield f"{alone[0]} runs are new, {alone[1]} of the baseline are not there any more"
    yield (
        f"judged: {', '.join(wanted.quantities)}; the judged intervals ({compared}) hold together"
        f" with {100 * wanted.confidence:g} % at each end"
    )


__all__ = [
    "Verdict", "check", "difference", "figure", "regression", "sentence", "undecided",
    "units",
]  # fmt: skip
