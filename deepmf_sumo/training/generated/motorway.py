"""Motorways: two carriageways with ramps, merges, exits and weaving sections."""

from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.training.generated.layout import Edge, GeneratedLayout, LaneConnection, Node

_GAP_M: Final = 5.0
"""From a carriageway's left border to the middle of the motorway."""
_SPACING_M: Final = 20.0
_EXIT_SHARE: Final = 0.6


def motorway(rng: np.random.Generator) -> GeneratedLayout:
    """Two carriageways with separate ramps along one gently curved line."""
    lanes, limit_mps = int(rng.integers(2, 5)), float(rng.choice([24.6, 26.8, 29.1, 31.3]))
    line = _curved(rng, length_m=rng.uniform(1300.0, 1900.0))
    layout = GeneratedLayout(options=("--default.lanewidth", f"{rng.uniform(3.4, 3.75):.2f}"))
    _carriageway(layout, "e", _beside(line, -_GAP_M), lanes, limit_mps, rng)
    _carriageway(layout, "w", _beside(line[::-1], -_GAP_M), lanes, limit_mps, rng)
    return layout


def _carriageway(
    layout: GeneratedLayout,
    name: str,
    line: Floats,
    lanes: int,
    limit_mps: float,
    rng: np.random.Generator,
) -> None:
    """Pieces of the main road; a piece after an entry has one more lane, and may end at an exit."""
    along, length_m = 0.0, polylines.arc_lengths(line)[-1]
    place = _node(layout, f"{name}0", line, 0.0)
    before, number, extra = "", 0, False
    while along < length_m - 1.0:
        entry = not extra and number > 0
        piece_m = rng.uniform(200.0, 380.0) if entry else rng.uniform(200.0, 420.0)
        end = length_m if along + piece_m > length_m - 150.0 else along + piece_m
        number += 1
        onward = _node(layout, f"{name}{number}", line, end)
        here = f"{name}{number}"
        layout.edges[here] = Edge(
            origin=place,
            target=onward,
            lanes=lanes + entry,
            speed_mps=limit_mps,
            priority=9,
            shape_m=_cut(line, along, end),
        )
        if before:
            _join(layout, before, here, lanes, shift=int(entry) - int(extra))
        if entry:
            _ramp(layout, here, place, line, along, enters=True, rng=rng)
        elif extra and rng.random() < _EXIT_SHARE:
            _ramp(layout, before, place, line, along, enters=False, rng=rng)
        elif extra:
            _close(layout, before, here, place)
        place, before, along, extra = onward, here, end, entry


def _join(layout: GeneratedLayout, before: str, here: str, lanes: int, shift: int) -> None:
    """Main lanes continue side by side; the additional lane is on the right."""
    for lane in range(lanes):
        layout.connections.append(
            LaneConnection(
                origin=before,
                target=here,
                origin_lane=lane + (shift < 0),
                target_lane=lane + (shift > 0),
            )
        )


def _close(layout: GeneratedLayout, before: str, here: str, place: str) -> None:
    """The additional lane ends: vehicles of the two right lanes merge alternately."""
    layout.nodes[place] = replace(layout.nodes[place], kind="zipper")
    layout.connections.append(
        LaneConnection(origin=before, target=here, origin_lane=0, target_lane=0)
    )


def _ramp(
    layout: GeneratedLayout,
    beside: str,
    place: str,
    line: Floats,
    along: float,
    *,
    enters: bool,
    rng: np.random.Generator,
) -> None:
    """An entry onto, or an exit off, the lane on the right of an edge."""
    length_m, aside_m = rng.uniform(130.0, 220.0), rng.uniform(25.0, 45.0)
    back = -1.0 if enters else 1.0
    (x, y), heading = polylines.points_at(line, np.array(along))
    ahead = np.array([np.cos(heading), np.sin(heading)])
    right = np.array([ahead[1], -ahead[0]])
    lanes_m = 3.5 * (layout.edges[beside].lanes - 1)
    share = np.linspace(0.0, 1.0, 15)[:, None]
    sideways = lanes_m + aside_m * share**2
    shape = np.array([x, y]) + back * length_m * share * ahead + sideways * right
    # an edge ends at its nodes; the offset from the main road's node lies inside the junction
    far = f"{place}_{'in' if enters else 'out'}"
    layout.nodes[far] = Node(position_m=(float(shape[-1, 0]), float(shape[-1, 1])))
    speed = float(rng.choice([15.6, 17.9, 20.1]))
    ramp = f"{far}_ramp"
    if enters:
        layout.edges[ramp] = Edge(
            origin=far, target=place, lanes=1, speed_mps=speed, priority=3, shape_m=shape[::-1]
        )
        link = LaneConnection(origin=ramp, target=beside, origin_lane=0, target_lane=0)
    else:
        layout.edges[ramp] = Edge(
            origin=place, target=far, lanes=1, speed_mps=speed, priority=3, shape_m=shape
        )
        link = LaneConnection(origin=beside, target=ramp, origin_lane=0, target_lane=0)
    layout.connections.append(link)


def _curved(rng: np.random.Generator, length_m: float) -> Floats:
    """(P, 2) a line with a radius of at least 350 m."""
    count = int(length_m / _SPACING_M) + 1
    along = np.linspace(0.0, length_m, count)
    wave = np.sin(2 * np.pi * along / rng.uniform(700.0, 1600.0) + rng.uniform(0, 2 * np.pi))
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(wave) * rng.uniform(0.0, _SPACING_M / 350.0)
    steps = _SPACING_M * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    line: Floats = np.cumsum(steps, axis=0)
    return line


def _beside(line: Floats, left_m: float) -> Floats:
    direction = np.gradient(line, axis=0)
    direction /= np.hypot(direction[:, 0], direction[:, 1])[:, None]
    beside: Floats = line + left_m * np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    return beside


def _cut(line: Floats, start_m: float, end_m: float) -> Floats:
    count = max(2, int((end_m - start_m) / _SPACING_M) + 1)
    return polylines.points_at(line, np.linspace(start_m, end_m, count))[0]


def _node(layout: GeneratedLayout, name: str, line: Floats, along_m: float) -> str:
    place = f"{name}_at"
    x, y = polylines.points_at(line, np.array(along_m))[0]
    layout.nodes[place] = Node(position_m=(float(x), float(y)))
    return place
