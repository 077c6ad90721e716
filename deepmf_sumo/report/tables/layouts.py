"""Rows and columns of each table: the paper's three, then what it does not measure.

Which methods know what DeepMF has to predict, so that readers of a table compare like with like.

An adversary that simulates the scene before it attacks says what it learns there in the constant
``FORESIGHT`` of its module.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import plugins
from deepmf_sumo.results.quantities import BY_NAME
from deepmf_sumo.spec import DEFAULT_RULES, VERSIONS
from deepmf_sumo.spec.profiles import published
from deepmf_sumo.study.plans import tables
from deepmf_sumo.study.plans.layout import PlanLayout, read_layout
from deepmf_sumo.tables import read_csv

TextRow = dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """Rows as text, in the plan's order; an empty cell is not known."""

    layout: PlanLayout
    main: Sequence[TextRow]
    differences: Sequence[TextRow]
    equal_seconds: Sequence[TextRow]


def read_content(out: Path) -> Content:
    """Read the tables. Raises UsageError where the folder has none."""
    return Content(
        layout=read_layout(out),
        main=_rows(out / tables.MAIN),
        differences=_rows(out / tables.DIFFERENCES),
        equal_seconds=_rows(out / tables.EQUAL_SECONDS, needed=False),
    )


def _rows(file: Path, *, needed: bool = True) -> list[TextRow]:
    if not file.is_file() and not needed:
        return []
    return [{_today(name): text for name, text in row.items()} for row in read_csv(file)]


_EARLIER: Final = "valid_collision_rate"
"""Valid hits were what findings are in tables of versions without a ladder."""


def _today(name: str) -> str:
    return name.replace(_EARLIER, "finding_rate")


_MEANT: Final = (
    "What a method looks up it learns from simulations of the same scene before its attack: under"
    " a replayed AV that is the AV's future itself. The others see only the past. Naturalness is"
    " measured against the recording: a method that starts from the opponent's motion without an"
    " attack is close to it by construction."
)


def of(layout: PlanLayout) -> list[str]:
    """Sentences: methods with foresight by what they look up; none where there are none."""
    methods: dict[str, list[str]] = {}
    for label in layout.methods:
        name = _adversary(layout.plan["methods"][label].get("adversary", "deepmf"))
        known = getattr(plugins.load("adversaries", name), "FORESIGHT", None)
        if known is not None:
            methods.setdefault(known, []).append(label)
    lines = [f"{', '.join(labels)}: looked up: {known}." for known, labels in methods.items()]
    return [*lines, _MEANT] if lines else []


def _adversary(choice: str | dict[str, Any]) -> str:
    """Name of the plug-in that a plan's method means."""
    name = choice if isinstance(choice, str) else str(choice.get("name", "deepmf"))
    return "deepmf" if name in VERSIONS else name


_PAPERS: Final = "expected"
"""The rule of the paper's Algorithm 1."""


_PUBLISHED: Final = "form paper"
"""What is said of rows of DeepMF as it is published, instead of their rule."""


def rule_title(layout: PlanLayout, methods: Sequence[str]) -> str:
    """What a table's title says of the forms and rules of its rows of DeepMF; empty without any."""
    rules = dict.fromkeys(_by_method(layout, methods).values())
    said = [one if one == _PUBLISHED else f"extended, rule {one}" for one in rules]
    return f" (DeepMF: {'; '.join(said)})" if said else ""


def notes(layout: PlanLayout) -> list[str]:
    """A sentence a rule that is not the paper's: which methods choose by it."""
    labels: dict[str, list[str]] = {}
    for label, rule in _by_method(layout, layout.methods).items():
        labels.setdefault(rule, []).append(label)
    return [
        f"{', '.join(found)}: attacks chosen by {rule}, not by the paper's product (rule"
        f" {_PAPERS})."
        for rule, found in labels.items()
        if rule not in {_PAPERS, _PUBLISHED}
    ]


