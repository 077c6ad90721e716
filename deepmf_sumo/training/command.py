"""Command line and configuration -> trainings.

Several members of the marginal network are trained one after the other, and measured as a mixture.
The card of the first member lists all members when they are complete, so that a set can be used at
any time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from deepmf_sumo.deepmf.networks import decode, torch_networks, weights
from deepmf_sumo.deepmf.networks.config import preset_named
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, GoalSet, Singles, log_softmax
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT
from deepmf_sumo.deepmf.networks.weights import BASELINES, NETWORKS, PEOPLE, Network
from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.training import cards, config, initial_weights, run
from deepmf_sumo.training.config import Config
from deepmf_sumo.training.fit.loop import in_batches
from deepmf_sumo.training.networks import trajectory
from deepmf_sumo.training.run import Training
from deepmf_sumo.training.samples.dataset import Dataset, Progress
from deepmf_sumo.training.samples.feature_cache import Data

_OF_EACH: Final = (
    "seed", "best_step", "held_out_loss", "hours", "temperature", "training_digest",
)  # fmt: skip
"""Keys of each member's card that the first one's card repeats."""
_OF_ALL: Final = ("members", "mixture", "results")
"""Keys of the first member's card that describe all members."""
_MODES: Final = (6, 16, 32)
_BATCH: Final = 32


def train_members(training: Training, report: Progress) -> None:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingRequest:
    """What the command line asks for.

    Attributes:
        network: its name, or ``all`` for the three of the paper.
        file: the configuration. sets: ``key=value`` over it.
        data: ``PATH`` or ``PATH=WEIGHT`` each, instead of the configuration's.
        name: of the set of weights. out: its folder, instead of one in the weights home.
        command: for the card.
    """

    network: str
    file: Path | None = None
    sets: Sequence[str] = ()
    data: Sequence[str] = ()
    name: str = "custom"
    out: Path | None = None
    cache: Path | None = None
    jobs: int = 1
    again: bool = False
    command: str = ""


def train_requested(request: TrainingRequest, report: Progress) -> None:
    """Train the networks of a request.

    Raises UsageError without data, SpecError for a wrong configuration, and WeightsError if the
    initial weights of a network do not fit or the device is not there, all before any network is
    trained.
    """
    settings = config.load(request.file, request.sets)
    data = _sources(request, settings)
    named = {one.partition("=")[0].strip() for one in request.sets}
    if "members" in named and request.network not in {"marginal", "all"}:
        raise UsageError(
            f"members applies to the marginal network; the {request.network} network has one."
        )
    networks = _networks(request.network)
    trainings = {network: _training(network, request, settings, data) for network in networks}
    for network, one in trainings.items():
        if one.begin_from is not None:
            initial_weights.check(network, one.preset, one.folder, one.begin_from, report)
    for network, one in trainings.items():
        train_each([network], one, None, report)


def train_each(
    networks: Sequence[Network], training: Training, threads: int | None, report: Progress
) -> None:
    """Train networks one after the other with ``threads`` CPU threads (None: torch's default)."""
    if threads is not None:
        torch.set_num_threads(threads)
    for network in networks:
        if network == "marginal":
            train_members(training, report)
        else:
            run.train(network, training, report)


def _networks(name: str) -> list[Network]:
    if name == "all":
        return list(NETWORKS)
    return [network for network in (*NETWORKS, PEOPLE, *BASELINES) if network == name]


def _training(
    network: Network, request: TrainingRequest, settings: Config, data: Sequence[Data]
) -> Training:
    return Training(
        data=data,
        folder=request.out or weights.place(request.name),
        cache=request.cache or weights.home() / ".features",
        preset=preset_named(settings.preset or config.PRESETS[network]),
        optimisation={network: settings.of(network)},
        begin_from=settings.begin_from,
        seed=settings.seed or 0,
        device=torch_networks.device(),
        jobs=request.jobs,
        again=request.again,
        licence=settings.licence or "",
        command=request.command,
        members=settings.members or config.MEMBERS,
    )


def _sources(request: TrainingRequest, settings: Config) -> list[Data]:
    sources = [config.parsed(text) for text in request.data] or settings.sources()
    if not sources:
        raise UsageError("No data to train on; give --data, or a --config with 'data'.")
    config.check_weights(sources)
    return sources
