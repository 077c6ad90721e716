"""A plan -> trained networks, figures and attacks of each variant; what is finished is kept.

In the folder: ``weights/NETWORKS``, ``evaluation/NETWORKS-DIGEST.json`` and
``attacks/VARIANT/PLANNER-DIGEST``, a result folder. The digest is that of the tensors and of the
recordings, so that results of other networks are not used.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.weights import NETWORKS, Network
from deepmf_sumo.results.result import Result
from deepmf_sumo.spec.tasks import slug
from deepmf_sumo.study.sweep import batch
from deepmf_sumo.training import evaluation, initial_weights
from deepmf_sumo.training.command import train_each
from deepmf_sumo.training.evaluation import Evaluation
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples import feature_cache
from studies.ablation.plan import BASE, Plan, Variant
from studies.ablation.table import Row, row

_OWN: Final[tuple[Network, ...]] = ("marginal", "conditional")
"""Networks trained for other sizes; the opponent network is always the base's."""
_REPORTED_RUNS: Final = 20
"""Runs between two progress reports."""

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
    command: str = ""


def run(plan: Plan, options: Options, report: Report) -> Iterator[Row]:
    """One row per variant, the base first, each as soon as it is finished.

    Raises what training, evaluation and `batch.run` raise; what is finished stays.
    """
    for variant in plan.all_variants:
        networks = plan.trained_for(variant)
        work = _Work(plan, options, partial(_prefixed, report, variant.name))
        folder = work.train(networks)
        digest = _digest(plan, folder)
        found = work.evaluate(folder, digest)
        results = {
            planner: work.attack(variant, planner, folder, digest) for planner in plan.planners
        }
        cards = {network: weights.read_card(folder, network) for network in NETWORKS}
        yield row(variant.name, networks.name, cards, found, results)


@dataclass(frozen=True, slots=True)
class _Work:
    """The three steps for a variant."""

    plan: Plan
    options: Options
    report: Report

    def train(self, variant: Variant) -> Path:
        """The folder of the variant's networks; `train` keeps networks that are complete."""
        plan, options = self.plan, self.options
        root = options.out / "weights"
        folder = root / slug(variant.name)
        training = Training(
            data=plan.sources(),
            folder=folder,
            cache=options.cache or weights.home() / ".features",
            preset=plan.preset_of(variant),
            optimisation={network: plan.of(network) for network in NETWORKS},
            seed=plan.seed or 0,
            device=torch_networks.device(),
            jobs=options.jobs,
            licence=plan.licence or "",
            command=options.command,
        )
        networks = NETWORKS if variant.name == BASE else _OWN
        train_each(networks, training, options.threads, self.report)
        if variant.name != BASE:
            with files.writing(folder):
                for name in ("opponent.safetensors", "opponent.json"):
                    files.copy(root / BASE / name, folder / name)
        return folder

    def evaluate(self, folder: Path, digest: str) -> Evaluation:
        """The figures of the networks in a folder."""
        file = self.options.out / "evaluation" / f"{folder.name}-{digest}.json"
        if file.is_file():
            record = json.loads(files.content(file))
            if "figures" in record:  # versions up to 0.1 wrote nested figures
                self.report("evaluated before")
                return Evaluation.from_record(record)
        self.report("evaluating")
        return evaluation.run(
            [self.plan.test],
            name=str(folder.resolve()),
            file=file,
            card=False,
            threads=self.options.threads,
            report=self.report,
        )

    def attack(self, variant: Variant, planner: str, folder: Path, digest: str) -> list[Result]:
        """The results of the attacks on one planner."""

        def progress(now: batch.Progress) -> None:
            if now.done % _REPORTED_RUNS == 0 or now.done == now.of:
                self.report(f"{planner}: {now.done} of {now.of} runs")

        out = self.options.out / "attacks" / slug(variant.name) / f"{slug(planner)}-{digest}"
        wanted = batch.Options(out=out, jobs=self.options.jobs, resume=True)
        return batch.run([self.plan.spec_of(variant, planner, folder)], wanted, progress)


def _digest(plan: Plan, folder: Path) -> str:
    tensors = [initial_weights.digest(folder / f"{network}.safetensors") for network in NETWORKS]
    return feature_cache.digest_of("ablation", " ".join(tensors), plan.test)[:12]


def _prefixed(report: Report, name: str, line: str) -> None:
    report(f"{name}: {line}")
