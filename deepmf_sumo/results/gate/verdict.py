"""Results, thresholds and baseline -> what a continuous-integration job says.

A verdict as JUnit XML: one test case per run (scene and seed), threshold and comparison.

``failure``: a broken expectation, threshold or comparison; ``error``: a run that failed or is
missing, too few runs, or a comparison that cannot tell; ``skipped``: no vehicle to
attack, or nothing to judge by.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pandas as pd

from deepmf_sumo import files
from deepmf_sumo.errors import Ending, UsageError, exit_code
from deepmf_sumo.results import run_sets, setups
from deepmf_sumo.results.changes import LEANING, QuantityChange
from deepmf_sumo.results.frames import rows_of
from deepmf_sumo.results.gate.own_hits import SameAttacks
from deepmf_sumo.results.gate.thresholds import (
    ALL,
    UNFINISHED,
    Baseline,
    BoundJudgement,
    Thresholds,
    compare,
    judge,
    leanings,
)
from deepmf_sumo.results.junit import Mark, TestCase, write_suites
from deepmf_sumo.results.matching import Matched
from deepmf_sumo.results.quantities import COMPARABLE
from deepmf_sumo.results.run_sets import RunSet
from deepmf_sumo.spec.profiles import headline
from deepmf_sumo.tables import to_markdown

_NAMED: Final = 5
"""Situations that a sentence names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GateVerdict:
    """What holds, what does not, and why.

    Attributes:
        comparisons: None without a baseline, or where ``apart`` says why there is none.
        leanings: quantities that are worse in more pairs than chance explains.
        apart: in what the attack differs from the baseline's, so that nothing can be compared.
        same_attacks: None where hits were not repeated.
        notes: sentences on what a reader should know before trusting it.
    """

    results: RunSet
    judgements: list[BoundJudgement]
    baseline: Path | None
    comparisons: list[QuantityChange] | None
    same_attacks: SameAttacks | None
    notes: list[str]
    apart: list[str] = field(default_factory=list)
    leanings: list[QuantityChange] = field(default_factory=list)

    @property
    def ending(self) -> Ending:
        """``failed`` where runs failed or are missing, or attacks differ from the baseline's.

        Else ``broken`` for what is broken or worse; without such, ``failed`` where a comparison
        cannot tell, and ``fine``.
        """
        if self.apart or any(one.state == "unfit" for one in self.judgements):
            return "failed"
        if any(self._broken()):
            return "broken"
        return "failed" if any(self._open()) else "fine"

    @property
    def exit_code(self) -> int:
        """Of `ending`: 3, 1 or 0."""
        return exit_code(self.ending)

    def findings(self) -> Iterator[str]:
        """A sentence for each broken bound, regression, expectation and open comparison."""
        for one in self.judgements:
            if one.state == "unfit":
                yield sentence(one) + self._example(one)
        if self.apart:
            yield other_attack(self.baseline, self.apart)
        yield from self._broken()
        yield from self._open()

    def _example(self, one: BoundJudgement) -> str:
        """``; e.g. RUN: the planner ...``: why a run has no result, where that is the matter."""
        runs = self.results.runs
        [*first] = rows_of(runs[runs["run_id"].isin(one.blamed[:1])])
        return "".join(f"; e.g. {run.run_id}: {run.error}" for run in first if run.error)

    @property
    def compared(self) -> list[QuantityChange]:
        """Comparisons, and leanings."""
        return [*(self.comparisons or ()), *self.leanings]

    def _broken(self) -> Iterator[str]:
        for one in self.judgements:
            if one.state == "broken":
                at_most = one.limit in COMPARABLE and one.blamed
                yield sentence(one) + (_where(one.blamed) if at_most else "")
        for each in self.compared:
            if each.state == "worse":
                yield regression(each)
        if self.same_attacks and self.same_attacks.state == "worse":
            yield own_hits(self.same_attacks)
        for run in rows_of(self.results.runs):
            yield from (f"{run.run_id}: {broken}" for broken in run.expectations_broken)

    def _open(self) -> Iterator[str]:
        for each in self.comparisons or ():
            if each.state == "cannot tell":
                yield undecided_sentence(each)

    def failures(self, run: Any) -> list[str]:
        """Why a run is a failure: its own expectations, and the bounds that it helped to break.

        ``run``: a row of the frame.
        """
        blamed = (
            one for one in self.judgements if run.run_id in one.blamed and one.state == "broken"
        )
        broken = (f"contributes to {one.limit} of {one.group}" for one in blamed)
        return [*run.expectations_broken, *broken]