def _by_method(layout: PlanLayout, methods: Sequence[str]) -> dict[str, str]:
    default, known = DEFAULT_RULES[layout.plan["version"]], layout.plan["methods"]
    found = {}
    for label in methods:
        profile = known[label].get("profile") or layout.plan.get("profile")
        found[label] = _rule(known[label].get("adversary", {}), default, profile == "paper")
    return {label: rule for label, rule in found.items() if rule}


def _rule(choice: str | dict[str, Any], default: str, paper: bool) -> str:
    """The rule of a plan's method, or `_PUBLISHED`; empty where it is not DeepMF."""
    settings = {"name": choice} if isinstance(choice, str) else choice
    if settings.get("name", "deepmf") not in {"deepmf", *VERSIONS}:
        return ""
    if paper or published(settings):
        return _PUBLISHED
    if settings.get("aggressiveness") is not None:
        return f"aggressiveness {settings['aggressiveness']:g}"
    return str(settings.get("rule", default))


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """A column: its heading with the unit, the column of ``table.csv``, and the number's form."""

    text: str
    column: str
    digits: int = 2
    percent: bool = False
    interval: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class TableCell:
    """A formatted value; ``best`` of its planner's."""

    text: str
    best: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodTable:
    """A table in blocks, one a planner.

    Attributes:
        blocks: planner, and its rows: method, hits of attacked, and one cell per column.
    """

    title: str
    heads: Sequence[str]
    blocks: Sequence[tuple[str, Sequence[tuple[str, Sequence[TableCell]]]]]


def _head(name: str, text: str = "", *, interval: bool = False) -> Head:
    """The heading of a quantity; ``text`` in place of its title."""
    known = BY_NAME[name]
    unit = known.unit if known.unit != "1" else ""
    if known.rate:
        unit = "% of hits" if known.of_hits else "%"
    text = f"{text or known.title} ({unit})" if unit else text or known.title
    return Head(text=text, column=name, digits=known.digits, percent=known.rate, interval=interval)


RATE: Final = _head("collision_rate")
_TIME, _SPEED, _GENERATION = map(
    _head, ("collision_time_s", "collision_speed_mps", "generation_time_s")
)
_NATURAL: Final = tuple(map(_head, ("kl", "wasserstein", "sspd_m", "hausdorff_m")))
_INTERVAL: Final = _head("collision_rate", "Rate, 95 %", interval=True)
_FAIRNESS: Final = (
    _INTERVAL,
    _head("finding_rate", interval=True),
    *map(
        _head,
        (
            "feasible_rate", "offroad_rate", "third_party_rate", "avoidable_rate",
            "av_at_fault_rate", "av_other_rate", "planner_saw_opponent",
        ),
    ),
)  # fmt: skip
_VARIETY: Final = (
    Head(text="Pooled JSD (nat)", column="pooled_jsd"),
    Head(text="Pooled W (m/s2)", column="pooled_wasserstein"),
    _head("rms_acceleration_mps2"),
    Head(text="Sectors hit", column="sectors_hit", digits=0),
    Head(text="Diversity (m)", column="diversity_m", digits=1),
    _head("simulations"),
    Head(text="Generate Time, median (s)", column="generation_time_median_s"),
)
_EQUAL: Final = (_INTERVAL, _TIME, _SPEED, *_NATURAL, _GENERATION, _head("simulations"))
_COMPARED: Final = ("collision_rate", "kl", "wasserstein", "sspd_m", "hausdorff_m")


