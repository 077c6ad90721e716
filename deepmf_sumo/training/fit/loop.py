"""The training loop of all networks: AdamW, one cycle, weight averaging, early stopping."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deepmf_sumo.errors import RunError
from deepmf_sumo.training.fit.checkpoints import Checkpoints, LearningCurves
from deepmf_sumo.training.samples.dataset import Arrays, Dataset, Progress, batches

Loss = Callable[[dict[str, Tensor], torch.Generator], Tensor]
"""Batch -> mean loss; random numbers come from the generator."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """How to train.

    Attributes:
        rate: highest learning rate of the cycle.
        fresh: name prefixes of layers with random initial weights, if the others have trained ones.
        fresh_rate: highest learning rate of those layers.
        clip: largest norm of the gradient.
        average: decay of the exponential average of the weights, which is evaluated and kept; 0
            keeps the weights themselves.
        precision: of the layers; ``bf16`` is mixed precision.
        evaluate_every: steps between evaluations on the held-out samples.
        patience: evaluations without a better held-out loss before training stops; 0: never.
        checkpoint_s: longest time between checkpoints, which are also made at each evaluation.
    """

    steps: int
    batch: int = 64
    rate: float = 2e-3
    fresh: tuple[str, ...] = ()
    fresh_rate: float = 4e-3
    weight_decay: float = 0.02
    clip: float = 5.0
    average: float = 0.0
    precision: Literal["fp32", "bf16"] = "fp32"
    evaluate_every: int = 250
    patience: int = 0
    checkpoint_s: float = 180.0
    held_out_samples: int = 1024
    seed: int = 0
    device: str = "cpu"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingOutcome:
    """The result of a training.

    Attributes:
        held_out: least held-out loss, a mean over sources by their shares, at ``best_step``, whose
            weights the network has. None if nothing is held out.
        by_source: the same for each source.
        steps: number of all steps. hours: wall time, including resumed parts.
    """

    held_out: float | None
    by_source: list[float | None]
    best_step: int
    steps: int
    hours: float


def tensors(arrays: Arrays, device: str = "cpu") -> dict[str, Tensor]:
    """The arrays as tensors on a device."""
    return {name: torch.from_numpy(values).to(device) for name, values in arrays.items()}


def in_batches(
    dataset: Dataset, rows: NDArray[np.int64], size: int, device: str = "cpu"
) -> Iterator[dict[str, Tensor]]:
    """The given samples as tensors, in their order."""
    for begin in range(0, len(rows), size):
        yield tensors(dataset.batch(rows[begin : begin + size]), device)


Weights = dict[str, Tensor]


def train(
    net: nn.Module,
    dataset: Dataset,
    loss: Loss,
    schedule: Schedule,
    checkpoints: Checkpoints,
    curves: LearningCurves,
    report: Progress,
) -> TrainingOutcome:
    """Minimise the loss, starting from the last checkpoint if there is one.

    Checkpoints stay; the caller removes them after writing the weights.

    Raises:
        RunError: the loss or its gradient is not finite.
    """
    run = _Run(net.to(schedule.device), schedule)
    saved = checkpoints.load(schedule.device, report)
    if saved is not None:
        run.restore(saved)
        report(f"resuming from step {run.state.step} ({checkpoints.file})")
    curves.begin(run.state.step)
    started = last_saved = time.monotonic()
    earlier = run.state.seconds
    first = schedule.steps if run.state.stopped else run.state.step
    for step, rows in batches(dataset, schedule.batch, schedule.seed, first, schedule.steps):
        run.step(step, rows, dataset, loss)
        run.state.seconds = earlier + time.monotonic() - started
        look = run.state.step % schedule.evaluate_every == 0 or run.state.step == schedule.steps
        if look:
            curves.write(run.look(dataset, loss, report))
        if look or time.monotonic() - last_saved > schedule.checkpoint_s:
            checkpoints.save(run.saved(), report)
            last_saved = time.monotonic()
        if run.state.stopped:
            report(f"stopped at step {run.state.step}: no gain since {run.state.best_step}")
            break
    curves.end()
    net.load_state_dict(run.best)
    net.eval()
    return run.outcome()


@dataclass(slots=True)
class _Progress:
    """Progress of a training, without the tensors."""

    step: int = 0
    best: float = float("inf")
    best_step: int = 0
    best_by_source: list[float | None] = field(default_factory=list)
    worse: int = 0
    stopped: bool = False
    loss: float = 0.0
    seconds: float = 0.0
    rows: list[list[float]] = field(default_factory=list)

    def better(self, held_out: float | None, by_source: list[float | None]) -> bool:
        """Whether to keep these weights; if nothing is held out, the last ones are kept."""
        if held_out is not None and held_out > self.best:
            self.worse += 1
            return False
        self.best = self.best if held_out is None else held_out
        self.best_step, self.best_by_source, self.worse = self.step, by_source, 0
        return True


class _Run:
    """A network under training."""

    def __init__(self, net: nn.Module, schedule: Schedule) -> None:
        self.net, self.schedule, self.state = net, schedule, _Progress()
        self.optimiser = torch.optim.AdamW(_groups(net, schedule), betas=(0.9, 0.99))
        self.cycle = torch.optim.lr_scheduler.OneCycleLR(
            self.optimiser,
            [group["lr"] for group in self.optimiser.param_groups],
            total_steps=schedule.steps + 1,
            pct_start=0.15,
        )
        self.average = _copy(net) if schedule.average else {}
        self.best = _copy(net)

    def step(self, step: int, rows: NDArray[np.int64], dataset: Dataset, loss: Loss) -> None:
        """One batch. Its random numbers depend only on the seed and the step."""
        schedule = self.schedule
        torch.manual_seed(schedule.seed * 1_000_003 + step)
        generator = torch.Generator().manual_seed(schedule.seed * 7_919 + step)
        self.net.train()
        with _precision(schedule):
            value = loss(tensors(dataset.batch(rows), schedule.device), generator)
        self.optimiser.zero_grad(set_to_none=True)
        value.backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.net.parameters(), schedule.clip)
        now = value.item()
        if not np.isfinite(now) or not torch.isfinite(norm):
            raise RunError(_not_finite(step, now, rows, dataset))
        self.optimiser.step()
        self.cycle.step()
        if self.average:
            _follow(self.average, self.net, min(schedule.average, (1 + step) / (10 + step)))
        self.state.loss += (0.02 if step else 1.0) * (now - self.state.loss)
        self.state.step = step + 1

    def look(self, dataset: Dataset, loss: Loss, report: Progress) -> list[list[float]]:
        """Evaluate and keep the weights if they are the best so far; returns the curves' rows."""
        state = self.state
        with self._averaged():
            by_source = validation_losses(self.net, dataset, loss, self.schedule)
            whole = weighted_mean(by_source, dataset)
            if state.better(whole, by_source):
                self.best = _copy(self.net)
        state.stopped = 0 < self.schedule.patience <= state.worse
        pace = state.seconds / state.step * 1000
        values = [float("nan") if value is None else value for value in (whole, *by_source)]
        rate = self.optimiser.param_groups[0]["lr"]
        state.rows.append([state.step, state.loss, *values, rate, pace])
        left = _left(pace, self.schedule.steps - state.step)
        report(
            f"step {state.step} of {self.schedule.steps}: loss {state.loss:.3f}, "
            f"held out {_described(whole, by_source, dataset)}, {pace:.0f} ms a step{left}"
        )
        return state.rows

    def saved(self) -> dict[str, Any]:
        """The state for `restore`."""
        return {
            "net": self.net.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "cycle": self.cycle.state_dict(),
            "average": self.average,
            "best": self.best,
            "state": {name: getattr(self.state, name) for name in _Progress.__slots__},
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Continue from a state of `saved`."""
        self.net.load_state_dict(saved["net"])
        self.optimiser.load_state_dict(saved["optimiser"])
        self.cycle.load_state_dict(saved["cycle"])
        self.average, self.best = saved["average"], saved["best"]
        self.state = _Progress(**saved["state"])

    def outcome(self) -> TrainingOutcome:
        """The result of a training."""
        state = self.state
        return TrainingOutcome(
            held_out=None if np.isinf(state.best) else state.best,
            by_source=state.best_by_source,
            best_step=state.best_step,
            steps=state.step,
            hours=state.seconds / 3600,
        )

    @contextmanager
    def _averaged(self) -> Iterator[None]:
        """The averaged weights instead of the network's own."""
        if not self.average:
            yield
            return
        own = _copy(self.net)
        self.net.load_state_dict(self.average)
        try:
            yield
        finally:
            self.net.load_state_dict(own)


def _left(pace_ms: float, steps: int) -> str:
    """Time that steps take at most: a training may stop before."""
    rest = pace_ms * steps / 1000
    if not steps:
        return ""
    return f", at most {rest:.0f} s left" if rest < 100 else f", at most {rest / 60:.0f} min left"


def _precision(schedule: Schedule) -> torch.autocast:
    return torch.autocast(
        torch.device(schedule.device).type,
        dtype=torch.bfloat16,
        enabled=schedule.precision == "bf16",
    )


def _copy(net: nn.Module) -> Weights:
    return {name: value.clone() for name, value in net.state_dict().items()}


@torch.no_grad()
def _follow(average: Weights, net: nn.Module, decay: float) -> None:
    """Move the average towards the network's weights; counters are copied."""
    for name, value in net.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, 1 - decay)
        else:
            average[name].copy_(value)