def check(
    out: Path,
    thresholds: Thresholds,
    baseline: Path | None = None,
    renewed: Path | None = None,
    repeat: Callable[[Path, Path], SameAttacks] | None = None,
) -> GateVerdict:
    """Judge a result folder.

    Args:
        out: the result folder.
        thresholds: what is allowed.
        baseline: used instead of the one that the thresholds name.
        renewed: a baseline to write from these results, whatever the verdict; it is not compared
            with.
        repeat: what repeats the hits of results and baseline, see `same_attacks.repeated`.

    Raises UsageError for a folder, a baseline or a group of thresholds that cannot be used, and
    OutputError.
    """
    found = run_sets.read(out)
    named = thresholds.baseline.results
    place = baseline or (Path(named) if named else None)
    comparisons, same_attacks = None, None
    apart: list[str] = []
    notes: list[str] = []
    leaning: list[QuantityChange] = []
    if repeat and not place:
        raise UsageError("--same-attacks repeats hits of a baseline: name it with --baseline.")
    if renewed:
        run_sets.write(renewed, found)
        if place and place.resolve() == renewed.resolve():
            place, notes = None, [f"{renewed} is written again, so nothing is compared with it"]
    old = run_sets.read(place) if place else None
    if place and old:
        apart = setups.differences(found, old)
        if not apart:
            comparisons = compare(thresholds.baseline, found, old)
            leaning = leanings(thresholds.baseline, found, old, comparisons)
            notes = list(_notes(thresholds.baseline, found, old, comparisons))
            same_attacks = repeat(out, place) if repeat else None
    before = old.runs if old and not apart else None
    return GateVerdict(
        results=found,
        judgements=[*judge(thresholds, found.runs, before), *_attacked_throughout(found)],
        baseline=place,
        comparisons=comparisons,
        same_attacks=same_attacks,
        notes=[*found.switched_off, *filter(None, [found.earlier]), *notes],
        apart=apart,
        leanings=leaning,
    )


def _attacked_throughout(found: RunSet) -> Iterator[BoundJudgement]:
    """No verdict on a live session in which attacks were off: without any, every AV is good."""
    if found.switched_off:
        yield BoundJudgement(
            group=ALL, limit="attacks_switched_off", bound=0, value=len(found.switched_off),
            unit="", runs=len(found.runs), state="unfit",
        )  # fmt: skip


def sentence(one: BoundJudgement) -> str:
    """``all runs: max_av_collision_rate is 0.4 (0.2 to 0.6, 10 runs), allowed 0.3``."""
    if one.value is None:
        return f"{one.group}: {one.limit} cannot be judged: no run has a value"
    value, interval = figure(one.value, one.unit), ""
    if one.interval:
        interval = f"{one.interval[0]:.2g} to {one.interval[1]:.2g}, "
    lower = one.limit in COMPARABLE and COMPARABLE[one.limit].worse == "lower"
    word = "at least" if lower or one.limit.startswith("min_") else "at most"
    bound = figure(one.bound, one.unit)
    return (
        f"{one.group}: {_failure(one.limit)}{one.limit} is {value}"
        f" ({interval}{one.runs} run{_s(one.runs)}), allowed {word} {bound}"
    )


