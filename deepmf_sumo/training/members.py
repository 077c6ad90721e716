"""Several members of the marginal network: trained one after the other, measured as a mixture.

The card of the first member lists all members when they are complete, so that a set can be used at
any time.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch

from deepmf_sumo.deepmf.networks import decode, torch_networks, weights
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, GoalSet, Singles, log_softmax
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT
from deepmf_sumo.errors import OutputError
from deepmf_sumo.training import cards, run
from deepmf_sumo.training.fit.loop import in_batches
from deepmf_sumo.training.networks import trajectory
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples.dataset import Dataset, Progress

_OF_EACH: Final = (
    "seed", "best_step", "held_out_loss", "hours", "temperature", "training_digest",
)  # fmt: skip
"""Keys of each member's card that the first one's card repeats."""
_OF_ALL: Final = ("members", "mixture", "results")
"""Keys of the first member's card that describe all members."""
_MODES: Final = (6, 16, 32)
_BATCH: Final = 32


def train(training: Training, report: Progress) -> None:
    """Train missing members, then fit the temperature of their mixture.

    Raises the errors of `run.train`.
    """
    names = [weights.member("marginal", number + 1) for number in range(training.members)]
    for number in range(training.members):
        run.train("marginal", training, report, number + 1)
    folder = training.folder
    cards_of = [weights.read_card(folder, name) for name in names]
    digests = [card["training_digest"] for card in cards_of]
    if weights.members(folder, cards_of[0]) == digests:
        return
    card = _pooled_card(names, cards_of)
    if len(names) > 1:
        card |= _measured(training, report)
    try:
        cards.write_card(folder, "marginal", card)
    except OSError as error:
        raise OutputError(
            f"The card of the marginal network cannot be written to {folder} ({error.strerror});"
            " its members are complete: free some space and repeat the command."
        ) from None
    report(f"marginal: {len(names)} member(s), temperature {card['temperature']}")


def _pooled_card(names: list[str], cards_of: list[dict[str, Any]]) -> dict[str, Any]:
    """The first member's card with a list of all members, if there are several."""
    first = cards_of[0]
    alone = first["members"][0] if "members" in first else first  # with its own temperature
    card = {key: value for key, value in first.items() if key not in _OF_ALL}
    if len(names) == 1:
        return card | {"temperature": alone["temperature"]}
    listed = [
        {"name": name, **{key: one[key] for key in _OF_EACH}}
        for name, one in zip(names, [alone, *cards_of[1:]], strict=True)
    ]
    return card | {"members": listed}


def _measured(training: Training, report: Progress) -> dict[str, Any]:
    """The mixture's temperature and held-out figures."""
    nets = []
    for number in range(training.members):
        net, _ = torch_networks.read_network(training.folder, "marginal", number + 1)
        assert isinstance(net, DenseTNT)
        nets.append(net.eval())
    dataset = run.open_dataset("marginal", training, report)
    return {
        "temperature": trajectory.fit_temperature(nets, dataset, run.MODES["marginal"]),
        "mixture": mixture_errors(nets, dataset),
    }


@torch.inference_mode()
def mixture_errors(nets: Sequence[DenseTNT], dataset: Dataset) -> dict[str, Any]:
    """Samples, loss (negative log density, nats) and min FDE at 8 s (m) by number of modes.

    Of the mixture, and of the first network alone, on the same up to 600 held-out samples that are
    known for 8 s. Empty if there are none.
    """
    rows = np.sort(trajectory.known_held_out(dataset))
    if len(rows) == 0:
        return {}
    sums: dict[str, float] = {}
    for batch in in_batches(dataset, rows, _BATCH):
        members = [net(batch).sets() for net in nets]
        truth = zip(batch["future"].numpy(), batch["future_valid"].numpy(), strict=True)
        for each, (future, valid) in zip(zip(*members, strict=True), truth, strict=True):
            for name, chosen in (("", len(nets)), ("first_", 1)):
                found = _figures(nets[:chosen], each[:chosen], future, valid)
                for key, value in found.items():
                    sums[name + key] = sums.get(name + key, 0.0) + value
    return {"samples": len(rows)} | {
        key: round(value / len(rows), 4) for key, value in sums.items()
    }


def _figures(
    nets: Sequence[DenseTNT], members: Sequence[GoalSet], future: Singles, valid: Singles
) -> dict[str, float]:
    """Of one sample: its true future (80, 2), and where it is known (80)."""
    knots = list(KNOT_STEPS)
    kernels_m = [net.kernel_m for net in nets]
    density = decode.log_density(kernels_m, members, 1.0, future[None, knots], valid[knots])
    found = {"loss": -float(density[0])}
    goals = decode.pooled(members)
    weight = np.exp(log_softmax(goals.logits.reshape(1, -1))).reshape(goals.logits.shape)
    ends = goals.ends()
    for modes in _MODES:
        chosen, _ = decode.select(weight, ends, modes, block=goals.block)
        off = np.hypot(*(ends[0, chosen[0]] - future[-1]).T)
        found[f"min_fde_{modes}"] = float(off.min())
    return found
