"""A plan -> trained networks, figures and attacks of each variant; what is finished is kept.

In the folder: ``weights/NETWORKS``, ``evaluation/NETWORKS-DIGEST.json`` and
``attacks/VARIANT/PLANNER-DIGEST``, a result folder. The digest is that of the tensors and of the
recordings, so that nothing of other networks is taken for these.

Cards, evaluation and runs of each variant -> its row; rows -> ``ablation.csv``, ``ablation.md``.

Notes above the readable table give data, steps, seeds and denominators: without them neither rates
nor costs can be judged.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final, Literal, Self

from deepmf_sumo import files, tables
from deepmf_sumo.ablation.plan import BASE, Plan, Variant
from deepmf_sumo.metrics.statistics import Interval, wilson
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.weights import NETWORKS, Network
from deepmf_sumo.results.result import Result
from deepmf_sumo.sweep import batch
from deepmf_sumo.tasks import slug
from deepmf_sumo.training import evaluation, initial_weights
from deepmf_sumo.training.command import train_each
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples import feature_cache

HORIZON: Final = "8.0"
MODES: Final = ("6", "16", "32")
_MINUTES: Final = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A mean and its standard error; None where it was not measured."""

    mean: float | None
    standard_error: float | None

    @classmethod
    def of(cls, figures: Mapping[str, Any], name: str) -> Self:
        """The figure of a name, and the one that is its standard error."""
        return cls(mean=figures[name], standard_error=figures[f"{name}_standard_error"])


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
        scenes, refused: recordings that were evaluated, and that could not be.
        min_fde_m: by number of modes, at 8 s, of ``objects`` vehicles.
        log_likelihood: nats, at 8 s.
        gain_true, gain_shuffled: of the AV's log likelihood, given the other's future, nats, at
            8 s, of ``avs`` AVs.
        cycle_ms: median over the replanning ``cycles`` of all runs.
    """

    variant: str
    networks: str
    cards: Mapping[Network, Mapping[str, Any]]
    scenes: int
    refused: int
    min_fde_m: Mapping[str, Estimate]
    objects: int
    log_likelihood: Estimate
    gain_true: Estimate
    gain_shuffled: Estimate
    avs: int
    cycle_ms: float | None
    cycles: int
    attacks: tuple[Attacked, ...]

    @property
    def weights(self) -> int:
        """Of all three networks."""
        return sum(card["weights"] for card in self.cards.values())

    @property
    def minutes(self) -> float:
        """Of training the marginal and the conditional network."""
        return _MINUTES * float(
            self.cards["marginal"]["hours"] + self.cards["conditional"]["hours"]
        )

    @property
    def opponent_minutes(self) -> float:
        """Of training the opponent network, which all variants share."""
        return _MINUTES * float(self.cards["opponent"]["hours"])


def row(
    variant: str,
    networks: str,
    cards: Mapping[Network, Mapping[str, Any]],
    evaluation: Mapping[str, Any],
    results: Mapping[str, Sequence[Result]],
) -> Row:
    """The row of a variant.

    Args:
        variant: its name.
        networks: name of the variant whose networks it uses.
        cards: by network.
        evaluation: as `training.evaluation.evaluate` gives it.
        results: of the attacks, by planner.
    """
    marginal = evaluation["marginal"][HORIZON]
    gains = evaluation["conditional"][HORIZON]["by_role"]["av"]
    cycles = [
        sum(parts.values())
        for each in results.values()
        for one in each
        for parts in one["timings"].get("plans_ms", ())
    ]
    return Row(
        variant=variant,
        networks=networks,
        cards=cards,
        scenes=evaluation["scenes"],
        refused=evaluation["refused"],
        min_fde_m={
            modes: Estimate(
                mean=marginal["min_fde"][modes],
                standard_error=marginal["min_fde_standard_error"][modes],
            )
            for modes in MODES
        },
        objects=marginal["objects"],
        log_likelihood=Estimate.of(marginal, "log_likelihood"),
        gain_true=Estimate.of(gains, "log_likelihood_gain_true"),
        gain_shuffled=Estimate.of(gains, "log_likelihood_gain_shuffled"),
        avs=gains["log_likelihood_objects"],
        cycle_ms=median(cycles) if cycles else None,
        cycles=len(cycles),
        attacks=tuple(_attacked(planner, each) for planner, each in results.items()),
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
        rate=wilson(hits, len(done)) if done else None,
        rms_mps2=fmean(rms) if rms else None,
    )


HEADINGS: Final = (
    "variant", "networks", "weights", "minutes", "minFDE6 m", "minFDE16 m", "minFDE32 m",
    "log lik. nats", "gain true", "gain shuffled", "cycle ms",
)  # fmt: skip
"""Then two for each planner: hits, and the opponent's RMS acceleration."""