def _where(blamed: Sequence[str]) -> str:
    """``; in RUN, RUN and 3 more``."""
    more = len(blamed) - _NAMED
    return f"; in {', '.join(blamed[:_NAMED])}{f' and {more} more' * (more > 0)}"


def regression(one: QuantityChange) -> str:
    """``all runs: av_collision_rate was 0.1 and is 0.4: +0.3 (+0.1 to +0.5; 40 pairs)``.

    What is worse also names where, most first: ``; most in 'cut-in' (+0.7), ...``.
    """
    what = _failure(one.quantity) if one.state == "worse" else ""
    change = f"was {_mean(one.found.old, one.unit)} and is {_mean(one.found.new, one.unit)}"
    where = ""
    if one.state == "worse" and len(one.found.each) > 1:
        known = COMPARABLE.get(one.quantity)
        sign = -1 if known and known.worse == "lower" else 1
        most = sorted(one.found.each, key=lambda unit: -sign * unit[1])[:_NAMED]
        worse = [f"'{name}' ({mean:+.3g})" for name, mean in most if sign * mean > one.tolerance]
        where = f"; most in {', '.join(worse)}" if worse else ""
    return f"{one.group}: {what}{one.quantity} {change}: {difference(one.found)}{where}"


def _failure(name: str) -> str:
    """``red run: ``: the kind of failure that a worse value of a quantity is, if it has a name."""
    quantity = COMPARABLE.get(name.removeprefix(LEANING))
    return f"{quantity.failure}: " if quantity and quantity.failure else ""


def own_hits(one: SameAttacks) -> str:
    """``same attacks: 8 hits, of which the baseline's planner avoids 6; 2 hits of the ...``."""
    text = (
        f"same attacks: {one.hits} hit{_s(one.hits)}, of which the baseline's planner avoids"
        f" {len(one.own)} where the opponent drives the same path;"
        f" {one.baseline_hits} hit{_s(one.baseline_hits)} of the baseline, of which this planner"
        f" avoids {len(one.baseline_own)} (probability by chance: {one.chance:.2g})"
    )
    if one.unrepeated:
        text += f"; {len(one.unrepeated)} did not come again, and count for neither"
    if one.own:
        more = len(one.own) - _NAMED
        text += f"; avoided: {', '.join(one.own[:_NAMED])}{f' and {more} more' * (more > 0)}"
    return text


def undecided_sentence(one: QuantityChange) -> str:
    """What the runs leave open, and how many would decide."""
    found = one.found
    if found.difference is None:
        why = "no run of both sides has a value"
    elif found.units < found.fewest:
        why = (
            f"{units(found, found.units)} can never show a change: at least"
            f" {units(found, found.fewest)} are needed"
        )
    else:
        size = figure(one.margin, one.unit)
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


def other_attack(baseline: Path | None, apart: Sequence[str]) -> str:
    """What differs, and what to do about it."""
    more = f"; and {len(apart) - _NAMED} more" if len(apart) > _NAMED else ""
    return (
        f"no verdict against {baseline}, whose attack is another one: {'; '.join(apart[:_NAMED])}"
        f"{more}; attack both planners alike, or write the baseline again with --write-baseline"
    )


def _notes(
    wanted: Baseline, new: RunSet, old: RunSet, comparisons: Sequence[QuantityChange]
) -> Iterator[str]:
    yield from setups.notes(new, old)
    compared = sum(one.state != "not judged" for one in comparisons)
    ours, theirs = set(new.runs["run_id"]), set(old.runs["run_id"])
    alone = len(ours - theirs), len(theirs - ours)
    if any(alone):
        yield f"new runs: {alone[0]}; runs of the baseline that are gone: {alone[1]}"
    yield (
        f"judged: {', '.join(wanted.quantities)}; the judged intervals ({compared}) hold together"
        f" with {100 * wanted.confidence:g} % at each end"
    )


