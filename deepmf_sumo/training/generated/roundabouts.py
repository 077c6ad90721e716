"""Junctions made into roundabouts."""

from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.training.generated.layout import Edge, GeneratedLayout, Node

_ARMS: Final = (3, 4, 5)
_LEAST_ARM_M: Final = 70.0
_SHARE: Final = 0.15
_LIMIT_MPS: Final = 11.0
_PRIORITY: Final = 20
"""Above every street's: traffic in the ring goes first."""


def add(layout: GeneratedLayout, rng: np.random.Generator) -> None:
    """Turn junctions with enough room into roundabouts, each with the same probability."""
    for place in list(layout.nodes):
        out = [name for name, edge in layout.edges.items() if edge.origin == place]
        room = all(layout.length_m(name) > _LEAST_ARM_M for name in out)
        narrow = all(layout.edges[name].lanes < 3 for name in out)
        straight = all(layout.edges[name].shape_m is None for name in out)
        chance, radius_m = rng.random(), rng.uniform(13.0, 22.0)
        if len(out) in _ARMS and room and narrow and straight and chance < _SHARE:
            _ring(layout, place, radius_m, rng.uniform(6.5, 9.0))


def _ring(layout: GeneratedLayout, place: str, radius_m: float, speed_mps: float) -> None:
    centre = np.array(layout.nodes.pop(place).position_m)
    bearing = {}
    for edge in layout.edges.values():
        if edge.origin == place:
            away = np.array(layout.nodes[edge.target].position_m) - centre
            bearing[edge.target] = float(np.arctan2(away[1], away[0]))
    arms = sorted(bearing, key=lambda arm: bearing[arm])
    at = {arm: f"{place}.{arm}" for arm in arms}
    for arm in arms:
        x, y = centre + radius_m * frames.unit(bearing[arm])
        layout.nodes[at[arm]] = Node(position_m=(float(x), float(y)))
    wide = _shorten_arms(layout, place, at)
    ring = []
    for arm, onward in zip(arms, [*arms[1:], arms[0]], strict=True):
        turn = (bearing[onward] - bearing[arm]) % (2 * np.pi)
        ring.append(f"{at[arm]}_ring")
        layout.edges[ring[-1]] = Edge(
            origin=at[arm],
            target=at[onward],
            lanes=wide,
            speed_mps=speed_mps,
            priority=_PRIORITY,
            shape_m=centre + radius_m * frames.unit(bearing[arm] + np.linspace(0.0, turn, 9)),
        )
    layout.roundabouts.append(([at[arm] for arm in arms], ring))


def _shorten_arms(layout: GeneratedLayout, place: str, at: dict[str, str]) -> int:
    """Let the streets end at the ring's nodes; returns the number of lanes of the widest one."""
    wide = 1
    for name, edge in list(layout.edges.items()):
        if place not in (edge.origin, edge.target):
            continue
        wide = max(wide, edge.lanes)
        slow = min(edge.speed_mps, _LIMIT_MPS)
        if edge.origin == place:
            layout.edges[name] = replace(edge, origin=at[edge.target], speed_mps=slow)
        else:
            layout.edges[name] = replace(
                edge, target=at[edge.origin], speed_mps=slow, turn_lane_m=0.0
            )
    return wide
