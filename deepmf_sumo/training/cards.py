"""Writing a set of weights: tensors and a card for each network, and a page to read."""

import json
from pathlib import Path
from typing import Any, Final

from safetensors.torch import save
from torch import nn

import deepmf_sumo
from deepmf_sumo.predictors.weights import (
    DIGEST,
    FORMAT_VERSION,
    NETWORKS,
    Network,
    digest_of,
    listed,
    read_card,
    tensors,
    unchecked,
)
from deepmf_sumo.training.fit import checkpoints

LIMITS: Final[dict[Network, str]] = {
    "opponent": "Vehicles within 80 m of the AV. A score is the chance of the paper's pseudo-label,"
    " which is that two ways overlap, not that anybody is in danger; in traffic unlike the data's"
    " it may be too sure.",
    "marginal": "Vehicles driven by people, 8 s ahead, in traffic like the data's; pedestrians and"
    " cyclists are seen, not predicted. The chances of 6 modes are fitted at 8 s and less right"
    " before.",
    "conditional": "One vehicle given the whole future of one other. Of planners it knows those"
    " that the data's attacks were on; its chances are fitted at 8 s and less right before.",
    "strive": "A baseline's: up to 16 vehicles, for the adversary `strive` alone.",
}
"""What each network must not be taken for; for the cards."""


def write(folder: Path, network: str, net: nn.Module, card: dict[str, Any]) -> None:
    """Put a network, or a member of one, into the folder; what was there of that name is replaced.

    Layers' weights are stored in half precision; tables, norms and biases as they are.
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
    """Replace a network's card, and the page made of all cards."""
    full = {"format_version": FORMAT_VERSION, "deepmf_sumo": deepmf_sumo.__version__, **card}
    checkpoints.write(folder / f"{network}.json", (json.dumps(full, indent=1) + "\n").encode())
    checkpoints.write(folder / "card.md", _page(folder).encode())


def add_digests(folder: Path) -> list[str]:
    """Give the cards of earlier versions the digests of their tensors as they are now.

    Returns the networks whose cards had none. Raises WeightsError where one cannot be read.
    """
    lacking = unchecked(folder)
    for network in lacking:
        card = read_card(folder, network)
        tensors(folder, network)  # those that cannot be read shall not get a digest
        content = (folder / f"{network}.safetensors").read_bytes()
        write_card(folder, network, card | {DIGEST: digest_of(content)})
    return lacking


def add_results(folder: Path, results: dict[str, Any]) -> None:
    """Put the results of an evaluation into the cards of the networks that they are about."""
    for network in NETWORKS:
        if network in results:
            card = read_card(folder, network)
            card["results"] = {"data": results["data"], **results[network]}
            write_card(folder, network, card)


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """Rows of equal keys, as Markdown."""
    names = list(rows[0])
    head = [f"| {' | '.join(names)} |", "|" + " --- |" * len(names)]
    return head + [f"| {' | '.join(str(row[name]) for name in names)} |" for row in rows]


def _page(folder: Path) -> str:
    lines = [f"# Weights '{folder.name}'", ""]
    for network in listed(folder):
        card = read_card(folder, network)
        lines += [f"## {network}", ""]
        for key, value in card.items():
            if isinstance(value, list) and value and isinstance(value[0], dict):
                lines += [f"- {key}:", "", *_table(value), ""]
                continue
            text = json.dumps(value) if isinstance(value, dict | list) else str(value)
            lines.append(f"- {key}: {text}")
        lines.append("")
    return "\n".join(lines)
