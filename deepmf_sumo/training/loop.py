"""The optimisation that all networks share: AdamW, one cycle, averaging, early stopping."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deepmf_sumo.errors import RunError
from deepmf_sumo.training import held_out, sampling
from deepmf_sumo.training.cache import Cache, Progress
from deepmf_sumo.training.checkpoints import Checkpoints
from deepmf_sumo.training.curves import Curves
from deepmf_sumo.training.schedule import Loss, Outcome, Schedule, tensors

__all__ = ["Loss", "Outcome", "Schedule", "tensors", "train"]

Weights = dict[str, Tensor]


def train(
    net: nn.Module,
    cache: Cache,
    loss: Loss,
    schedule: Schedule,
    checkpoints: Checkpoints,
    curves: Curves,
    report: Progress,
) -> Outcome:
    """Minimise the loss; goes on from the last checkpoint if there is one.

    Checkpoints stay: the caller clears them when the weights are safe.

    Raises:
        RunError: the loss or its gradient is not finite.
    """
    run = _Run(net.to(schedule.device), schedule)
    saved = checkpoints.load(schedule.device, report)
    if saved is not None:
        run.restore(saved)
        report(f"going on from step {run.state.step} ({checkpoints.file})")
    curves.begin(run.state.step)
    started = last_saved = time.monotonic()
    earlier = run.state.seconds
    first = schedule.steps if run.state.stopped else run.state.step
    for step, rows in sampling.batches(cache, schedule.batch, schedule.seed, first, schedule.steps):
        run.step(step, rows, cache, loss)
        run.state.seconds = earlier + time.monotonic() - started
        look = run.state.step % schedule.evaluate_every == 0 or run.state.step == schedule.steps
        if look:
            curves.write(run.look(cache, loss, report))
        if look or time.monotonic() - last_saved > schedule.checkpoint_s:
            checkpoints.save(run.saved(), report)
            last_saved = time.monotonic()
        if run.state.stopped:
            report(f"stopped at step {run.state.step}: no better since {run.state.best_step}")
            break
    curves.end()
    net.load_state_dict(run.best)
    net.eval()
    return run.outcome()


@dataclass(slots=True)
class _State:
    """Where a training stands, but for the tensors."""

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
        """Whether to keep these weights; with nothing held out the last ones are kept."""
        if held_out is not None and held_out > self.best:
            self.worse += 1
            return False
        self.best = self.best if held_out is None else held_out
        self.best_step, self.best_by_source, self.worse = self.step, by_source, 0
        return True


class _Run:
    """A network under training."""

    def __init__(self, net: nn.Module, schedule: Schedule) -> None:
        self.net, self.schedule, self.state = net, schedule, _State()
        self.optimiser = torch.optim.AdamW(_groups(net, schedule), betas=(0.9, 0.99))
        self.cycle = torch.optim.lr_scheduler.OneCycleLR(
            self.optimiser,
            [group["lr"] for group in self.optimiser.param_groups],
            total_steps=schedule.steps + 1,
            pct_start=0.15,
        )
        self.average = _copy(net) if schedule.average else {}
        self.best = _copy(net)

    def step(self, step: int, rows: NDArray[np.int64], cache: Cache, loss: Loss) -> None:
        """One batch. What is random in it depends on seed and step alone."""
        schedule = self.schedule
        torch.manual_seed(schedule.seed * 1_000_003 + step)
        generator = torch.Generator().manual_seed(schedule.seed * 7_919 + step)
        self.net.train()
        with _precision(schedule):
            value = loss(tensors(cache.batch(rows), schedule.device), generator)
        self.optimiser.zero_grad(set_to_none=True)
        value.backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.net.parameters(), schedule.clip)
        now = value.item()
        if not np.isfinite(now) or not torch.isfinite(norm):
            raise RunError(_not_finite(step, now, rows, cache))
        self.optimiser.step()
        self.cycle.step()
        if self.average:
            _follow(self.average, self.net, min(schedule.average, (1 + step) / (10 + step)))
        self.state.loss += (0.02 if step else 1.0) * (now - self.state.loss)
        self.state.step = step + 1

    def look(self, cache: Cache, loss: Loss, report: Progress) -> list[list[float]]:
        """Evaluate, keep the weights if they are the best so far; the rows of the curves."""
        state = self.state
        with self._averaged():
            by_source = held_out.evaluate(self.net, cache, loss, self.schedule)
            whole = held_out.mean(by_source, cache)
            if state.better(whole, by_source):
                self.best = _copy(self.net)
        state.stopped = 0 < self.schedule.patience <= state.worse
        pace = state.seconds / state.step * 1000
        values = [float("nan") if value is None else value for value in (whole, *by_source)]
        rate = self.optimiser.param_groups[0]["lr"]
        state.rows.append([state.step, state.loss, *values, rate, pace])
        report(
            f"step {state.step} of {self.schedule.steps}: loss {state.loss:.3f}, "
            f"held out {held_out.text(whole, by_source, cache)}, {pace:.0f} ms a step"
        )
        return state.rows

    def saved(self) -> dict[str, Any]:
        """All that `restore` needs."""
        return {
            "net": self.net.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "cycle": self.cycle.state_dict(),
            "average": self.average,
            "best": self.best,
            "state": {name: getattr(self.state, name) for name in _State.__slots__},
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to where `saved` was taken."""
        self.net.load_state_dict(saved["net"])
        self.optimiser.load_state_dict(saved["optimiser"])
        self.cycle.load_state_dict(saved["cycle"])
        self.average, self.best = saved["average"], saved["best"]
        self.state = _State(**saved["state"])

    def outcome(self) -> Outcome:
        """What came of it."""
        state = self.state
        return Outcome(
            held_out=None if np.isinf(state.best) else state.best,
            by_source=state.best_by_source,
            best_step=state.best_step,
            steps=state.step,
            hours=state.seconds / 3600,
        )

    @contextmanager
    def _averaged(self) -> Iterator[None]:
        """The averaged weights in place of the network's own."""
        if not self.average:
            yield
            return
        own = _copy(self.net)
        self.net.load_state_dict(self.average)
        try:
            yield
        finally:
            self.net.load_state_dict(own)


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
    """Move the average towards the network; counters are taken over."""
    for name, value in net.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, 1 - decay)
        else:
            average[name].copy_(value)


def _groups(net: nn.Module, schedule: Schedule) -> list[dict[str, Any]]:
    """Fresh layers and others; no decay of biases, norms and single vectors."""
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


def _not_finite(step: int, value: float, rows: NDArray[np.int64], cache: Cache) -> str:
    """The message on a loss or gradient that is not finite: whose numbers to look at."""
    arrays = cache.batch(rows)
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
    why = "samples that hold numbers that are not finite" if wrong else "samples of this batch"
    names = cache.names(of)
    return (
        f"Training stopped at step {step + 1}: {what}; {why}: {', '.join(map(str, of))}, of scenes "
        f"{', '.join(names[:8])}{' and others' if len(names) > 8 else ''}; the last checkpoint"
        " stays; try a lower --rate, or leave these scenes out."
    )
