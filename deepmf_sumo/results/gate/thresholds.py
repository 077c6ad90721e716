"""The thresholds file (strict YAML, like specs), and what is judged by it.

Against a baseline a judged quantity is worse if the interval of the difference lies beyond the
tolerance, and better if it does on the other side. It passes if the interval rules out a worsening
of the size that must be ruled out. Else the runs cannot tell. The intervals of all judged
comparisons hold together (Bonferroni), at each end: equal planners raise a false alarm in at most
1 - confidence of all jobs, and a planner that is worse by more passes in at most as many, however
much is compared. So do, apart from them, those of the shares of pairs that are worse.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from deepmf_sumo.errors import UsageError, nearest
from deepmf_sumo.results import frames
from deepmf_sumo.results.changes import QuantityChange, change, leaning
from deepmf_sumo.results.quantities import (
    COMPARABLE,
    RULES,
    TTC_CEILING_S,
    Quantity,
    no_quantity,
    share,
)
from deepmf_sumo.results.run_sets import RunSet
from deepmf_sumo.spec.document import read
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import Strict

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]


def _known(name: str) -> str:
    if name not in COMPARABLE:
        raise PydanticCustomError("rule", "{rule}", {"rule": no_quantity(name)})
    return name


def _once(names: tuple[str, ...]) -> tuple[str, ...]:
    """Each name once: a second one would widen the intervals of all."""
    return tuple(dict.fromkeys(names))


QuantityName = Annotated[str, AfterValidator(_known)]


class GroupLimits(Strict):
    """Bounds over a group of runs; None: not bounded.

    Attributes:
        max_av_collision_rate: share of the judged runs in which the AV touched anything.
        max_collision_rate: share of the attacked runs in which the opponent hit the AV.
        max_finding_rate: share of the attacked runs with a finding: a hit that the AV's error or a
            driver's error of the opponent led to, and that a driver avoids (metric `finding`).
        max_avoidable_rate: share of the hits that a reference driver would have avoided.
        max_av_at_fault_rate: share of the hits that are the AV's fault.
        min_ttc_p05: seconds; the least time to collision that 95 % of the attacked runs keep.
        min_gap_p05: metres; the least gap that 95 % of the attacked runs keep.
        max_delta_v_mps, max_collision_speed_mps: of the worst hit.
        max_failed_runs: failed, timed out or missing runs.
        max_skipped_runs: records that cannot be read.
        min_judged_runs: fewer of them are not enough for a judgement.
        limits: by quantity, the worst value that a run may have; null: any.
    """

    max_av_collision_rate: Share | None = None
    max_collision_rate: Share | None = None
    max_finding_rate: Share | None = None
    max_avoidable_rate: Share | None = None
    max_av_at_fault_rate: Share | None = None
    min_ttc_p05: Annotated[float, Field(ge=0, lt=TTC_CEILING_S)] | None = None
    min_gap_p05: Positive | None = None
    max_delta_v_mps: Positive | None = None
    max_collision_speed_mps: Positive | None = None
    max_failed_runs: Count | None = None
    max_skipped_runs: Count | None = None
    min_judged_runs: Count = 1
    limits: dict[QuantityName, float | None] = {}

    @model_validator(mode="before")
    @classmethod
    def _names_of_today(cls, values: Any) -> Any:
        old = next((name for name in _NOW if isinstance(values, dict) and name in values), None)
        if old:
            rule = f"'{old}' was replaced; write '{_NOW[old]}'"
            raise PydanticCustomError("unknown", "{rule}", {"rule": rule, "key": old})
        return values


_NOW: Final = {"max_valid_collision_rate": "max_finding_rate"}
"""Bounds of earlier versions."""


COMPARED: Final = (
    "impact_mps", "av_hardest_braking_mps2", "av_inverse_ttc_per_s", "av_inverse_time_gap_per_s",
)  # fmt: skip
"""Few, so that few units suffice: contacts by their relative speed, and how the AV drove."""
SHOWN: Final = ("impact_mps", "av_collision_rate", "finding_rate", "ttc_s", "min_gap_m")
"""Shown to the reader, judged or not."""


class Baseline(Strict):
    """What the results are compared with.

    Attributes:
        results: a results file or a result folder, beside the thresholds file; ``--baseline``
            names another.
        by: compare all runs together, or those of each planner, spec or network.
        quantities: judged; the fewer, the smaller a difference that is seen.
        confidence: of all intervals together, at each of their ends.
        tolerance: how much worse a quantity may be, in its unit; else what is negligible.
        rule_out: largest worsening that must be excluded for a pass; by default the quantity's own.
    """

    results: str | None = None
    by: Literal["all", "planner", "spec", "network"] = "all"
    quantities: Annotated[
        tuple[QuantityName, ...], Field(strict=False, min_length=1), AfterValidator(_once)
    ] = COMPARED
    confidence: Annotated[float, Field(ge=0.5, lt=1)] = 0.95
    tolerance: dict[QuantityName, Positive] = {}
    rule_out: dict[QuantityName, Positive] = {}


def _named(value: object) -> object:
    return {"results": value} if isinstance(value, str) else value


Groups = dict[str, GroupLimits]


class Thresholds(GroupLimits):
    """Bounds over all runs, and over those of single specs, networks and planners.

    Attributes:
        max_failed_runs: failed, timed out or missing runs; by default none is allowed.
        limits: by quantity, the worst value that a run may have; null: any. Rules of the road and
            of comfort have defaults (`quantities.RULES`).
        specs, networks, planners: by name; ``*`` and ``?`` stand for other characters.
    """

    version: Literal[1]
    max_failed_runs: Count = 0
    specs: Groups = {}
    networks: Groups = {}
    planners: Groups = {}
    baseline: Annotated[Baseline, BeforeValidator(_named)] = Baseline()


def load(file: Path | None) -> Thresholds:
    """The thresholds in a file, or the defaults. Raises SpecError with file, line and key."""
    if file is None:
        return Thresholds(version=1)
    document = read(file)
    found: Thresholds = checked(Thresholds, document.values, (), document)
    results = found.baseline.results
    if results is None:
        return found
    beside = str(file.parent / Path(results).expanduser())
    return found.model_copy(
        update={"baseline": found.baseline.model_copy(update={"results": beside})}
    )


ALL: Final = "all runs"
COLUMN: Final = {"spec": "spec", "network": "network", "planner": "planner_label"}
"""Of the frame, by what runs are grouped by."""
UNFINISHED: Final = {"failed", "timeout", "missing"}
_PERCENTILES: Final = {"min_ttc_p05": "ttc_s", "min_gap_p05": "min_gap_m"}
_GREATEST: Final = {
    "max_delta_v_mps": "delta_v_mps",
    "max_collision_speed_mps": "collision_speed_mps",
}
_COUNTS: Final = ("max_failed_runs", "max_skipped_runs", "min_judged_runs")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundJudgement:
    """One bound over one group of runs.

    Attributes:
        group: e.g. ``planner idm corridor``. limit: its key, e.g. ``max_av_collision_rate``.
        value: None where no run has one.
        interval: 95 % of a rate, for the reader; the value itself is judged.
        runs: with a value.
        state: ``unfit`` where the runs are not enough for a judgement; ``no value`` where there
            was nothing to measure, e.g. no hit whose speed could be too high; ``as before`` where
            runs of the baseline are beyond the bound, too, and no more than chance explains.
        blamed: ids of the runs that a broken bound is due to.
    """

    group: str
    limit: str
    bound: float
    value: float | None
    unit: str
    runs: int
    state: Literal["held", "broken", "as before", "no value", "unfit"]
    interval: tuple[float, float] | None = None
    blamed: tuple[str, ...] = ()


def judge(
    thresholds: Thresholds, runs: pd.DataFrame, old: pd.DataFrame | None = None
) -> list[BoundJudgement]:
    """Every bound, over all runs of a `run_sets.RunSet` and over each group.

    ``old``: runs of the baseline. If some of them are beyond a default limit, too, that limit is
    broken only by more runs than chance explains.

    Raises UsageError for a group that no run belongs to.
    """
    found = [
        judgement
        for group, limits, members in _groups(thresholds, runs)
        for judgement in _judge(group, limits, members)
    ]
    return found if old is None else _against(found, thresholds, runs, old)


def _against(
    found: Sequence[BoundJudgement], limits: Thresholds, new: pd.DataFrame, old: pd.DataFrame
) -> list[BoundJudgement]:
    """The judgements, where default limits are compared with the baseline."""
    default = RULES.keys() - limits.limits.keys()
    shared = [
        one
        for one in found
        if (one.group, one.state) == (ALL, "broken")
        and one.limit in default
        and _beyond(one.limit, one.bound, old).any()
    ]
    alone = (1 - limits.baseline.confidence) / max(len(shared), 1)
    kept = {id(one) for one in shared if not _more_beyond(one, new, old, alone)}
    return [replace(one, state="as before", blamed=()) if id(one) in kept else one for one in found]


def _more_beyond(
    one: BoundJudgement, new: pd.DataFrame, old: pd.DataFrame, one_sided: float
) -> bool:
    """Whether more runs break a limit than runs of the baseline and chance explain."""
    name = one.limit
    after, before = (
        runs.assign(**{name: _beyond(name, one.bound, runs).where(runs[name].notna())})
        for runs in (new, old)
    )
    return change(share(name), after, before, 1 - 2 * one_sided, one_sided=True).state == "worse"


def _beyond(name: str, bound: float, runs: pd.DataFrame) -> "pd.Series[float]":
    """1 for runs that are worse than a limit, else 0, also without a value."""
    worse = runs[name] < bound if COMPARABLE[name].worse == "lower" else runs[name] > bound
    return worse.astype(float)


def _groups(
    thresholds: Thresholds, runs: pd.DataFrame
) -> Iterator[tuple[str, GroupLimits, pd.DataFrame]]:
    yield ALL, thresholds, runs
    for kind, column in COLUMN.items():
        groups: dict[str, GroupLimits] = getattr(thresholds, f"{kind}s")
        for pattern, limits in groups.items():
            members = runs[[fnmatchcase(name, pattern) for name in runs[column]]]
            if members.empty:
                known = list(dict.fromkeys(runs[column]))
                hint = nearest(pattern, known) or f" There are {known[:5]}."
                raise UsageError(
                    f"thresholds of the {kind} '{pattern}': no run belongs to it.{hint}"
                )
            yield f"{kind} {pattern}", limits, members


def _judge(group: str, limits: GroupLimits, runs: pd.DataFrame) -> Iterator[BoundJudgement]:
    for limit in GroupLimits.model_fields:
        bound = getattr(limits, limit)
        if bound is None or limit == "limits":
            continue
        if limit in _COUNTS:
            yield _count(group, limit, bound, runs)
        elif limit in _PERCENTILES:
            yield _percentile(group, limit, bound, runs)
        elif limit in _GREATEST:
            yield _greatest(group, limit, bound, runs)
        else:
            yield _rate(group, limit, bound, runs)

    yield from _rules(group, limits, runs)


RULES_KEPT: Final = "rules_broken"
"""Limit of a judgement: how many of the limits that are set by default runs are beyond."""


def _rules(group: str, limits: GroupLimits, runs: pd.DataFrame) -> Iterator[BoundJudgement]:
    """Limits of quantities. The defaults are one judgement together, if all hold.

    Runs of earlier versions have no values, and without one nothing is said.
    """
    for name, bound in limits.limits.items():
        if bound is not None:
            yield _limit(group, name, bound, runs)
    if not isinstance(limits, Thresholds):
        return
    unset = {name: one.limit for name, one in RULES.items() if name not in limits.limits}
    found = [_limit(group, name, bound or 0.0, runs) for name, bound in unset.items()]
    broken = [one for one in found if one.state == "broken"]
    yield from broken
    most = max((one.runs for one in found), default=0)
    if most and not broken:
        yield BoundJudgement(
            group=group, limit=RULES_KEPT, bound=0, value=0, unit="", runs=most, state="held"
        )


def _limit(group: str, name: str, bound: float, runs: pd.DataFrame) -> BoundJudgement:
    """No run is worse."""
    quantity, values = COMPARABLE[name], _values(name, runs)
    if not values:
        return _without_value(group, name, bound, quantity, runs)
    worst = (min if quantity.worse == "lower" else max)(values.values())
    blamed = tuple(runs.loc[_beyond(name, bound, runs) > 0, "run_id"])
    return BoundJudgement(
        group=group, limit=name, bound=bound, value=worst, unit=quantity.unit, runs=len(values),
        state="broken" if blamed else "held", blamed=blamed,
    )  # fmt: skip


def _count(group: str, limit: str, bound: int, runs: pd.DataFrame) -> BoundJudgement:
    if limit == "min_judged_runs":
        count, blamed = int(runs["judged"].sum()), []
        fits = count >= bound
    else:
        wanted = UNFINISHED if limit == "max_failed_runs" else {"skipped"}
        blamed = list(runs.loc[runs["status"].isin(wanted), "run_id"])
        count, fits = len(blamed), len(blamed) <= bound
    return BoundJudgement(
        group=group, limit=limit, bound=bound, value=count, unit="", runs=len(runs),
        state="held" if fits else "unfit", blamed=() if fits else tuple(blamed),
    )  # fmt: skip


def _rate(group: str, limit: str, bound: float, runs: pd.DataFrame) -> BoundJudgement:
    name = limit.removeprefix("max_")
    values = _values(name, runs)
    if not values:
        return _without_value(group, limit, bound, COMPARABLE[name], runs)
    hits = [run_id for run_id, value in values.items() if value]
    rate, low, high = frames.rate(runs, name)
    broken = rate > bound
    return BoundJudgement(
        group=group, limit=limit, bound=bound, value=rate, unit="1", runs=len(values),
        state="broken" if broken else "held", interval=(low, high),
        blamed=tuple(hits) if broken else (),
    )  # fmt: skip


def _percentile(group: str, limit: str, bound: float, runs: pd.DataFrame) -> BoundJudgement:
    """The value of a run: at most 5 % of the runs are below it."""
    name = _PERCENTILES[limit]
    values = _values(name, runs)
    if not values:
        return _without_value(group, limit, bound, COMPARABLE[name], runs)
    value = float(np.percentile(list(values.values()), 5, method="inverted_cdf"))
    blamed = [run_id for run_id, each in values.items() if each < bound] if value < bound else []
    return BoundJudgement(
        group=group, limit=limit, bound=bound, value=value, unit=COMPARABLE[name].unit,
        runs=len(values), state="broken" if blamed else "held", blamed=tuple(blamed),
    )  # fmt: skip


def _greatest(group: str, limit: str, bound: float, runs: pd.DataFrame) -> BoundJudgement:
    name = _GREATEST[limit]
    values = _values(name, runs)
    if not values:
        return _without_value(group, limit, bound, COMPARABLE[name], runs)
    blamed = [run_id for run_id, each in values.items() if each > bound]
    return BoundJudgement(
        group=group, limit=limit, bound=bound, value=max(values.values()),
        unit=COMPARABLE[name].unit, runs=len(values), state="broken" if blamed else "held",
        blamed=tuple(blamed),
    )  # fmt: skip


def _without_value(
    group: str, limit: str, bound: float, quantity: Quantity, runs: pd.DataFrame
) -> BoundJudgement:
    """Fine where nothing happened that could be measured; no basis where it was not measured."""
    hits = _values("collision_rate", runs)
    missed = any(hits.values()) if quantity.of_hits else bool(hits)
    return BoundJudgement(
        group=group, limit=limit, bound=bound, value=None, unit=quantity.unit, runs=0,
        state="unfit" if missed else "no value",
    )  # fmt: skip


def _values(name: str, runs: pd.DataFrame) -> dict[str, float]:
    return dict(runs.set_index("run_id")[name].dropna())


def compare(wanted: Baseline, new: RunSet, old: RunSet) -> list[QuantityChange]:
    """A comparison for each quantity asked for, and for `SHOWN` ones, which are not judged.

    Raises UsageError where the baseline has no spec in common with the results.
    """
    ours, theirs = (set(side.runs["spec"]) for side in (new, old))
    if ours and theirs and not ours & theirs:
        raise UsageError(
            f"{new.source} and the baseline {old.source} have no spec in common ({_some(ours)};"
            f" {_some(theirs)}), so a planner cannot be compared by them: take a baseline of the"
            " same specs."
        )
    groups = _members(wanted.by, new.runs)
    alone = (1 - wanted.confidence) / max(len(groups) * len(wanted.quantities), 1)
    shown = [name for name in SHOWN if name not in wanted.quantities]
    found = []
    for group, member in groups.items():
        sides = _of(new, wanted.by, member), _of(old, wanted.by, member)
        judged = [_judged(name, *sides, alone, wanted) for name in wanted.quantities]
        beside = [_judged(name, *sides, 1 - wanted.confidence, wanted) for name in shown]
        beside = [replace(one, state="not judged", needed=None) for one in beside]
        found += [replace(one, group=group) for one in (*judged, *beside)]
    return found


def leanings(
    wanted: Baseline, new: RunSet, old: RunSet, found: Sequence[QuantityChange]
) -> list[QuantityChange]:
    """Judged numbers that are worse in more pairs than chance explains, see `changes.leaning`.

    Not those of which ``found``, the comparisons, says so already. Empty without pairs.
    """
    told = {(one.group, one.quantity) for one in found if one.state == "worse"}
    groups = _members(wanted.by, new.runs)
    numbers = [COMPARABLE[name] for name in wanted.quantities if not COMPARABLE[name].rate]
    alone = (1 - wanted.confidence) / max(len(groups) * len(numbers), 1)
    more = []
    for group, member in groups.items():
        after, before = (_of(side, wanted.by, member) for side in (new, old))
        each = (
            leaning(one, after, before, 1 - 2 * alone, one_sided=True)
            for one in numbers
            if (group, one.name) not in told
        )
        more += [replace(one, group=group) for one in each if one.state == "worse"]
    return more


def _some(names: set[str]) -> str:
    """``'cut-in', 'merge' and 4 more``."""
    first = ", ".join(f"'{name}'" for name in sorted(names)[:2])
    return first + (f" and {len(names) - 2} more" if len(names) > 2 else "")


def _members(by: str, runs: pd.DataFrame) -> dict[str, str]:
    """Name of each group, and what its runs share; groups of the baseline alone are left out."""
    if by == "all":
        return {ALL: ""}
    names = set(runs.loc[runs["judged"], COLUMN[by]])
    return {f"{by} {name}": name for name in sorted(names)}


def _of(side: RunSet, by: str, member: str) -> pd.DataFrame:
    return side.runs if by == "all" else side.runs[side.runs[COLUMN[by]] == member]


def _judged(
    name: str, new: pd.DataFrame, old: pd.DataFrame, one_sided: float, wanted: Baseline
) -> QuantityChange:
    quantity = COMPARABLE[name]
    tolerance = wanted.tolerance.get(name, quantity.negligible)
    margin = max(wanted.rule_out.get(name, quantity.rule_out), tolerance)
    bounds = tolerance, margin
    return change(quantity, new, old, 1 - 2 * one_sided, bounds, one_sided=True)