def _groups(net: nn.Module, schedule: Schedule) -> list[dict[str, Any]]:
    """Parameter groups: fresh layers and others, without decay of biases, norms and vectors."""
    groups = []
    for fresh in (False, True):
        own = [
            value
            for name, value in net.named_parameters()
            if bool(schedule.fresh and name.startswith(schedule.fresh)) == fresh
        ]
        rate = schedule.fresh_rate if fresh else schedule.rate
        for many, decay in ((True, schedule.weight_decay), (False, 0.0)):
            part = [value for value in own if (value.ndim > 1) == many]
            if part:
                groups.append({"params": part, "weight_decay": decay, "lr": rate})
    return groups


def _not_finite(step: int, value: float, rows: NDArray[np.int64], dataset: Dataset) -> str:
    """Message on a loss or gradient that is not finite, with the samples."""
    arrays = dataset.batch(rows)
    wrong = sorted(
        {
            int(row)
            for values in arrays.values()
            if values.dtype.kind == "f"
            for row in rows[~np.isfinite(values).reshape(len(rows), -1).all(1)]
        }
    )
    what = f"the loss is {value}" if not np.isfinite(value) else "the gradient is not finite"
    of = np.array(wrong or sorted(map(int, rows)))
    why = "samples with values that are not finite" if wrong else "samples of this batch"
    names = dataset.names(of)
    return (
        f"Training stopped at step {step + 1}: {what}; {why}: {', '.join(map(str, of))}, of scenes "
        f"{', '.join(names[:8])}{' and others' if len(names) > 8 else ''}; the last checkpoint"
        " stays; try a lower rate, or leave these scenes out."
    )


