"""Several members of the marginal network: trained one after the other, measured as one.

The card of the first member lists them once all are there, so that a set is whole at any time.
"""

from typing import Any, Final

from deepmf_sumo.errors import OutputError
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.densetnt import DenseTNT
from deepmf_sumo.training import cards, mixture_measures, run, trajectory
from deepmf_sumo.training.cache import Progress
from deepmf_sumo.training.run import Training

_OF_EACH: Final = (
    "seed", "best_step", "held_out_loss", "hours", "temperature", "training_digest",
)  # fmt: skip
"""What of each member's card the first one's repeats."""
_OF_ALL: Final = ("members", "mixture", "results")
"""What the first member's card says of all of them."""


def train(training: Training, report: Progress) -> None:
    """Train the members that have not been made, then fit the temperature of their mixture.

    Raises what `run.train` raises.
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
            " its members are there: make room, and give the same command again."
        ) from None
    report(f"marginal: {len(names)} member(s), temperature {card['temperature']}")


def _pooled_card(names: list[str], cards_of: list[dict[str, Any]]) -> dict[str, Any]:
    """The first member's card with a list of all members; as a single network's for one."""
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
    """The mixture's temperature, and its held-out figures."""
    nets = []
    for number in range(training.members):
        net, _ = weights.read_network(training.folder, "marginal", number + 1)
        assert isinstance(net, DenseTNT)
        nets.append(net.eval())
    cache = run.open_caches("marginal", training, report)
    return {
        "temperature": trajectory.fit_temperature(nets, cache, run.MODES["marginal"]),
        "mixture": mixture_measures.of_held_out(nets, cache),
    }
