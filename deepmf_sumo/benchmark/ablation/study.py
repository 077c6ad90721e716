"""A plan -> trained networks, figures and attacks of each variant; what is finished is kept.

In the folder: ``weights/NETWORKS``, ``evaluation/NETWORKS-DIGEST.json`` and
``attacks/VARIANT/PLANNER-DIGEST``, a result folder. The digest is that of the tensors and of the
recordings, so that nothing of other networks is taken for these.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from deepmf_sumo import files
from deepmf_sumo.benchmark import batch
from deepmf_sumo.benchmark.ablation.plan import BASE, Plan, Variant
from deepmf_sumo.benchmark.ablation.table import Row, row
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.tasks import slug
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.weights import NETWORKS, Network
from deepmf_sumo.training import evaluation, initial_weights
from deepmf_sumo.training.command import train_each
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples import feature_cache

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