@torch.inference_mode()
def validation_losses(
    net: nn.Module, dataset: Dataset, loss: Loss, schedule: Schedule
) -> list[float | None]:
    """Mean loss over the same held-out samples of each source; None for sources without any.

    Raises RunError if a loss is not finite.
    """
    net.eval()
    found: list[float | None] = []
    for number in range(len(dataset.sources)):
        rows = dataset.rows(held_out=True, source=number)
        most = schedule.held_out_samples // len(dataset.sources)
        if len(rows) > most:
            rows = np.sort(np.random.default_rng(0).choice(rows, most, replace=False))
        total = 0.0
        for turn, batch in enumerate(in_batches(dataset, rows, schedule.batch, schedule.device)):
            size = len(next(iter(batch.values())))
            total += float(loss(batch, torch.Generator().manual_seed(turn))) * size
        if not np.isfinite(total):
            raise RunError(
                f"The loss on the held-out scenes of {dataset.sources[number].name} is {total}; the"
                " last checkpoint stays; try a lower rate, or check these scenes."
            )
        found.append(total / len(rows) if len(rows) else None)
    return found


def weighted_mean(by_source: list[float | None], dataset: Dataset) -> float | None:
    """Mean of the sources' losses by their shares in training; None if nothing is held out."""
    known = [
        (value, share)
        for value, share in zip(by_source, dataset.shares, strict=True)
        if value is not None and share > 0
    ]
    if not known:
        return None
    return float(sum(value * share for value, share in known) / sum(share for _, share in known))


def _described(held_out: float | None, by_source: list[float | None], dataset: Dataset) -> str:
    """The losses as text."""
    if held_out is None:
        return "nothing"
    if len(by_source) == 1:
        return f"{held_out:.3f}"
    each = [
        f"{source.name} -" if value is None else f"{source.name} {value:.3f}"
        for source, value in zip(dataset.sources, by_source, strict=True)
    ]
    return f"{held_out:.3f} ({', '.join(each)})"
