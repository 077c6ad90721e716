"""Results against a baseline: what has become worse for the AV, and what is ruled out.

A judged quantity ends in one of three ways. It is worse where the interval of the difference lies
beyond the tolerance; it passes where the interval lies below what must be ruled out; else the runs
cannot tell. The intervals of all judged comparisons hold together (Bonferroni), at each end, so
that equal planners raise a false alarm in at most 1 - confidence of all jobs, however much is
compared.

One quantity of new and old runs -> their difference, by what the runs have in common.

Runs of equal spec, scene, planner and seed are pairs. Where seeds differ, scenes are: their means
are compared, those of a planner if both sides have it. Where scenes differ too, nothing is paired.
Runs of one scene depend on each other, so a scene (of a spec on a network: the spec) counts once,
however many seeds it has.

Randomisation tests of a difference, and the intervals that agree with them.

If nothing has changed, it is chance which of two paired values is the newer one: swapping them in
any subset of the pairs was as likely. A difference delta is refused where the observed mean is
among the most extreme of all swaps of ``difference - delta``. Solved for delta, every swap gives
the mean difference over the pairs that it swaps, and the interval is a range of quantiles of these
"typical values" (Hartigan, JASA 64, 1969). Nothing is assumed of the distribution, and rates are no
special case. Without pairs, which values belong to which side is drawn anew instead (Fisher, 1935).
"""

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from statistics import fmean
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.errors import UsageError
from deepmf_sumo.gate.rows import Results, Row
from deepmf_sumo.gate.thresholds import ALL, SHOWN, Baseline
from deepmf_sumo.results.quantities import COMPARABLE, Quantity

DRAWS: Final = 9_999
_BATCH: Final = 1_111
_EXHAUSTIVE: Final = 13
"""Up to so many pairs all subsets are taken: 8,192."""
_SEED: Final = 20241217


class Difference(NamedTuple):
    """New minus old, with a two-sided interval; an end that too few values leave open is None."""

    mean: float
    low: float | None
    high: float | None


def fewest(confidence: float) -> int:
    """Units with which `paired` can have an interval: of n, one swap in 2^n is the rarest."""
    return math.ceil(math.log2(2 / (1 - confidence)) - 1e-9)


def fewest_unpaired(confidence: float) -> int:
    """Values, half of them on each side, with which `unpaired` can have an interval."""
    rarest = (1 - confidence) / 2
    side = 1
    while math.comb(2 * side, side) * rarest < 1 - 1e-9:
        side += 1
    return 2 * side


def paired(units: Sequence[Sequence[float]], confidence: float) -> Difference:
    """Of the differences within pairs; those of one unit depend on each other and swap together."""
    sums = np.array([sum(unit) for unit in units])
    counts = np.array([len(unit) for unit in units])
    swaps = _swaps(len(units))
    typical = (swaps @ sums) / (swaps @ counts)
    return _interval(float(sums.sum() / counts.sum()), typical, confidence)


@lru_cache(maxsize=8)
def _swaps(units: int) -> Floats:
    """(swaps, units) of 1 where a unit is swapped; all that swap something, or drawn ones."""
    if units <= _EXHAUSTIVE:
        return np.array(list(product((0.0, 1.0), repeat=units)))[1:]
    drawn = np.random.default_rng(_SEED).integers(0, 2, (DRAWS, units))
    return drawn[drawn.any(1)].astype(float)