def headings(planners: Sequence[str]) -> list[str]:
    """Of the readable table."""
    each = [heading for name in planners for heading in (f"{name}: hits", f"{name}: rms m/s2")]
    return [*HEADINGS, *each]


def cells(row: Row) -> list[str]:
    """A row of the readable table."""
    return [
        row.variant,
        row.networks,
        f"{row.weights:,}",
        f"{row.minutes:.1f}",
        *(_estimate(row.min_fde_m[modes], "{:.2f}") for modes in MODES),
        _estimate(row.log_likelihood, "{:.2f}"),
        _estimate(row.gain_true, "{:+.2f}"),
        _estimate(row.gain_shuffled, "{:+.2f}"),
        _number(row.cycle_ms, "{:.0f}"),
        *(cell for attacked in row.attacks for cell in _hits(attacked)),
    ]


def write(folder: Path, notes: Sequence[str], rows: Sequence[Row]) -> None:
    """Write both tables, the notes above the readable one. Raises OutputError."""
    planners = [attacked.planner for attacked in rows[0].attacks]
    lines = tables.to_markdown(headings(planners), map(cells, rows))
    text = "\n\n".join(["# Ablation", *notes, "\n".join(lines)]) + "\n"
    with files.writing(folder):
        files.write(folder / "ablation.md", text)
        table = tables.to_csv(map(_record, rows), cell=tables.exact)
        files.write(folder / "ablation.csv", table)


def _record(row: Row) -> dict[str, Any]:
    estimates = {
        **{f"min_fde_{modes}_m": row.min_fde_m[modes] for modes in MODES},
        "log_likelihood": row.log_likelihood,
        "gain_true": row.gain_true,
        "gain_shuffled": row.gain_shuffled,
    }
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
    for name, estimate in estimates.items():
        record |= {name: estimate.mean, f"{name}_standard_error": estimate.standard_error}
    record |= {"cycle_ms": _rounded(row.cycle_ms), "cycles": row.cycles}
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
    return [runs, _number(attacked.rms_mps2, "{:.2f}")]


def _estimate(estimate: Estimate, form: str) -> str:
    error = estimate.standard_error
    return _number(estimate.mean, form) + ("" if error is None else f" ± {error:.2f}")


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


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
        f"{network} {cards[network]['steps']} of {cards[network]['schedule']['batch']}"
        for network in NETWORKS
    )
    every = [card for row in rows for card in row.cards.values()]
    return (
        f"Trained on {sources}; steps and samples a step: {steps}; seed {_each(every, 'seed')};"
        f" device {_each([card['schedule'] for card in every], 'device')}, threads"
        f" {_each(every, 'threads')}. 'minutes' is the wall time of training the marginal and the"
        " conditional network, without features; the opponent network is the same in all rows and"
        f" took {rows[0].opponent_minutes:.1f}. One training a row: differences below the noise"
        " of seeds say nothing."
    )


def _evaluation_note(plan: Plan, base: Row) -> str:
    return (
        f"Measured at 8 s on {plan.test.name}: {base.scenes} scenes ({base.refused} refused),"
        f" {base.objects} objects; gains of {base.avs} AVs, given the other's true or a shuffled"
        " future, over the marginal network; ± standard error. 'weights' counts all three networks."
    )


def _attack_note(plan: Plan, jobs: int, rows: Sequence[Row]) -> str:
    cycles = sum(row.cycles for row in rows)
    planners = "; ".join(f"{name}: {_told(keys)}" for name, keys in plan.planners.items())
    return (
        f"Attacked as {plan.study.name} says, the seed of its runs too; {planners}. Hits: runs in"
        " which the opponent hit the AV first, of all that succeeded, and 95 % Wilson interval;"
        " rms: the opponent's acceleration along its path, mean over runs. 'cycle ms': median of"
        f" all replanning cycles ({cycles} in all), in workers of one thread each, {jobs} at a"
        " time in the last command; what else the machine did is in it."
    )


