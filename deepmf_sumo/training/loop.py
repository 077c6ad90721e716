"""The optimisation that all networks share: AdamW, one cycle, clipping, checkpoints that resume."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deepmf_sumo.training.cache import Arrays, Cache, Progress

Loss = Callable[[dict[str, Tensor], torch.Generator], Tensor]
"""Batch -> mean loss; the generator is for what is drawn at random in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """How to train.

    Attributes:
        rate: highest learning rate of the cycle.
        fresh: beginnings of the names of layers that begin anew in a network that does not.
        fresh_rate: their highest learning rate.
        evaluate_every: steps between looks at the held-out samples, and checkpoints.
    """

    steps: int
    batch: int = 64
    rate: float = 2e-3
    fresh: tuple[str, ...] = ()
    fresh_rate: float = 4e-3
    weight_decay: float = 0.02
    clip: float = 5.0
    evaluate_every: int = 250
    held_out_samples: int = 1024
    seed: int = 0
    device: str = "cpu"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of it.

    Attributes:
        held_out: least held-out loss, at ``best_step``; the network holds that step's weights.
        hours: wall time, resumed parts included.
    """

    held_out: float
    best_step: int
    hours: float


def train(
    net: nn.Module,
    cache: Cache,
    loss: Loss,
    schedule: Schedule,
    checkpoint: Path,
    report: Progress,
) -> Outcome:
    """Minimise the loss; goes on from the checkpoint if there is one, and removes it at the end."""
    net.to(schedule.device)
    optimiser = torch.optim.AdamW(_groups(net, schedule), betas=(0.9, 0.99))
    cycle = torch.optim.lr_scheduler.OneCycleLR(
        optimiser,
        [group["lr"] for group in optimiser.param_groups],
        total_steps=schedule.steps + 1,
        pct_start=0.15,
    )
    state: dict[str, Any] = {"step": 0, "best": float("inf"), "best_step": 0, "seconds": 0.0}
    best = {name: value.clone() for name, value in net.state_dict().items()}
    if checkpoint.is_file():
        saved = torch.load(checkpoint, weights_only=True, map_location=schedule.device)
        net.load_state_dict(saved["net"])
        optimiser.load_state_dict(saved["optimiser"])
        cycle.load_state_dict(saved["cycle"])
        best, state = saved["best_net"], saved["state"]
        report(f"going on from step {state['step']} ({checkpoint})")
    start = time.monotonic() - state["seconds"]
    running: float = state.get("loss", 0.0)
    for step, rows in _batches(cache, schedule, state["step"]):
        torch.manual_seed(schedule.seed * 1_000_003 + step)
        net.train()
        value = loss(tensors(cache.batch(rows), schedule.device), _generator(schedule, step))
        optimiser.zero_grad(set_to_none=True)
        value.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(net.parameters(), schedule.clip)
        optimiser.step()
        cycle.step()
        now = value.item()
        running = running + 0.02 * (now - running) if step else now
        done = step + 1
        if done % schedule.evaluate_every == 0 or done == schedule.steps:
            held_out = evaluate(net, cache, loss, schedule)
            if held_out <= state["best"]:
                state.update(best=held_out, best_step=done)
                best = {name: value.clone() for name, value in net.state_dict().items()}
            state.update(step=done, seconds=time.monotonic() - start, loss=running)
            _save(checkpoint, net, optimiser, cycle, best, state)
            report(
                f"step {done} of {schedule.steps}: loss {running:.3f}, held out {held_out:.3f}, "
                f"{state['seconds'] / done * 1000:.0f} ms a step"
            )
    net.load_state_dict(best)
    net.eval()
    checkpoint.unlink(missing_ok=True)
    return Outcome(
        held_out=state["best"],
        best_step=state["best_step"],
        hours=state["seconds"] / 3600,
    )


@torch.inference_mode()
def evaluate(net: nn.Module, cache: Cache, loss: Loss, schedule: Schedule) -> float:
    """Mean loss over held-out samples, always the same ones."""
    net.eval()
    rows = cache.rows(held_out=True)
    if len(rows) > schedule.held_out_samples:
        rows = np.random.default_rng(0).choice(rows, schedule.held_out_samples, replace=False)
    total = 0.0
    for number, start in enumerate(range(0, len(rows), schedule.batch)):
        part = rows[start : start + schedule.batch]
        batch = tensors(cache.batch(part), schedule.device)
        total += float(loss(batch, torch.Generator().manual_seed(number))) * len(part)
    return total / max(len(rows), 1)


def tensors(arrays: Arrays, device: str = "cpu") -> dict[str, Tensor]:
    """The arrays as tensors on a device."""
    return {name: torch.from_numpy(values).to(device) for name, values in arrays.items()}


def _batches(
    cache: Cache, schedule: Schedule, first: int
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """(step, rows) from a step on; each epoch's order depends on seed and epoch alone.

    Within eight batches, samples with similar numbers of paths go together: the networks cut a
    batch to the paths that it uses.
    """
    rows = cache.rows(held_out=False)
    size = min(schedule.batch, len(rows))
    an_epoch = len(rows) // size
    paths = cache.arrays.get("path_info")
    step = 0
    while step < schedule.steps:
        rng = np.random.default_rng([schedule.seed, step // an_epoch])
        order = rng.permutation(rows)[: an_epoch * size]
        if paths is not None and step + an_epoch > first:
            used = (np.asarray(paths[:, :, 0]) > 0).sum(1)
            chunks = np.array_split(order, max(an_epoch // 8, 1))
            order = np.concatenate([c[np.argsort(used[c], kind="stable")] for c in chunks])
        batches = order.reshape(an_epoch, size)
        for number in rng.permutation(an_epoch):
            if first <= step < schedule.steps:
                yield step, batches[number]
            step += 1


def _generator(schedule: Schedule, step: int) -> torch.Generator:
    return torch.Generator().manual_seed(schedule.seed * 7_919 + step)


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


def _save(
    file: Path,
    net: nn.Module,
    optimiser: torch.optim.Optimizer,
    cycle: torch.optim.lr_scheduler.LRScheduler,
    best: dict[str, Tensor],
    state: dict[str, Any],
) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    torch.save(
        {
            "net": net.state_dict(),
            "optimiser": optimiser.state_dict(),
            "cycle": cycle.state_dict(),
            "best_net": best,
            "state": state,
        },
        beside,
    )
    beside.replace(file)
