"""Groups of runs as people read them: a line a quantity with its unit, a cell a group."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from statistics import fmean
from typing import Any, Final

from deepmf_sumo.avoidability.grading import GRADES
from deepmf_sumo.metrics.collision import ACCIDENT_TYPES
from deepmf_sumo.metrics.statistics import wilson
from deepmf_sumo.report.comparison import Group

NONE: Final = "-"
_LABELS: Final = {"avoidable": "avoidable", "ttc_min": "least TTC", "min_gap": "least gap"}
"""Metrics of the key quantities whose missing values are explained."""
_SAID: Final = {*_LABELS, "collision", "collision_speed", "collision_time_s", "delta_v"}
"""Metrics that the key quantities say already."""
_NAMES: Final[Mapping[str, Sequence[str]]] = {
    "accident_type": ACCIDENT_TYPES, "avoidance_grade": GRADES,
}  # fmt: skip
"""Metrics whose values are numbers of names: they are counted, not averaged."""
_ANGLES: Final = {"pdof"}
"""Not averaged either."""
_Run = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A quantity: its label with the unit, a short one for a heading, and a cell a group."""

    label: str
    short: str
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SideBySide:
    """The quantities of all groups.

    Attributes:
        key: the quantities that matter most; short: those of them that fit in a row a group.
        more: all other metrics, under their names in docs/metrics.md; empty unless asked for.
        missing: why quantities have no value in some runs, a sentence a reason.
    """

    names: tuple[str, ...]
    about: tuple[Line, ...]
    key: tuple[Line, ...]
    more: tuple[Line, ...]
    missing: tuple[str, ...]

    @property
    def short(self) -> tuple[Line, ...]:
        """Without what other lines say as well."""
        return tuple(line for line in self.key if line.short)


def side_by_side(groups: Sequence[Group], *, everything: bool = False) -> SideBySide:
    """Put groups side by side; ``everything`` adds all metrics of ``result.json``."""
    names = [str(group.folder) for group in groups]
    units = _units(groups) if everything else {}
    labels = {name: name for name in units} | _LABELS
    return SideBySide(
        names=tuple(names),
        about=_about(groups),
        key=_key(groups),
        more=_metrics(groups, units),
        missing=_missing(groups, names, labels),
    )


def _about(groups: Sequence[Group]) -> tuple[Line, ...]:
    told = [group.about for group in groups]
    names = dict.fromkeys(name for one in told for name, text in one.items() if text)
    return tuple(
        Line(label=name, short=name, cells=tuple(one[name] or NONE for one in told))
        for name in names
    )


def _key(groups: Sequence[Group]) -> tuple[Line, ...]:
    lines: list[tuple[str, str, Callable[[Group], str]]] = [
        ("runs that went through", "runs", _went),
        ("runs in which a vehicle was attacked", "attacked", lambda one: str(len(one.attacked))),
        ("AV hit by the opponent, runs", "hits", lambda one: str(len(one.hits))),
        ("  rate (95 % interval)", "hit rate (95 %)", _rate),
        ("  of these avoidable", "avoidable", _avoidable),
        ("  of these drivable and on the road", "", _fair),
        ("AV hit another vehicle, runs", "", lambda one: _counted(one, "av_other")),
        ("opponent hit another vehicle, runs", "", lambda one: _counted(one, "third_party")),
        ("time to the hit, mean, s", "", lambda one: _of_hits(one, "contact_time_s", 1)),
        (
            "relative speed at the hit, mean, m/s",
            "speed, m/s",
            lambda one: _of_hits(one, "contact_speed_mps", 1),
        ),
        (
            "change of the AV's velocity (delta-v), mean, m/s",
            "delta-v, m/s",
            lambda one: _mean(one.hits, "delta_v", 1),
        ),
        ("least TTC, mean, s", "least TTC, s", lambda one: _mean(one.attacked, "ttc_min", 1)),
        (
            "least gap of AV and opponent, mean, m",
            "least gap, m",
            lambda one: _mean(one.attacked, "min_gap", 1),
        ),
        ("computing time of the attack, mean, s", "", _computed),
    ]
    return tuple(
        Line(label=label, short=short, cells=tuple(told(group) for group in groups))
        for label, short, told in lines
    )


def _went(group: Group) -> str:
    rest = Counter(str(one["status"]) for one in group.rows if one["status"] != "ok")
    told = "".join(f", {count} {status}" for status, count in sorted(rest.items()))
    return f"{len(group.ok)} of {len(group.rows)}{told}"