def _variants_note(plan: Plan) -> str:
    lines = [f"- base: preset {plan.preset_of(plan.all_variants[0]).name}, as the study attacks"]
    for variant in plan.variants:
        told = _told({**variant.sizes, **variant.attack})
        own = "" if plan.trained_for(variant) == variant else f" ({plan.trained_for(variant).name})"
        lines.append(f"- {variant.name}: {told}{own}")
    return "\n".join(lines)


def _told(changes: Mapping[str, Any]) -> str:
    told = ", ".join(f"{key} {json.dumps(value)}" for key, value in changes.items())
    return told or "nothing changed"


def _each(values: Sequence[Any], key: str) -> str:
    return ", ".join(sorted({str(value[key]) for value in values}))


_OWN: Final[tuple[Network, ...]] = ("marginal", "conditional")
"""Networks that other sizes change; the opponent network is the base's."""
_TOLD_RUNS: Final = 20
"""Runs between two lines on the progress."""

Report = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a study is run.

    Attributes:
        cache: of features; None is that of `train`.
        jobs: processes that compute features, and that attack (one thread each).
        threads: of training and evaluation; None leaves it to torch.
    """

    out: Path
    cache: Path | None = None
    jobs: int = 1
    threads: int | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    command: str = ""


def run(plan: Plan, options: Options, report: Report) -> Iterator[Row]:
    """A row a variant, the base first, each as soon as it is finished.

    Raises what training, evaluation and `batch.run` raise; what is finished stays.
    """
    for variant in plan.all_variants:
        networks = plan.trained_for(variant)
        say = _prefixed(report, variant.name)
        folder = _train(plan, networks, options, say)
        digest = _digest(plan, folder)
        found = _evaluate(plan, folder, digest, options, say)
        results = {
            planner: _attack(plan, variant, planner, folder, digest, options, say)
            for planner in plan.planners
        }
        cards = {network: weights.read_card(folder, network) for network in NETWORKS}
        yield row(variant.name, networks.name, cards, found, results)


def _train(plan: Plan, variant: Variant, options: Options, say: Report) -> Path:
    """The folder of the variant's networks; `train` keeps networks that are complete."""
    root = options.out / "weights"
    folder = root / slug(variant.name)
    own = NETWORKS if variant.name == BASE else _OWN
    training = Training(
        data=plan.sources(),
        folder=folder,
        cache=options.cache or weights.home() / ".features",
        preset=plan.preset_of(variant),
        optimisation={network: plan.of(network) for network in NETWORKS},
        seed=plan.seed or 0,
        device=options.device,
        jobs=options.jobs,
        licence=plan.licence or "",
        command=options.command,
    )
    train_each(own, training, options.threads, say)
    if variant.name != BASE:
        with files.writing(folder):
            for name in ("opponent.safetensors", "opponent.json"):
                files.write(folder / name, (root / BASE / name).read_bytes())
    return folder


def _digest(plan: Plan, folder: Path) -> str:
    tensors = [initial_weights.digest(folder / f"{network}.safetensors") for network in NETWORKS]
    return feature_cache.digest_of("ablation", " ".join(tensors), plan.test)[:12]


def _evaluate(
    plan: Plan, folder: Path, digest: str, options: Options, say: Report
) -> dict[str, Any]:
    file = options.out / "evaluation" / f"{folder.name}-{digest}.json"
    if file.is_file():
        say("evaluated before")
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return found
    say("evaluating")
    return evaluation.run(
        [plan.test],
        name=str(folder.resolve()),
        file=file,
        card=False,
        threads=options.threads,
        report=say,
    )


def _attack(
    plan: Plan,
    variant: Variant,
    planner: str,
    folder: Path,
    digest: str,
    options: Options,
    say: Report,
) -> list[Result]:
    def progress(now: batch.Progress) -> None:
        if now.done % _TOLD_RUNS == 0 or now.done == now.of:
            say(f"{planner}: {now.done} of {now.of} runs")

    out = options.out / "attacks" / slug(variant.name) / f"{slug(planner)}-{digest}"
    wanted = batch.Options(out=out, jobs=options.jobs, resume=True)
    return batch.run([plan.spec_of(variant, planner, folder)], wanted, progress)


def _prefixed(report: Report, name: str) -> Report:
    return lambda line: report(f"{name}: {line}")
