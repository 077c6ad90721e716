"""Result folders -> one row each: rates with their denominators and intervals, means of metrics."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isnan
from pathlib import Path
from statistics import fmean
from typing import Any, Final

import pandas as pd

from deepmf_sumo.avoidability.grading import GRADES
from deepmf_sumo.metrics.collision import ACCIDENT_TYPES
from deepmf_sumo.metrics.statistics import wilson
from deepmf_sumo.results.reader import Results, Run

_NUMBERS: Final = ("contact_time_s", "contact_speed_mps", "generation_s", "cycle_ms_median")
"""Columns of ``runs.csv`` that are averaged."""

MEANS: Final = {
    "opponent_rms_acceleration": "rms_a_mps2",
    "feasible": "feasible",
    "on_road": "on_road",
    "candidate_perplexity": "perplexity",
    "colliding_plans": "colliding_plans",
    "predicted_contact": "predicted_rate",
    "av_ade": "av_ade_m",
}
"""Metrics of ``result.json`` that are averaged over all runs, and their columns."""
_APART: Final = ("planner", "perception", "method", "planner_label", "part")
"""Columns of ``runs.csv`` whose values are never mixed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """The runs of one spec in a result folder, and of a benchmark of one method and planner.

    Attributes:
        runs: rows of ``runs.csv``, with the contacts and metrics of their ``result.json``.
    """

    folder: Path
    spec: str
    runs: pd.DataFrame

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """A mapping a run; ``metrics`` is empty where there is no result."""
        rows = [dict(row) for row in self.runs.to_dict("records")]
        return [
            {str(name): value for name, value in row.items()}
            | {"metrics": row["metrics"] if isinstance(row.get("metrics"), dict) else {}}
            for row in rows
        ]

    @cached_property
    def ok(self) -> list[dict[str, Any]]:
        """The runs that went through."""
        return [row for row in self.rows if row["status"] == "ok"]

    @cached_property
    def attacked(self) -> list[dict[str, Any]]:
        """Of these those in which a vehicle was attacked."""
        return [row for row in self.ok if isinstance(row["opponent"], str)]

    @cached_property
    def hits(self) -> list[dict[str, Any]]:
        """The runs in which the opponent hit the AV."""
        return [row for row in self.ok if row["outcome"] == "av_opponent"]

    @staticmethod
    def fair(row: Mapping[str, Any]) -> bool:
        """Whether the opponent kept to a car's limits, and to the road at >= 95 % of its steps."""
        return bool(row["metric_on_road"] >= 0.95 and row["metric_feasible"] >= 1)

    @property
    def about(self) -> dict[str, str]:
        """Spec, method and part of a benchmark, planner and attack; empty what says no more."""
        planner = self.text("planner_label") or self._joined("planner", "perception")
        method, part = self.text("method"), self.text("part")
        return {
            "spec": self.spec,
            "method": method if method != self.spec else "",
            "part of the plan": part if part != "main" else "",
            "planner": planner,
            "attack": self._joined("adversary", "version"),
        }

    def _joined(self, *names: str) -> str:
        return " ".join(filter(None, map(self.text, names)))

    def text(self, name: str) -> str:
        """A column's text, of the first run; empty where there is none."""
        value = self.runs.iloc[0].get(name)
        return value if isinstance(value, str) else ""


def groups(folders: Sequence[Path]) -> list[Group]:
    """The runs of each folder by spec, method, planner and part of the plan, in their order.

    Raises UsageError for a folder without ``runs.csv``, and where that or a ``result.json`` is
    damaged.
    """
    return [
        Group(folder=folder, spec=str(spec), runs=runs)
        for folder in folders
        for (spec, *_), runs in _grouped(_runs(folder))
    ]


def _grouped(table: pd.DataFrame) -> Iterable[tuple[tuple[Any, ...], pd.DataFrame]]:
    names = ["spec", *(name for name in _APART if name in table)]
    found: Iterable[tuple[tuple[Any, ...], pd.DataFrame]] = table.groupby(
        names, sort=False, dropna=False
    )
    return found


def compare(found: Sequence[Group]) -> pd.DataFrame:
    """One row per group, in the order given.

    Columns: folder, spec, method, planner, perception, version, runs (that went through), attacked
    (those with an opponent), hits and their rate of these with the 95 % Wilson interval, contact
    time and relative speed (means over hits), ``third_party`` (runs in which the opponent hit
    another vehicle before or instead), ``av_other`` (runs in which the AV hit another vehicle),
    ``on_road_hits`` (hits within the limits and with the opponent on the road at >= 95 % of its
    steps), means of the metrics in `MEANS`, generation time a run and the median of a cycle.
    """
    return pd.DataFrame([_row(group) for group in found])


def _runs(folder: Path) -> pd.DataFrame:
    """``runs.csv`` with the contacts and metrics of each run's ``result.json``."""
    runs = Results.of(folder).runs
    table = pd.DataFrame([run.row for run in runs]).replace("", None)
    for name in _NUMBERS:
        table[name] = pd.to_numeric(table[name], errors="coerce")
    return pd.concat([table, pd.DataFrame(map(_details, runs))], axis=1)


def _details(run: Run) -> dict[str, Any]:
    if not run.has_result:
        return {}
    result = run.result
    kinds = {contact["kind"] for contact in result.get("contacts", [])}
    metrics = result.get("metrics", {})
    values = {name: one["value"] for name, one in metrics.items()}
    return {
        "third_party": "opponent_other" in kinds,
        "av_other": "av_other" in kinds,
        **{f"metric_{name}": values.get(name) for name in MEANS},
        "metrics": metrics,
    }


def _row(group: Group) -> dict[str, Any]:
    runs = group.runs
    ok = runs[runs["status"] == "ok"]
    attacked, hits = len(group.attacked), ok[ok["outcome"] == "av_opponent"]
    row: dict[str, Any] = {
        "folder": group.folder.name,
        "spec": group.spec,
        **{name: group.text(name) for name in ("method", "planner", "perception", "version")},
        "runs": len(ok),
        "not_ok": len(runs) - len(ok),
        "attacked": attacked,
        "hits": len(hits),
    }
    if attacked:
        row |= wilson(len(hits), attacked)._asdict()
    if len(ok):
        row |= {
            "time_s": hits["contact_time_s"].mean(),
            "speed_mps": hits["contact_speed_mps"].mean(),
            "third_party": int(ok["third_party"].sum()),
            "av_other": int(ok["av_other"].sum()),
            "on_road_hits": sum(map(Group.fair, group.hits)),
            **{column: ok[f"metric_{name}"].mean() for name, column in MEANS.items()},
            "generation_s": ok["generation_s"].mean(),
            "cycle_ms": ok["cycle_ms_median"].median(),
        }
    return row


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
