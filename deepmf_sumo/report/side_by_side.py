"""Result folders side by side: rates with their denominators and intervals, means of metrics."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final

import pandas as pd

from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.judge.avoidability.grading import GRADES
from deepmf_sumo.judge.ladder import RUNGS
from deepmf_sumo.results import findings, frames, statistics
from deepmf_sumo.results.findings import APART, NAMES
from deepmf_sumo.results.quantities import AVERAGED, BY_NAME
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.spec.profiles import described, published

_APART: Final = (
    "spec", "planner", "perception", "method", "planner_label", "part", "profile", "constraints",
)  # fmt: skip
"""Columns whose values are never mixed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunGroup:
    """The runs of one spec in a result folder, and of a benchmark of one method and planner.

    Attributes:
        runs: in the order of ``table``, their frame.
    """

    folder: Path
    runs: tuple[Run, ...]
    table: pd.DataFrame

    @cached_property
    def ok(self) -> pd.DataFrame:
        """The successful runs."""
        return self.table[self.table["status"] == "ok"]

    @cached_property
    def attacked(self) -> pd.DataFrame:
        """Of these those in which a vehicle was attacked."""
        return self.table[self.table["attacked"]]

    @cached_property
    def hits(self) -> pd.DataFrame:
        """The runs in which the opponent hit the AV."""
        return self.table[self.table["hit"]]

    def runs_of(self, part: pd.DataFrame) -> list[Run]:
        """The runs of rows of ``table``."""
        return [self.runs[place] for place in self.table.index.get_indexer(part.index)]

    @property
    def rate(self) -> statistics.Interval:
        """Of hits, of the attacked runs; ValueError without any."""
        return frames.rate(self.attacked, "hit")

    @cached_property
    def worth(self) -> findings.Count:
        """What the hits are worth."""
        return findings.count(run.worth for run in self.runs_of(self.hits))

    @cached_property
    def tries(self) -> list[list[str]]:
        """Of each run that looked for a finding what its tries were."""
        return [found for run in self.runs_of(self.attacked) if (found := run.tries)]

    @property
    def on_road_hits(self) -> int:
        """Hits of an opponent within a car's limits, and on the road at >= 95 % of its steps."""
        return int(((self.hits["on_road"] >= 0.95) & (self.hits["feasible"] >= 1)).sum())

    def touched(self, kind: str) -> int:
        """Runs with a contact of a kind, e.g. ``av_other``."""
        contacts = self._contacts
        return int(contacts.loc[contacts["kind"] == kind, "run_id"].nunique())

    @cached_property
    def _contacts(self) -> pd.DataFrame:
        return Results(folders=(self.folder,), runs=self.runs).frame("contacts")

    @property
    def about(self) -> dict[str, str]:
        """Spec, method and part of a benchmark, planner and attack; empty what says no more."""
        spec, method, part = map(self.text, ("spec", "method", "part"))
        return {
            "spec": spec,
            "method": method if method != spec else "",
            "part of the plan": part if part != "main" else "",
            "planner": self.text("planner_label"),
            "attack": self._joined("adversary", "version") + self._form(),
            "profile": described(self.text("profile"), self.text("constraints").split()),
        }

    def _form(self) -> str:
        """`` as published`` of DeepMF's ``form: paper``, by the first result."""
        run = next((one for one in self.runs if one.has_result), None)
        settings = {} if run is None else run.result["settings"]["adversary"] or {}
        return " as published" if published(settings) else ""

    def _joined(self, *names: str) -> str:
        return " ".join(filter(None, map(self.text, names)))

    def text(self, name: str) -> str:
        """A column's text, of the first run; empty where there is none."""
        return self.table[name].iloc[0] or ""


