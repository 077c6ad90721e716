"""Networks drawn at random from a seed, with traffic on them."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.training.generated import demand, motorway, street_graph
from deepmf_sumo.training.generated.layout import GeneratedLayout, build
from deepmf_sumo.training.generated.street_graph import dress

__all__ = ["KINDS", "MIX", "generate", "kinds_of"]


def _streets(
    make: Callable[[np.random.Generator], street_graph.StreetGraph],
) -> Callable[[np.random.Generator], GeneratedLayout]:
    def layout(rng: np.random.Generator) -> GeneratedLayout:
        dressed = dress(make(rng), rng)
        street_graph.add_roundabouts(dressed, rng)
        return dressed

    return layout


_MAKERS: Final[dict[str, Callable[[np.random.Generator], GeneratedLayout]]] = {
    "grid": _streets(street_graph.grid),
    "spider": _streets(street_graph.spider),
    "random": _streets(street_graph.random_net),
    "junctions": _streets(street_graph.crossing),
    "motorway": motorway.motorway,
}
MIX: Final = "mix"
KINDS: Final = (*_MAKERS, MIX)
_MIXED: Final = ("grid", "junctions", "random", "grid", "junctions", "spider", "motorway")
"""Kinds of a mix, in turn."""


def kinds_of(kind: str, count: int) -> list[str]:
    """The kind of each of ``count`` networks."""
    return [_MIXED[number % len(_MIXED)] if kind == MIX else kind for number in range(count)]


def generate(kind: str, seed: int, number: int, folder: Path) -> Path:
    """Draw a network and its traffic; returns the .sumocfg. The same arguments give the same bytes.

    Args:
        kind: one of ``KINDS``, except the mix.
        seed: of all networks.
        number: of this one among them.
        folder: an existing folder to write to.

    Raises ConversionError if SUMO's programs refuse the network.
    """
    rng = np.random.default_rng([seed, number, sorted(_MAKERS).index(kind)])
    layout = _MAKERS[kind](rng)
    net = build(layout, folder)
    return demand.write(layout, net, folder, f"{kind}-{seed}-{number:03d}", rng)