def unpaired(new: Sequence[float], old: Sequence[float], confidence: float) -> Difference:
    """Of the means of two sets of values."""
    values = np.array([*new, *old])
    mine = np.arange(len(values)) < len(new)
    observed = values[mine].mean() - values[~mine].mean()
    rng = np.random.default_rng(_SEED)
    typical: list[Floats] = []
    for _ in range(DRAWS // _BATCH):
        drawn = rng.random((_BATCH, len(values))).argsort(1)
        side, rest = drawn[:, : len(new)], drawn[:, len(new) :]
        kept = mine[side].mean(1) - mine[rest].mean(1)  # of a shift of all new values
        moved = kept < 1
        shift = values[side].mean(1) - values[rest].mean(1)
        typical.append((observed - shift[moved]) / (1 - kept[moved]))
    found = np.concatenate(typical)
    return _interval(float(observed), found, confidence, as_observed=1 + DRAWS - len(found))


def _interval(mean: float, typical: Floats, confidence: float, as_observed: int = 1) -> Difference:
    """Quantiles of the typical values.

    Arrangements as observed, one at least, are as extreme as the observation for any difference.
    """
    order = np.sort(np.round(typical, 9))  # so that sums in another order do not break ties
    rare = int((1 - confidence) / 2 * (len(order) + as_observed) + 1e-9)
    if rare < as_observed:  # not even the most extreme arrangement is rare enough
        return Difference(mean, None, None)
    beyond = rare - as_observed
    return Difference(mean, float(order[beyond]), float(order[-1 - beyond]))


_MOST_ALONE: Final = 0.5
"""Share of the smaller side; with more that the other side does not have, pairs are no use."""

Scene = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched:
    """What was compared.

    Attributes:
        by: pairs of runs, means of scenes that both sides have, or nothing in common.
        count: pairs, scenes, or runs of both sides.
        units: of them that are independent. fewest: units without which there is no interval.
        specs: whether each unit is a spec of its own; else units are scenes.
        old, new: means; None, like the difference, where there is nothing to compare.
    """

    by: Literal["pairs", "scenes", "nothing"]
    count: int
    units: int
    fewest: int
    specs: bool = False
    old: float | None = None
    new: float | None = None
    difference: Difference | None = None


def match(name: str, new: Iterable[Row], old: Iterable[Row], confidence: float) -> Matched:
    """New minus old of a quantity, with the two-sided interval of that confidence."""
    ours, theirs = ([row for row in side if name in row.values] for side in (new, old))
    if not (ours and theirs):
        return Matched(by="pairs", count=0, units=0, fewest=fewest(confidence))
    keys: tuple[tuple[Literal["pairs", "scenes"], Callable[[Row], Hashable]], ...]
    keys = (("pairs", _run), ("scenes", _situation), ("scenes", _scene))
    for by, key in keys:
        found = _paired(_means(name, ours, key), _means(name, theirs, key), confidence, by)
        if found:
            return found
    return _unpaired(_means(name, ours, _scene), _means(name, theirs, _scene), confidence)


Means = dict[Hashable, tuple[Scene, float]]


def _means(name: str, rows: Iterable[Row], key: Callable[[Row], Hashable]) -> Means:
    """Scene and mean value of all rows with the same key."""
    values: dict[Hashable, list[float]] = defaultdict(list)
    scenes: dict[Hashable, Scene] = {}
    for row in rows:
        values[key(row)].append(row.values[name])
        scenes[key(row)] = _scene(row)
    return {one: (scenes[one], fmean(found)) for one, found in values.items()}


def _paired(
    ours: Means, theirs: Means, confidence: float, by: Literal["pairs", "scenes"]
) -> Matched | None:
    """None where too many of both sides are alone."""
    both = [key for key in ours if key in theirs]
    if len(both) < _MOST_ALONE * min(len(ours), len(theirs)):
        return None
    by_scene: dict[Scene, list[float]] = defaultdict(list)
    for key in both:
        scene, value = ours[key]
        by_scene[scene].append(value - theirs[key][1])
    return Matched(
        by=by,
        count=len(both),
        units=len(by_scene),
        fewest=fewest(confidence),
        specs=_of_specs(by_scene),
        old=fmean(theirs[key][1] for key in both),
        new=fmean(ours[key][1] for key in both),
        difference=paired(list(by_scene.values()), confidence),
    )


def _unpaired(ours: Means, theirs: Means, confidence: float) -> Matched:
    new, old = ([value for _, value in side.values()] for side in (ours, theirs))
    return Matched(
        by="nothing",
        count=len(new) + len(old),
        units=len(new) + len(old),
        fewest=fewest_unpaired(confidence),
        specs=_of_specs({scene for side in (ours, theirs) for scene, _ in side.values()}),
        old=fmean(old),
        new=fmean(new),
        difference=unpaired(new, old, confidence),
    )


def _of_specs(scenes: Iterable[Scene]) -> bool:
    known = set(scenes)
    return len({spec for spec, _ in known}) == len(known)


def _run(row: Row) -> Hashable:
    return row.run_id


def _situation(row: Row) -> Hashable:
    return row.spec, row.scene, row.method, row.planner


def _scene(row: Row) -> Scene:
    return row.spec, row.scene


State = Literal["passed", "worse", "better", "cannot tell", "not judged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One quantity over one group of runs, new results and baseline.

    Attributes:
        group: e.g. ``all runs`` or ``planner idm corridor``.
        found: the difference, new minus old, and what it is of.
        tolerance: by how much it may be worse, however sure that is.
        rule_out: a worsening of this size must be ruled out for a pass.
        needed: about how many units would tell, where these cannot.
    """

    group: str
    quantity: str
    unit: str
    found: Matched
    tolerance: float
    rule_out: float
    state: State
    needed: int | None = None


def compare(wanted: Baseline, new: Results, old: Results) -> list[Comparison]:
    """A comparison for each quantity asked for, and for `SHOWN` ones, which are not judged.

    Raises UsageError where the baseline was made by another version of the program.
    """
    if new.version != old.version:
        raise UsageError(
            f"{old.source} was made by version {old.version} of deepmf-sumo and {new.source} by"
            f" {new.version}: attacks of two versions differ; make the baseline anew with"
            " --write-baseline."
        )
    groups = _groups(wanted.by, new.rows.values())
    alone = (1 - wanted.confidence) / max(len(groups) * len(wanted.quantities), 1)
    shown = [name for name in SHOWN if name not in wanted.quantities]
    return [
        _compare(
            group, COMPARABLE[name], _of(new, wanted.by, member), _of(old, wanted.by, member),
            alone if name in wanted.quantities else 1 - wanted.confidence, wanted,
        )
        for group, member in groups.items()
        for name in (*wanted.quantities, *shown)
    ]  # fmt: skip


def _groups(by: str, rows: Iterable[Row]) -> dict[str, str]:
    """Name of each group, and what its rows have in common; a baseline's own are left out."""
    if by == "all":
        return {ALL: ""}
    names = {getattr(row, by) for row in rows if row.judged}
    return {f"{by} {name}": name for name in sorted(names)}


def _of(results: Results, by: str, member: str) -> list[Row]:
    return [row for row in results.rows.values() if by == "all" or getattr(row, by) == member]


def attack_changed(new: Results, old: Results) -> tuple[int, list[str]]:
    """In how many pairs the attack was set up differently, and the settings that differ."""
    common = new.rows.keys() & old.rows.keys()
    pairs = [(new.rows[run_id], old.rows[run_id]) for run_id in sorted(common)]
    changed = [(a, b) for a, b in pairs if a.attack and b.attack and a.attack != b.attack]
    names = {
        name
        for a, b in changed
        for name in differing(new.attacks.get(a.attack, {}), old.attacks.get(b.attack, {}))
    }
    return len(changed), sorted(names)


def differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> set[str]:
    """Names of the settings that have other values; of two adversaries their names say enough."""
    if a.get("adversary") != b.get("adversary"):
        return {"adversary"}
    return {name for name in a.keys() | b.keys() if a.get(name) != b.get(name)}


def _compare(
    group: str,
    quantity: Quantity,
    new: list[Row],
    old: list[Row],
    one_sided: float,
    wanted: Baseline,
) -> Comparison:
    name = quantity.name
    found = match(name, new, old, 1 - 2 * one_sided)
    tolerance = wanted.tolerance.get(name, quantity.negligible)
    rule_out = max(wanted.rule_out.get(name, quantity.rule_out), tolerance)
    state, needed = _judged(quantity, found, tolerance, rule_out)
    if name not in wanted.quantities:
        state, needed = "not judged", None
    return Comparison(
        group=group,
        quantity=name,
        unit=quantity.unit,
        found=found,
        tolerance=tolerance,
        rule_out=rule_out,
        state=state,
        needed=needed,
    )


def _judged(
    quantity: Quantity, found: Matched, tolerance: float, rule_out: float
) -> tuple[State, int | None]:
    difference = found.difference
    if difference is None or difference.low is None or difference.high is None:
        return "cannot tell", max(found.fewest, found.units + 1)
    mean, low, high = difference.mean, difference.low, difference.high
    if quantity.worse == "lower":
        mean, low, high = -mean, -high, -low
    if low > tolerance:
        return "worse", None
    if high <= rule_out:
        return ("better" if high < 0 else "passed"), None
    to_alarm = units_needed(found, mean - low, mean - tolerance)
    to_pass = units_needed(found, high - mean, rule_out - mean)
    return "cannot tell", min((one for one in (to_alarm, to_pass) if one), default=None)


def units_needed(found: Matched, reach: float, distance: float) -> int | None:
    """About how many units would tell, if the mean stays: intervals shrink with their root.

    None where not even many would, because the mean lies at the bound.

    Args:
        found: what these units say.
        reach: of the interval, from the mean to the end.
        distance: from the mean to the bound that the end must not cross.
    """
    if distance <= 0 or reach / distance > 100:
        return None
    return max(found.fewest, found.units + 1, math.ceil(found.units * (reach / distance) ** 2))


def two_sided(
    found: Matched, negligible: float
) -> tuple[Literal["more", "less", "same", "cannot tell"], int | None]:
    """What a difference of two sides is that are equals, and how many units would tell.

    ``same`` is an interval that lies within ``negligible`` on both sides of zero.
    """
    difference = found.difference
    if difference is None or difference.low is None or difference.high is None:
        return "cannot tell", max(found.fewest, found.units + 1)
    mean, low, high = difference.mean, difference.low, difference.high
    if low > 0 or high < 0:
        return ("more" if low > 0 else "less"), None
    if -negligible <= low and high <= negligible:
        return "same", None
    reach = mean - low if mean > 0 else high - mean
    return "cannot tell", units_needed(found, reach, abs(mean))
