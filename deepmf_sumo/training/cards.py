"""Writing a set of weights: tensors and a card for each network, and a readable page."""

import json
from pathlib import Path
from typing import Any, Final

from safetensors.torch import save
from torch import nn

import deepmf_sumo
from deepmf_sumo import tables
from deepmf_sumo.deepmf.networks.weights import (
    DIGEST,
    FORMAT_VERSION,
    NETWORKS,
    PEOPLE,
    Network,
    digest_of,
    listed,
    read_card,
    without_people,
)
from deepmf_sumo.training.fit import checkpoints

LIMITS: Final[dict[Network, str]] = {
    "opponent": "Vehicles within 80 m of the AV. A score is the probability of the paper's"
    " pseudo-label, overlapping paths, which does not imply danger; in traffic unlike the training"
    " data it may be overconfident.",
    "marginal": "Vehicles with human drivers, 8 s ahead, in traffic like the training data;"
    " pedestrians and cyclists are inputs, not predicted. Probabilities of 6 modes are calibrated"
    " at 8 s and less accurate at earlier times.",
    "conditional": "One vehicle given the complete future of one other. It knows the planners that"
    " were attacked in the training data; probabilities are calibrated at 8 s and less accurate at"
    " earlier times.",
    "people": "Pedestrians and cyclists, 8 s ahead, in traffic like the training data: which of the"
    " motions of a person without weights, how far off, how sure. It does not know signals.",
    "strive": "For the baseline adversary `strive` only; up to 16 vehicles.",
    "diffscene": "For the baseline adversary `diffscene` only; up to 16 vehicles.",
}
"""Limits of each network, for its card."""


def write(folder: Path, network: str, net: nn.Module, card: dict[str, Any]) -> None:
    """Write a network, or a member of one; an earlier one of that name is replaced.

    Weights of layers are stored in half precision, tables, norms and biases unchanged.
    """
    layers = {name for name, value in net.named_parameters() if value.ndim > 1}
    values = {
        name: (value.half() if name in layers else value).detach().cpu().contiguous()
        for name, value in net.state_dict().items()
    }
    content = save(values)
    checkpoints.write(folder / f"{network}.safetensors", content)
    write_card(folder, network, card | {DIGEST: digest_of(content)})


def write_card(folder: Path, network: str, card: dict[str, Any]) -> None:
    """Replace a network's card, and the page of all cards."""
    full = {"format_version": FORMAT_VERSION, "deepmf_sumo": deepmf_sumo.__version__, **card}
    checkpoints.write(folder / f"{network}.json", (json.dumps(full, indent=1) + "\n").encode())
    checkpoints.write(folder / "card.md", _page(folder).encode())


def add_results(folder: Path, results: dict[str, Any]) -> None:
    """Add the results of an evaluation to the cards of the networks."""
    for network in (*NETWORKS, PEOPLE):
        if network in results and (folder / f"{network}.json").is_file():
            card = read_card(folder, network)
            card["results"] = {"data": results["data"], **results[network]}
            write_card(folder, network, card)


def _page(folder: Path) -> str:
    lines = [f"# Weights '{folder.name}'", ""]
    lacking = without_people(folder)
    if lacking:
        lines += [f"{lacking[0].upper()}{lacking[1:]}.", ""]
    for network in listed(folder):
        card = read_card(folder, network)
        lines += [f"## {network}", ""]
        for key, value in card.items():
            if isinstance(value, list) and value and isinstance(value[0], dict):
                rows = [list(map(str, row.values())) for row in value]
                lines += [f"- {key}:", "", *tables.to_markdown(list(value[0]), rows), ""]
                continue
            text = json.dumps(value) if isinstance(value, dict | list) else str(value)
            lines.append(f"- {key}: {text}")
        lines.append("")
    return "\n".join(lines)
