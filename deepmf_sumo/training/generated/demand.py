"""Traffic for a generated network: trips that SUMO routes, and parked cars."""

from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints
from deepmf_sumo.sumo.network.sumo_net import read_once
from deepmf_sumo.training.generated.layout import GeneratedLayout

_LONGEST_S: Final = 900.0
"""Latest departure of a trip."""
_MOST_TRIPS: Final = 900
_FILL_S: Final = 20.0
"""Time in which the net fills to the usual density."""
_MOST_VEHICLES: Final = 80
"""Limit of vehicles present at a time: more would slow SUMO down and jam crossings."""
_PER_LANE_KM: Final = (2.0, 8.0)
_PER_FREEWAY_LANE_KM: Final = (2.0, 9.0)
"""With more, hesitant drivers jam the merges."""
_FREEWAY_MPS: Final = 24.0
_INNER_WEIGHT: Final = 0.12
_INNER_FREEWAY_WEIGHT: Final = 0.01
_WIDTH_POWER: Final = 1.7
_CLEAR_M: Final = 15.0
"""Distance of parked cars from junctions."""
_FASTEST_PARKING_MPS: Final = 14.0
_LEAVING_SHARE: Final = 0.2
_CLASSES: Final = {
    "passenger": 0.83,
    "delivery": 0.05,
    "truck": 0.06,
    "bus": 0.02,
    "motorcycle": 0.04,
}
_LENGTH_M: Final = {"passenger": 5.0, "delivery": 6.5, "truck": 12.0, "bus": 12.5}
"""Length for which SUMO needs room at insertion; the vehicle itself is drawn later."""


def write(
    layout: GeneratedLayout, net: Path, folder: Path, name: str, rng: np.random.Generator
) -> Path:
    """Write trips and a configuration ``NAME.sumocfg``; returns it."""
    reach = _reach(layout, net)
    routes = folder / f"{name}.rou.xml"
    lines = [
        *(
            f'<vType id="{kind}" vClass="{kind}" length="{_LENGTH_M.get(kind, 2.4)}"/>'
            for kind in _CLASSES
        ),
        *sorted(_trips(layout, reach, rng) + _parked(layout, net, reach, rng), key=_depart),
    ]
    routes.write_text("\n".join(["<routes>", *lines, "</routes>", ""]), "utf-8")
    config = folder / f"{name}.sumocfg"
    config.write_text(
        f'<configuration><input><net-file value="{net.name}"/>'
        f'<route-files value="{routes.name}"/></input><processing>'
        '<time-to-teleport value="60"/><max-depart-delay value="20"/>'
        "</processing></configuration>\n",
        "utf-8",
    )
    return config


def _depart(line: str) -> float:
    return float(line.split('depart="', 1)[1].split('"', 1)[0])


def _reach(layout: GeneratedLayout, net: Path) -> dict[str, set[str]]:
    """Edges that can be reached from each edge: vehicles without a route block the road in SUMO."""
    after: dict[str, set[str]] = {}
    for link in read_once(net).links:
        if not link.starts_inside:
            origin, target = link.edges
            after.setdefault(origin, set()).add(target)
    reach = {}
    for name in layout.edges:
        seen: set[str] = set()
        ahead = set(after.get(name, ()))
        while ahead:
            seen |= ahead
            ahead = {onward for edge in ahead for onward in after.get(edge, ())} - seen
        reach[name] = seen - {name}
    return reach