def _rate(group: Group) -> str:
    if not group.attacked:
        return NONE
    found = wilson(len(group.hits), len(group.attacked))
    return f"{100 * found.rate:.0f} % ({100 * found.low:.0f} to {100 * found.high:.0f})"


def _avoidable(group: Group) -> str:
    judged = _values(group.hits, "avoidable")
    return f"{sum(value >= 1 for value in judged)} of {len(judged)}" if group.hits else NONE


def _fair(group: Group) -> str:
    fair = sum(map(Group.fair, group.hits))
    return f"{fair} of {len(group.hits)}" if group.hits else NONE


def _counted(group: Group, name: str) -> str:
    return str(sum(one.get(name) is True for one in group.ok))


def _of_hits(group: Group, column: str, digits: int) -> str:
    return _average([float(one[column]) for one in group.hits], len(group.hits), digits)


def _computed(group: Group) -> str:
    return _average([float(one["generation_s"]) for one in group.ok], len(group.ok), 2)


def _mean(runs: Sequence[_Run], name: str, digits: int | None) -> str:
    return _average(_values(runs, name), len(runs), digits)


def _average(values: Sequence[float], runs: int, digits: int | None) -> str:
    """The mean; of how many runs, where some have no value."""
    values = [value for value in values if not isnan(value)]
    if not values:
        return NONE
    mean = fmean(values)
    text = f"{mean:.3g}" if digits is None else f"{mean:.{digits}f}"
    return text if len(values) == runs else f"{text} ({len(values)} of {runs})"


def _values(runs: Sequence[_Run], name: str) -> list[float]:
    """Of the runs that have one."""
    found = (one["metrics"].get(name, {}).get("value") for one in runs)
    return [float(value) for value in found if value is not None]


def _units(groups: Sequence[Group]) -> dict[str, str]:
    """Of all metrics that the key quantities leave out, by name."""
    units = {
        name: str(metric.get("unit", ""))
        for group in groups
        for one in group.attacked
        for name, metric in one["metrics"].items()
    }
    return {name: units[name] for name in sorted(units.keys() - _SAID - _ANGLES)}


def _metrics(groups: Sequence[Group], units: Mapping[str, str]) -> tuple[Line, ...]:
    """A line each that some run has a value of."""
    lines = (
        Line(
            label=name if unit in {"", "1", "number"} else f"{name}, {unit}",
            short="",
            cells=tuple(_cell(group, name) for group in groups),
        )
        for name, unit in units.items()
    )
    return tuple(line for line in lines if set(line.cells) != {NONE})


def _cell(group: Group, name: str) -> str:
    if name not in _NAMES:
        return _mean(group.attacked, name, None)
    words = [_NAMES[name][int(value)].replace("_", " ") for value in _values(group.attacked, name)]
    return ", ".join(f"{count} {word}" for word, count in Counter(words).most_common()) or NONE


def _missing(
    groups: Sequence[Group], names: Sequence[str], labels: Mapping[str, str]
) -> tuple[str, ...]:
    """Why there is no value, in how many runs and of which quantities; a sentence a reason.

    Quantities that miss in the same runs of all groups stand together.
    """
    found: dict[str, dict[str, dict[int, int]]] = {}
    for number, group in enumerate(groups):
        for (reason, metric), count in _reasons(group, labels).items():
            found.setdefault(reason, {}).setdefault(metric, {})[number] = count
    sentences: list[tuple[int, str]] = []
    for reason, metrics in found.items():
        alike: dict[tuple[tuple[int, int], ...], list[str]] = {}
        for metric, counts in metrics.items():
            alike.setdefault(tuple(sorted(counts.items())), []).append(labels[metric])
        for counted_in, quantities in alike.items():
            runs = ", ".join(
                f"{count} of {len(groups[number].attacked)}"
                + (f" of {names[number]}" if len(groups) > 1 else "")
                for number, count in counted_in
            )
            most = max(count for _, count in counted_in)
            sentences.append((-most, f"{reason}: {runs} ({', '.join(sorted(quantities))})"))
    return tuple(sentence for _, sentence in sorted(sentences))


def _reasons(group: Group, labels: Mapping[str, str]) -> Counter[tuple[str, str]]:
    """Attacked runs without a value, by reason and metric."""
    found: Counter[tuple[str, str]] = Counter()
    for one in group.attacked:
        for metric in labels:
            # of hits alone: it does not miss where there is none
            asked = metric != "avoidable" or one["outcome"] == "av_opponent"
            given = one["metrics"].get(metric)
            if asked and given is not None and given.get("value") is None:
                found[str(given.get("reason") or "no reason given"), metric] += 1
    return found