def groups(folders: Sequence[Path]) -> list[RunGroup]:
    """The runs of each folder by spec, method, planner and part of the plan, in their order.

    Raises UsageError for a folder without ``runs.csv``, and where that or a ``result.json`` is
    damaged.
    """
    found = []
    for folder in Results.open(*folders).folders:
        results = Results.of(folder)
        table = results.frame()
        apart: dict[tuple[str | None, ...], list[int]] = {}
        for place, key in enumerate(zip(*(table[name] for name in _APART), strict=True)):
            apart.setdefault(key, []).append(place)
        found += [
            RunGroup(
                folder=folder,
                runs=tuple(results.runs[place] for place in places),
                table=table.iloc[places],
            )
            for places in apart.values()
        ]
    return found


def compare(found: Sequence[RunGroup]) -> pd.DataFrame:
    """One row per group, in the order given.

    Columns: folder, spec, method, planner, perception, version, runs (successful), attacked (those
    with an opponent), hits and their rate of these with the 95 % interval, contact time and
    relative speed (means over hits), ``third_party`` (runs in which the opponent hit another
    vehicle before or instead), ``av_other`` (runs in which the AV hit another vehicle),
    ``on_road_hits`` (hits within the limits and with the opponent on the road at >= 95 % of its
    steps), means of the metrics in `AVERAGED`, generation time per run and the median of a cycle.
    """
    names = _names(group.folder for group in found)
    return pd.DataFrame([_row(group, names[group.folder]) for group in found])


def _names(folders: Iterable[Path]) -> dict[Path, str]:
    """The ends of paths that tell folders apart: ``x``, or ``a/x`` and ``b/x``."""
    paths = {folder: folder.resolve().parts for folder in dict.fromkeys(folders)}
    names: dict[Path, str] = {}
    for folder, parts in paths.items():
        others = [each for other, each in paths.items() if other != folder and each != parts]
        least = next(
            (n for n in range(1, len(parts)) if all(each[-n:] != parts[-n:] for each in others)),
            len(parts),
        )
        names[folder] = str(Path(*parts[-least:]))
    return names


def _row(group: RunGroup, name: str) -> dict[str, Any]:
    row: dict[str, Any] = {
        "folder": name,
        **{
            name: group.text(name)
            for name in ("spec", "method", "planner", "perception", "version")
        },
        "runs": len(group.ok),
        "not_ok": len(group.runs) - len(group.ok),
        "attacked": len(group.attacked),
        "hits": len(group.hits),
    }
    if len(group.attacked):
        row |= group.rate._asdict()
    if len(group.ok):
        row |= {
            "time_s": _middle(_values(group.hits, "contact_time_s")),
            "speed_mps": _middle(_values(group.hits, "contact_speed_mps")),
            "third_party": group.touched("opponent_other"),
            "av_other": group.touched("av_other"),
            "on_road_hits": group.on_road_hits,
            **{column: _middle(_values(group.ok, name)) for name, column in AVERAGED.items()},
            "generation_s": _middle(_values(group.ok, "generation_s")),
            "cycle_ms": _middle(_values(group.ok, "cycle_ms_median"), median),
        }
    return row


def _middle(
    values: Sequence[float], of: Callable[[Sequence[float]], float] = fmean
) -> float | None:
    return of(values) if values else None