def tables_of(content: Content) -> list[MethodTable]:
    """All tables that the plan's methods allow, in the paper's order."""
    layout = content.layout
    found = []
    if layout.versions:
        heads = (RATE, _TIME, _SPEED, *_NATURAL, _GENERATION)
        title = f"Table I. Versions of DeepMF{rule_title(layout, layout.versions)}"
        found.append(_table(title, heads, content.main, layout.versions))
    if layout.compared:
        efficiency = (RATE, _TIME, _SPEED, _GENERATION)
        rule = rule_title(layout, layout.compared)
        found += [
            _table(f"Table II. Efficiency{rule}", efficiency, content.main, layout.compared),
            _table(f"Table III. Naturalness{rule}", _NATURAL, content.main, layout.compared),
        ]
    beyond = {"fairness": _FAIRNESS, "naturalness, variety, cost": _VARIETY}
    found += [
        _table(f"Beyond the paper: {title}", columns, content.main, layout.methods)
        for title, columns in beyond.items()
    ]
    if layout.equal_seconds:
        scenes = len(layout.equal_seconds.scenes)
        limits = {
            f"{one['seconds']:g}" for each in layout.equal_seconds.budgets.values() for one in each
        }
        searched = ", ".join(layout.equal_seconds.budgets)
        title = (
            f"Equal time: {searched} with {'/'.join(sorted(limits))} s a run, the others as they"
            f" are; {scenes} scenes"
        )
        found.append(_table(title, _EQUAL, content.equal_seconds, layout.compared))
    if len(layout.methods) > 1:
        found.append(_differences(content))
    return found


def _table(
    title: str, heads: Sequence[Head], rows: Sequence[TextRow], methods: Sequence[str]
) -> MethodTable:
    planners = dict.fromkeys(row["planner"] for row in rows)
    blocks = []
    for planner in planners:
        by_method = {row["method"]: row for row in rows if row["planner"] == planner}
        shown = [by_method[method] for method in methods if method in by_method]
        best = {head.column: _best(head.column, shown) for head in heads}
        blocks.append((planner, [(row["method"], _cells(row, heads, best)) for row in shown]))
    texts = ["Methods", "Hits / attacked", *(head.text for head in heads)]
    return MethodTable(title=title, heads=texts, blocks=blocks)


def _cells(row: TextRow, heads: Sequence[Head], best: dict[str, float | None]) -> list[TableCell]:
    cells = [TableCell(text=f"{row['hits']} / {row['attacked']}")]
    for head in heads:
        value = row[head.column]
        is_best = bool(value) and best[head.column] == float(value)
        cells.append(TableCell(text=_number(row, head), best=is_best))
    return cells


def _best(column: str, rows: Sequence[TextRow]) -> float | None:
    values = [float(row[column]) for row in rows if row[column]]
    known = BY_NAME.get(column)
    if known is None or known.better == "neither" or len(values) < 2:
        return None
    if max(values) == min(values):
        return None
    return max(values) if known.better == "higher" else min(values)


def _number(row: TextRow, head: Head) -> str:
    def shown(name: str) -> str:
        return f"{float(row[name]) * (100 if head.percent else 1):.{head.digits}f}"

    if not row[head.column]:
        return "-"
    if not head.interval:
        return shown(head.column)
    low, high = shown(f"{head.column}_lo"), shown(f"{head.column}_hi")
    return f"{shown(head.column)} ({low}-{high})"


def _differences(content: Content) -> MethodTable:
    """Method minus baseline on the same scenes, with 95 % intervals."""
    blocks = []
    for planner in content.layout.planners:
        rows = []
        for method in content.layout.methods:
            found = {
                row["quantity"]: row
                for row in content.differences
                if (row["planner"], row["method"]) == (planner, method)
            }
            if any(found[name]["difference"] for name in _COMPARED if name in found):
                cells = [TableCell(text=_difference(found[name])) for name in _COMPARED]
                rows.append((method, [TableCell(text=found["collision_rate"]["pairs"]), *cells]))
        blocks.append((planner, rows))
    return MethodTable(
        title=f"Paired differences to {content.layout.baseline} on the same scenes, 95 %",
        heads=["Methods", "Pairs", *(BY_NAME[name].title for name in _COMPARED)],
        blocks=blocks,
    )


def _difference(row: TextRow) -> str:
    if not row["difference"]:
        return "-"
    middle = f"{float(row['difference']):+.2f}"
    if not row["difference_lo"]:  # fewer than six scenes
        return middle
    low, high = (f"{float(row[name]):+.2f}" for name in ("difference_lo", "difference_hi"))
    return f"{middle} ({low} to {high})"