def _trips(
    layout: GeneratedLayout, reach: dict[str, set[str]], rng: np.random.Generator
) -> list[str]:
    """Departures at a rate that keeps the drawn number of vehicles on the lanes."""
    names, edges = list(layout.edges), list(layout.edges.values())
    length = np.array([layout.length_m(name) for name in names])
    lanes = np.array([edge.lanes for edge in edges])
    speed = np.array([edge.speed_mps for edge in edges])
    freeway = bool((speed > _FREEWAY_MPS).mean() > 0.4)
    density = rng.uniform(*(_PER_FREEWAY_LANE_KM if freeway else _PER_LANE_KM))
    present = min(_MOST_VEHICLES, density * float((length * lanes).sum()) / 1000.0)
    inner = _INNER_FREEWAY_WEIGHT if freeway else _INNER_WEIGHT
    first, last = _ends(layout)
    # wide roads carry more on each of their lanes
    weight = lanes**_WIDTH_POWER * np.where(first, 1.0, inner)
    goal = lanes**_WIDTH_POWER * np.where(last, 1.0, inner)
    origins = rng.choice(len(names), _MOST_TRIPS, p=weight / weight.sum())
    targets = _targets(names, origins, goal, reach, rng)
    start = np.array([layout.shape_m(name)[0] for name in names])
    end = np.array([layout.shape_m(name)[-1] for name in names])
    route_m = 1.25 * np.hypot(*(end[targets] - start[origins]).T) + 50.0
    lasts_s = float(np.mean(route_m / ((0.9 if freeway else 0.55) * speed[origins])))
    departs = _departures(present, lasts_s, rng)
    kinds = rng.choice(list(_CLASSES), _MOST_TRIPS, p=list(_CLASSES.values()))
    lane = "free" if freeway else "best"
    trips = []
    for number, (origin, target) in enumerate(zip(origins, targets, strict=True)):
        if departs[number] > _LONGEST_S or names[target] not in reach[names[origin]]:
            continue
        amid = (departs[number] < _FILL_S and not freeway) or not first[origin]
        trips.append(
            f'<trip id="{number}" type="{kinds[number]}" depart="{departs[number]:.1f}"'
            f' from="{names[origin]}" to="{names[target]}" departLane="{lane}" departSpeed="max"'
            f' departPos="{"random" if amid else "base"}"/>'
        )
    return trips


def _departures(present: float, lasts_s: float, rng: np.random.Generator) -> Floats:
    """Times of departure: ``present`` vehicles at first, then one for each that should arrive."""
    soon = np.sort(rng.uniform(0.0, _FILL_S, int(present)))
    gap_s = lasts_s / max(present, 4.0)
    return np.concatenate([soon, _FILL_S + gap_s * np.arange(_MOST_TRIPS)])


def _targets(
    names: list[str],
    origins: Ints,
    weight: Floats,
    reach: dict[str, set[str]],
    rng: np.random.Generator,
) -> Ints:
    """For each origin an edge that can be reached, or the origin if there is none."""
    targets = origins.copy()
    for origin in np.unique(origins):
        can = np.array([name in reach[names[origin]] for name in names])
        mine = origins == origin
        if can.any():
            share = weight * can
            targets[mine] = rng.choice(len(names), int(mine.sum()), p=share / share.sum())
    return targets


def _ends(layout: GeneratedLayout) -> tuple[Bools, Bools]:
    """Edges that start outside the net, and edges that end there."""
    edges = list(layout.edges.values())
    beside: dict[str, set[str]] = {}
    for edge in edges:
        beside.setdefault(edge.origin, set()).add(edge.target)
        beside.setdefault(edge.target, set()).add(edge.origin)
    rim = {node for node, others in beside.items() if len(others) == 1}
    first = np.array([edge.origin in rim for edge in edges])
    last = np.array([edge.target in rim for edge in edges])
    # a net without a rim: from any edge to any other
    return (first, last) if first.any() else (~first, ~last)


def _parked(
    layout: GeneratedLayout, net: Path, reach: dict[str, set[str]], rng: np.random.Generator
) -> list[str]:
    """Cars beside slow streets; some of them pull out while the others stay."""
    per_km = rng.choice([0.0, 5.0, 15.0, 30.0])
    lengths_m = {name: edge.lanes[0].length_m for name, edge in read_once(net).edges.items()}
    rim = [name for name, ends in zip(layout.edges, _ends(layout)[1], strict=True) if ends]
    lines = []
    for name, edge in layout.edges.items():
        room_m = lengths_m.get(name, 0.0) - 2 * _CLEAR_M
        goals = [goal for goal in rim if goal in reach[name]]
        if edge.speed_mps > _FASTEST_PARKING_MPS or room_m < 10.0 or not goals:
            continue
        for number in range(int(rng.poisson(per_km * room_m / 1000.0))):
            at = _CLEAR_M + rng.uniform(0.0, room_m)
            stays = rng.uniform(20.0, 200.0) if rng.random() < _LEAVING_SHARE else 2 * _LONGEST_S
            lines.append(
                f'<trip id="parked_{name}_{number}" type="passenger" depart="0.0" from="{name}"'
                f' to="{rng.choice(goals)}" departLane="0" departPos="{at:.1f}" departSpeed="0">'
                f'<stop lane="{name}_0" startPos="{at - 8.0:.1f}"'
                f' endPos="{at + 0.5:.1f}" duration="{stays:.0f}" parking="true"/></trip>'
            )
    return lines