NONE: Final = "-"
_LABELS: Final = {
    "finding": BY_NAME["finding_rate"].title.lower(),
    **{one.metric: one.label for one in map(BY_NAME.__getitem__, ("ttc_min_s", "min_gap_m"))},
}
"""Metrics of the key quantities whose missing values are explained."""
_SHOWN: Final = {"finding", "collision", *(one.metric for one in BY_NAME.values() if one.words)}
"""Metrics that the key quantities contain."""
_NAMES: Final[Mapping[str, Sequence[str]]] = {
    "accident_type": ACCIDENT_TYPES, "avoidance_grade": GRADES, "rung": tuple(NAMES.values()),
}  # fmt: skip
"""Metrics whose values are numbers of names: they are counted, not averaged."""
_ANGLES: Final = {"pdof"}
"""Not averaged either."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownLine:
    """A quantity: its label with the unit, a short one for a heading, and one cell per group."""

    label: str
    short: str
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SideBySide:
    """The quantities of all groups.

    Attributes:
        key: the quantities that matter most.
        more: all other metrics, by name (docs/reference/metrics.md); empty unless asked for.
        missing: why quantities have no value in some runs, one sentence per reason.
    """

    names: tuple[str, ...]
    about: tuple[ShownLine, ...]
    key: tuple[ShownLine, ...]
    more: tuple[ShownLine, ...]
    missing: tuple[str, ...]

    @property
    def short(self) -> tuple[ShownLine, ...]:
        """The key quantities that fit in one row per group."""
        return tuple(line for line in self.key if line.short)


def side_by_side(groups: Sequence[RunGroup], *, everything: bool = False) -> SideBySide:
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


def _about(groups: Sequence[RunGroup]) -> tuple[ShownLine, ...]:
    about = [group.about for group in groups]
    names = dict.fromkeys(name for one in about for name, text in one.items() if text)
    return tuple(
        ShownLine(label=name, short=name, cells=tuple(one[name] or NONE for one in about))
        for name in names
    )


def _key(groups: Sequence[RunGroup]) -> tuple[ShownLine, ...]:
    lines: list[Told] = [
        ("runs that succeeded", "runs", _succeeded),
        ("runs in which a vehicle was attacked", "attacked", lambda one: str(len(one.attacked))),
        ("AV hit by the opponent, runs", "hits", lambda one: str(len(one.hits))),
        ("  rate (95 % interval)", "hit rate (95 %)", _rate),
        ("  of these findings", "findings", _findings),
        ("  contrived or unavoidable, no findings", "", _apart),
        ("  of these drivable and on the road", "", _on_road),
        ("AV hit another vehicle, runs", "", lambda one: str(one.touched("av_other"))),
        ("opponent hit another vehicle, runs", "", lambda one: str(one.touched("opponent_other"))),
        _mean_of("collision_time_s", lambda one: one.hits, "contact_time_s"),
        _mean_of("collision_speed_mps", lambda one: one.hits, "contact_speed_mps", _SPEED),
        _mean_of("delta_v_mps", lambda one: one.hits, "delta_v", "delta-v, m/s"),
        _mean_of("ttc_min_s", lambda one: one.attacked, "ttc_min", _TTC),
        _mean_of("min_gap_m", lambda one: one.attacked, "min_gap", _GAP),
        _mean_of("generation_time_s", lambda one: one.ok, "generation_s"),
    ]
    if any(episodes > 1 for group in groups for episodes in _values(group.ok, "simulations")):
        lines.append(
            ("simulated episodes, mean", "episodes", lambda one: _mean(one.ok, "simulations", 1))
        )
    if any(group.tries for group in groups):
        lines.append(("tries for a finding: misses, hits by rung", "", _tries))
    return tuple(
        ShownLine(label=label, short=short, cells=tuple(cell(group) for group in groups))
        for label, short, cell in lines
    )


_SPEED, _TTC, _GAP = (
    BY_NAME[name].heading for name in ("collision_speed_mps", "ttc_min_s", "min_gap_m")
)
Told = tuple[str, str, Callable[[RunGroup], str]]
"""Label, short label, and the cell of a group."""


def _mean_of(
    name: str, part: Callable[[RunGroup], pd.DataFrame], column: str, short: str = ""
) -> Told:
    """The line of a quantity, as the mean of a column of some runs."""
    quantity = BY_NAME[name]
    label = f"{quantity.words}, mean, {quantity.unit}"
    return label, short, lambda group: _mean(part(group), column, quantity.shown_digits)


def _tries(group: RunGroup) -> str:
    """Of one run each in turn, of several their numbers."""
    if len(group.tries) == 1:
        return findings.tried(group.tries[0])
    number = Counter(one for tries in group.tries for one in tries)
    return ", ".join(f"{one} {number[one]}" for one in ("miss", *RUNGS) if number[one])


def _succeeded(group: RunGroup) -> str:
    others = Counter(one for one in group.table["status"] if one != "ok")
    counts = "".join(f", {count} {status}" for status, count in sorted(others.items()))
    return f"{len(group.ok)} of {len(group.runs)}{counts}"


def _rate(group: RunGroup) -> str:
    if group.attacked.empty:
        return NONE
    found = group.rate
    return f"{100 * found.rate:.0f} % ({100 * found.low:.0f} to {100 * found.high:.0f})"


def _findings(group: RunGroup) -> str:
    """How many of the hits that were judged; with the kinds, where the ladder judged them."""
    found = group.worth
    if not found.hits:
        return NONE
    kinds = ", ".join(
        f"{number} {NAMES[rung]}"
        for rung, number in found.rungs.items()
        if number and rung not in APART
    )
    return f"{found.findings} of {found.judged}" + (f" ({kinds})" if kinds else "")


def _apart(group: RunGroup) -> str:
    """Hits that are no findings, by kind."""
    found = group.worth
    if not found.hits or found.valid + found.others:
        return NONE
    return ", ".join(f"{found.rungs[rung]} {NAMES[rung]}" for rung in APART)


def _on_road(group: RunGroup) -> str:
    return f"{group.on_road_hits} of {len(group.hits)}" if len(group.hits) else NONE


def _mean(runs: pd.DataFrame, column: str, digits: int | None) -> str:
    return _average(_values(runs, column), len(runs), digits)


def _average(values: Sequence[float], runs: int, digits: int | None) -> str:
    """The mean; with the number of runs that have a value, where some have none."""
    if not values:
        return NONE
    mean = fmean(values)
    text = f"{mean:.3g}" if digits is None else f"{mean:.{digits}f}"
    return text if len(values) == runs else f"{text} ({len(values)} of {runs})"


def _values(runs: pd.DataFrame, column: str) -> list[float]:
    """Of the runs that have one; of a metric that only other runs have, none."""
    return [float(one) for one in runs[column].dropna()] if column in runs else []


def _units(groups: Sequence[RunGroup]) -> dict[str, str]:
    """Of all metrics that the key quantities leave out, by name."""
    units = {
        name: metric["unit"]
        for group in groups
        for run in group.runs_of(group.attacked)
        for name, metric in run.metrics.items()
    }
    return {name: units[name] for name in sorted(units.keys() - _SHOWN - _ANGLES)}


def _metrics(groups: Sequence[RunGroup], units: Mapping[str, str]) -> tuple[ShownLine, ...]:
    """One line per metric of which some run has a value."""
    lines = (
        ShownLine(
            label=name if unit in {"", "1", "number"} else f"{name}, {unit}",
            short="",
            cells=tuple(_cell(group, name) for group in groups),
        )
        for name, unit in units.items()
    )
    return tuple(line for line in lines if set(line.cells) != {NONE})


def _cell(group: RunGroup, name: str) -> str:
    if name not in _NAMES:
        return _mean(group.attacked, name, None)
    words = [_NAMES[name][int(value)].replace("_", " ") for value in _values(group.attacked, name)]
    return ", ".join(f"{count} {word}" for word, count in Counter(words).most_common()) or NONE


def _missing(
    groups: Sequence[RunGroup], names: Sequence[str], labels: Mapping[str, str]
) -> tuple[str, ...]:
    """Why there is no value, in how many runs and of which quantities; one sentence per reason.

    Quantities that are missing in the same runs of all groups share a sentence.
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


def _reasons(group: RunGroup, labels: Mapping[str, str]) -> Counter[tuple[str, str]]:
    """Attacked runs without a value, by reason and metric."""
    found: Counter[tuple[str, str]] = Counter()
    for run in group.runs_of(group.attacked):
        for name in labels:
            given = run.metrics.get(name)
            if given and given["value"] is None:
                found[given["reason"] or "no reason given", name] += 1
    return found