LONGEST_LIST: Final = 20
_TITLES: Final = {0: "passed", 1: "failed", 3: "no verdict"}
_MARKS: Final = {"held": "held", "broken": "**broken**", "unfit": "**no basis**"}


def write_summary(path: Path, verdict: GateVerdict) -> None:
    """Add it to the end of a file, as job pages expect. Raises OutputError."""
    with files.writing(path):
        before = files.text(path) if path.exists() else ""
        files.write(path, before + text(verdict))


def text(verdict: GateVerdict) -> str:
    """Title, tables, and the runs to look at; long lists are cut, which the text says."""
    lines = [f"## deepmf-sumo: {_TITLES[verdict.exit_code]}", "", counts(verdict), ""]
    lines += to_markdown(
        ("group", "threshold", "allowed", "measured", "runs", ""), thresholds(verdict)
    )
    if verdict.comparisons is not None:
        lines += ["", f"Against `{verdict.baseline}`:", ""]
        lines += to_markdown(
            ("group", "quantity", "was", "is", "difference", ""), comparisons(verdict)
        )
    if verdict.apart:
        lines += ["", f"{other_attack(verdict.baseline, verdict.apart)}."]
    if verdict.same_attacks:
        same = verdict.same_attacks
        lines += ["", f"{own_hits(same)}: {same.state}. The runs: `{same.folder}`."]
    lines += [f"\n{note}." for note in verdict.notes]
    undecided = [one for one in verdict.comparisons or () if one.state == "cannot tell"]
    lines += [f"\n{undecided_sentence(one)}." for one in undecided[:LONGEST_LIST]]
    for title, found in (
        ("Runs that contribute to it", _blamed(verdict)),
        ("Runs without result", _unfinished(verdict.results.runs)),
    ):
        if found:
            lines += ["", f"### {title}", "", *found[:LONGEST_LIST]]
            more = len(found) - LONGEST_LIST
            lines += [f"- and {more} more"] if more > 0 else []
    return "\n".join(lines) + "\n\n"


def counts(verdict: GateVerdict) -> str:
    """``40 runs: 36 judged, 3 with no vehicle to attack, 1 failed or missing; profile fair``."""
    runs, attacks = verdict.results.runs, verdict.results.attacks
    told = headline(setups.meant(attacks.get(one, {})) for one in runs["setup"])
    unfinished = int(runs["status"].isin(UNFINISHED).sum())
    skipped = int((runs["status"] == "skipped").sum())
    judged = int(runs["judged"].sum())
    unattacked = len(runs) - unfinished - skipped - judged
    parts = [f"{judged} judged"]
    parts += [f"{unattacked} with no vehicle to attack"] if unattacked else []
    parts += [f"{skipped} skipped"] if skipped else []
    parts += [f"{unfinished} failed or missing"] if unfinished else []
    return f"{len(runs)} run{_s(len(runs))}: {', '.join(parts)}{'; ' * bool(told)}{told}"


def thresholds(verdict: GateVerdict) -> Iterator[tuple[str, ...]]:
    """Cells of the table of thresholds."""
    for one in verdict.judgements:
        value = "-" if one.value is None else figure(one.value, one.unit)
        if one.interval:
            value += f" ({one.interval[0]:.2g} to {one.interval[1]:.2g})"
        bound = figure(one.bound, one.unit)
        yield (one.group, one.limit, bound, value, str(one.runs), _MARKS.get(one.state, one.state))


def comparisons(verdict: GateVerdict) -> Iterator[tuple[str, ...]]:
    """Cells of the table of comparisons."""
    for one in verdict.compared:
        ends = (
            "-" if end is None else figure(end, one.unit) for end in (one.found.old, one.found.new)
        )
        state = said(one)
        state = f"**{state}**" if state in {"worse", "cannot tell"} else state
        yield (one.group, one.quantity, *ends, difference(one.found), state)


def said(one: QuantityChange) -> str:
    """What a comparison says, in the words of a gate."""
    return "passed" if one.state == "within margin" else one.state


