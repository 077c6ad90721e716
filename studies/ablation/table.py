"""The table of an ablation: cards, figures and attacks of each variant -> its row.

Notes above the readable table give data, steps, seeds and denominators: neither rates nor costs can
be judged without them.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final

from deepmf_sumo import files, tables
from deepmf_sumo.deepmf.networks.weights import NETWORKS, Network
from deepmf_sumo.results import statistics
from deepmf_sumo.results.quantities import unit
from deepmf_sumo.results.result import Result
from deepmf_sumo.results.statistics import Interval
from deepmf_sumo.training.evaluation import Evaluation, Figure
from studies.ablation.plan import Plan

READABLE: Final = "ablation.md"
_AT_8_S: Final = 8.0
_FIGURES: Final[dict[str, tuple[str, str, tuple[Any, ...]]]] = {
    **{
        f"min_fde_{modes}_m": (f"minFDE{modes} m", ".2f", ("marginal", "min_fde", _AT_8_S, modes))
        for modes in (6, 16, 32)
    },
    "log_likelihood": ("log lik. nats", ".2f", ("marginal", "log_likelihood", _AT_8_S)),
    **{
        f"gain_{given}": (
            f"gain {given}",
            "+.2f",
            ("conditional", "log_likelihood_gain", _AT_8_S, None, f"given_{given}", "av"),
        )
        for given in ("true", "shuffled")
    },
}
"""Column of the CSV file -> heading, format and key of a figure; gains are of the AVs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """The attacks on one planner.

    Attributes:
        runs: that succeeded. not_ok: failed, timed out or skipped. failed: without the skipped.
        hits: runs in which the opponent hit the AV first. rate: of the runs; None without any.
        rms_mps2: the opponent's RMS acceleration, mean over the runs.
    """

    planner: str
    runs: int
    not_ok: int
    failed: int
    hits: int
    rate: Interval | None
    rms_mps2: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One variant.

    Attributes:
        networks: the variant whose networks it uses.
        cards: by network.
        cycles_ms: of all replanning cycles of all runs.
    """

    variant: str
    networks: str
    cards: Mapping[Network, Mapping[str, Any]]
    evaluation: Evaluation
    attacks: tuple[Attacked, ...]
    cycles_ms: Sequence[float]

    @property
    def weights(self) -> int:
        """Number of weights of all three networks."""
        return sum(card["weights"] for card in self.cards.values())

    @property
    def minutes(self) -> float:
        """Training time of the marginal and the conditional network."""
        return 60.0 * float(self.cards["marginal"]["hours"] + self.cards["conditional"]["hours"])

    @property
    def opponent_minutes(self) -> float:
        """Training time of the opponent network, which all variants share."""
        return 60.0 * float(self.cards["opponent"]["hours"])

    @property
    def cycle_ms(self) -> float | None:
        """Median time of a replanning cycle."""
        return median(self.cycles_ms) if self.cycles_ms else None

    @property
    def objects(self) -> int:
        """Vehicles whose errors were measured at 8 s."""
        return self.evaluation.of("marginal", "min_fde", _AT_8_S, 6).objects or 0

    @property
    def avs(self) -> int:
        """AVs whose gains were measured at 8 s."""
        place = (_AT_8_S, None, "marginal", "av")
        return self.evaluation.of("conditional", "log_likelihood", *place).objects or 0

    @property
    def figures(self) -> dict[str, Figure]:
        """Of the evaluation, by column of the CSV file."""
        return {name: self.evaluation.of(*key) for name, (_, _, key) in _FIGURES.items()}


def row(
    variant: str,
    networks: str,
    cards: Mapping[Network, Mapping[str, Any]],
    evaluation: Evaluation,
    results: Mapping[str, Sequence[Result]],
) -> Row:
    """The row of a variant, from the results of its attacks by planner."""
    return Row(
        variant=variant,
        networks=networks,
        cards=cards,
        evaluation=evaluation,
        attacks=tuple(_attacked(planner, each) for planner, each in results.items()),
        cycles_ms=[
            sum(parts.values())
            for each in results.values()
            for one in each
            for parts in one["timings"].get("plans_ms", ())
        ],
    )


def _attacked(planner: str, results: Sequence[Result]) -> Attacked:
    done = [one for one in results if one["status"] == "ok"]
    hits = sum(one["outcome"] == "av_opponent" for one in done)
    rms = [
        value
        for one in done
        if (value := one["metrics"]["opponent_rms_acceleration"]["value"]) is not None
    ]
    return Attacked(
        planner=planner,
        runs=len(done),
        not_ok=len(results) - len(done),
        failed=sum(one["status"] in {"failed", "timeout"} for one in results),
        hits=hits,
        rate=_rate(done) if done else None,
        rms_mps2=fmean(rms) if rms else None,
    )


def _rate(done: Sequence[Result]) -> Interval:
    hits = ((unit(one), float(one["outcome"] == "av_opponent")) for one in done)
    return statistics.rate(statistics.by_unit(hits))


def headings(planners: Sequence[str]) -> list[str]:
    """Headings of the readable table."""
    return [
        *("variant", "networks", "weights", "minutes"),
        *(heading for heading, _, _ in _FIGURES.values()),
        "cycle ms",
        *(heading for name in planners for heading in (f"{name}: hits", f"{name}: rms m/s2")),
    ]


def cells(row: Row) -> list[str]:
    """A row of the readable table."""
    return [
        row.variant,
        row.networks,
        f"{row.weights:,}",
        f"{row.minutes:.1f}",
        *(_estimate(row.figures[name], form) for name, (_, form, _) in _FIGURES.items()),
        _number(row.cycle_ms, ".0f"),
        *(cell for attacked in row.attacks for cell in _hits(attacked)),
    ]


def write(folder: Path, notes: Sequence[str], rows: Sequence[Row]) -> None:
    """Write both tables, the notes above the readable one. Raises OutputError."""
    planners = [attacked.planner for attacked in rows[0].attacks]
    lines = tables.to_markdown(headings(planners), map(cells, rows))
    text = "\n\n".join(["# Ablation", *notes, "\n".join(lines)]) + "\n"
    with files.writing(folder):
        files.write(folder / READABLE, text)
        table = tables.to_csv(map(_record, rows), cell=tables.exact)
        files.write(folder / "ablation.csv", table)


def _record(row: Row) -> dict[str, Any]:
    record: dict[str, Any] = {
        "variant": row.variant,
        "networks": row.networks,
        "weights": row.weights,
        "training_minutes": round(row.minutes, 2),
        "marginal_steps": row.cards["marginal"]["steps_made"],
        "conditional_steps": row.cards["conditional"]["steps_made"],
        "objects": row.objects,
        "avs": row.avs,
    }
    for name, figure in row.figures.items():
        record |= {name: figure.value, f"{name}_standard_error": figure.standard_error}
    record |= {"cycle_ms": _rounded(row.cycle_ms), "cycles": len(row.cycles_ms)}
    for one in row.attacks:
        rate = one.rate._asdict() if one.rate else dict.fromkeys(("rate", "low", "high"))
        values = {"runs": one.runs, "not_ok": one.not_ok, "hits": one.hits, **rate}
        values["rms_mps2"] = one.rms_mps2
        record |= {f"{one.planner} {name}": _rounded(value) for name, value in values.items()}
    return record


def _hits(attacked: Attacked) -> list[str]:
    runs = f"{attacked.hits}/{attacked.runs}"
    if attacked.not_ok:
        runs += f" ({attacked.not_ok} not ok)"
    if attacked.rate:
        rate = attacked.rate
        runs += f" = {rate.rate:.2f} ({rate.low:.2f} to {rate.high:.2f})"
    return [runs, _number(attacked.rms_mps2, ".2f")]


def _estimate(figure: Figure, form: str) -> str:
    error = figure.standard_error
    return _number(figure.value, form) + ("" if error is None else f" ± {error:.2f}")


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"


def _rounded(value: float | None) -> float | None:
    return round(value, 4) if isinstance(value, float) else value


def notes(plan: Plan, jobs: int, rows: Sequence[Row]) -> list[str]:
    """Paragraphs on data, steps, seeds, threads and denominators, then one on the variants."""
    return [
        _training_note(rows),
        _evaluation_note(plan, rows[0]),
        _attack_note(plan, jobs, rows),
        _variants_note(plan),
    ]


def _training_note(rows: Sequence[Row]) -> str:
    cards = rows[0].cards
    sources = ", ".join(
        f"{source['name']} ({source['scenes']} scenes, {source['refused']} refused)"
        for source in cards["marginal"]["data"]
    )
    steps = ", ".join(
        f"{network} {cards[network]['steps']} x {cards[network]['schedule']['batch']}"
        for network in NETWORKS
    )
    every = [card for row in rows for card in row.cards.values()]
    return (
        f"Trained on {sources}; steps x samples per step: {steps}; seed {_each(every, 'seed')};"
        f" device {_each([card['schedule'] for card in every], 'device')}, threads"
        f" {_each(every, 'threads')}. 'minutes' is the wall time of training the marginal and the"
        " conditional network, without features; the opponent network is the same in all rows and"
        f" took {rows[0].opponent_minutes:.1f}. Each row is one training: differences smaller than"
        " those between seeds mean nothing."
    )


def _evaluation_note(plan: Plan, base: Row) -> str:
    found = base.evaluation
    return (
        f"Measured at 8 s on {plan.test.name}: {found.scenes} scenes ({found.refused} refused),"
        f" {base.objects} objects; gains of {base.avs} AVs, given the other vehicle's true or a"
        " shuffled future, over the marginal network; ± standard error. 'weights' counts all three"
        " networks."
    )


def _attack_note(plan: Plan, jobs: int, rows: Sequence[Row]) -> str:
    cycles = sum(len(row.cycles_ms) for row in rows)
    planners = "; ".join(f"{name}: {_changes(keys)}" for name, keys in plan.planners.items())
    return (
        f"Attacked as specified in {plan.study.name}, with its seed; {planners}. Hits: runs in"
        " which the opponent hit the AV first, of all successful runs, with the 95 %"
        " interval; rms: the opponent's acceleration along its path, mean over runs. 'cycle ms':"
        f" median of all replanning cycles ({cycles} in all) in workers with one thread each,"
        f" {jobs} at a time in the last command; other programs on the machine affect it."
    )


def _variants_note(plan: Plan) -> str:
    base = plan.preset_of(plan.all_variants[0]).name
    lines = [f"- base: preset {base}, attack as in the study"]
    for variant in plan.variants:
        changes = _changes({**variant.sizes, **variant.attack})
        networks = plan.trained_for(variant)
        shared = "" if networks == variant else f" (networks of {networks.name})"
        lines.append(f"- {variant.name}: {changes}{shared}")
    return "\n".join(lines)


def _changes(changes: Mapping[str, Any]) -> str:
    listed = ", ".join(f"{key} {json.dumps(value)}" for key, value in changes.items())
    return listed or "no changes"


def _each(values: Sequence[Any], key: str) -> str:
    return ", ".join(sorted({str(value[key]) for value in values}))