def _blamed(verdict: GateVerdict) -> list[str]:
    return [
        f"- `{run.run_id}`: {'; '.join(found)}"
        for run in rows_of(verdict.results.runs)
        if (found := verdict.failures(run))
    ]


def _unfinished(runs: pd.DataFrame) -> list[str]:
    left = runs[runs["status"].isin(UNFINISHED)]
    return [f"- `{run.run_id}`: {run.status}, {run.error}" for run in rows_of(left)]


def write_junit(path: Path, verdict: GateVerdict) -> None:
    """Write the file. Raises OutputError."""
    suites = [("thresholds", [_threshold(one) for one in verdict.judgements])]
    if verdict.comparisons is not None:
        judged = [one for one in verdict.compared if one.state != "not judged"]
        cases = [_comparison(one) for one in judged]
        if verdict.same_attacks:
            cases.append(_same_attacks(verdict.same_attacks))
        suites.append(("baseline", cases))
    if verdict.apart:
        marks = [Mark("error", other_attack(verdict.baseline, verdict.apart))]
        case = TestCase(classname=f"baseline: {ALL}", name="attack", marks=marks)
        suites.append(("baseline", [case]))
    by_spec: dict[str, list[TestCase]] = {}
    tolerated = _tolerated(verdict)
    for run in rows_of(verdict.results.runs):
        by_spec.setdefault(str(run.spec), []).append(_run(run, verdict, tolerated=tolerated))
    with files.writing(path):
        write_suites(path, [*suites, *by_spec.items()])


def _threshold(one: BoundJudgement) -> TestCase:
    text, marks = sentence(one), []
    if one.state == "no value":
        marks = [Mark("skipped", text)]
    elif one.state not in {"held", "as before"}:
        marks = [Mark("error" if one.state == "unfit" else "failure", text)]
    return TestCase(classname=one.group, name=one.limit, marks=marks)


def _comparison(one: QuantityChange) -> TestCase:
    marks = []
    if one.state == "worse":
        marks = [Mark("failure", regression(one))]
    elif one.state == "cannot tell":
        marks = [Mark("error", undecided_sentence(one))]
    return TestCase(classname=f"baseline: {one.group}", name=one.quantity, marks=marks)


def _same_attacks(one: SameAttacks) -> TestCase:
    marks = [Mark("failure", own_hits(one))] if one.state == "worse" else []
    return TestCase(classname="baseline: all runs", name="same attacks", marks=marks)


def _run(run: Any, verdict: GateVerdict, *, tolerated: bool) -> TestCase:
    failures = verdict.failures(run)
    # in one element: most servers show only the first
    marks = [Mark("failure", "; ".join(failures))] if failures else []
    if run.status in UNFINISHED and not tolerated:
        marks.append(Mark("error", f"{run.status}: {run.error}"))
    elif run.status in UNFINISHED:
        allowed = f"allowed by max_failed_runs: {run.status}: {run.error}"
        marks.append(Mark("skipped", allowed))
    elif not (run.judged or failures):
        marks.append(Mark("skipped", run.error))
    values = ", ".join(
        f"{name} {value:g}" for name in COMPARABLE if not math.isnan(value := getattr(run, name))
    )
    return TestCase(
        classname=_classname(run),
        name=f"{run.scene} seed {run.seed}",
        seconds=getattr(run, "wall_s", 0.0),
        marks=marks,
        output=f"{values or '-'}; files: {verdict.results.source}/runs/{run.run_id}",
    )


def _tolerated(verdict: GateVerdict) -> bool:
    """Whether no more runs failed than are allowed."""
    return not any(
        one.limit == "max_failed_runs" and one.state == "unfit" for one in verdict.judgements
    )


def _classname(run: Any) -> str:
    """Spec, method and planner, each named once: they differ for equal scenes and seeds."""
    parts = (run.spec, run.method, run.planner_label)
    return " / ".join(dict.fromkeys(part for part in parts if part))
