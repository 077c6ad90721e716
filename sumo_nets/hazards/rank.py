"""Places of `build.py` by their risk, and whether seeds agree: ``python rank.py OUT...``.

Each OUT is a result folder of ``deepmf-sumo attack hazards.sumocfg``, e.g. one a seed. An attack
belongs to the place where it began, as its edges are named after it. The risk of a place is its
rate of an event, drawn towards that of all places as far as its data are thin (the package's
``benchmark.risk``); places are ranked by the lower end of its 90 % interval.
"""

# ruff: noqa: INP001, T201 - a script beside data, not a package

import argparse
import itertools
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.benchmark.risk import Attacked, read
from deepmf_sumo.benchmark.risk.shrinkage import Shrunk, prior, shrink
from deepmf_sumo.benchmark.risk.table import CONFLICT_S, SEVERE_MPS
from deepmf_sumo.errors import DeepmfError

KINDS: Final = ("merge", "signal", "left", "stop")
FLAWED: Final = ("merge3", "signal6", "left1", "stop8")
PLACES: Final = tuple(f"{kind}{number}" for kind in KINDS for number in range(10))
EVENTS: Final[Mapping[str, Callable[[Attacked], bool]]] = {
    "hit": lambda one: one.hit,
    "avoidable": lambda one: bool(one.avoidable),
    "severe": lambda one: one.hit and (one.delta_v_mps or 0.0) >= SEVERE_MPS,
    "conflict": lambda one: one.hit or (one.ttc_s is not None and one.ttc_s <= CONFLICT_S),
}


class Place(NamedTuple):
    """A place and its counts; ``rank`` 1 is the worst, and equals share the mean of their ranks."""

    name: str
    attacks: int
    events: int
    risk: Shrunk
    rank: float


def ranked(attacks: Iterable[Attacked], event: str) -> list[Place]:
    """All forty places, the worst first; those without an attack have the risk of all."""
    counts = {name: [0, 0] for name in PLACES}
    for one in attacks:
        name = _place(one)
        if name in counts:
            counts[name][0] += 1
            counts[name][1] += EVENTS[event](one)
    given = prior([(events, number) for number, events in counts.values()])
    risks = {name: shrink(events, number, given) for name, (number, events) in counts.items()}
    low = np.round([risks[name].low for name in PLACES], 6)
    rank = {
        name: float((low > mine).sum() + ((low == mine).sum() + 1) / 2)
        for name, mine in zip(PLACES, low, strict=True)
    }
    table = [Place(name, *counts[name], risks[name], rank[name]) for name in PLACES]
    return sorted(table, key=lambda place: (place.rank, place.name))


def _place(one: Attacked) -> str:
    """The place that the names of edges and junctions begin with; empty off the network."""
    spot = one.began if one.began.edge or one.began.junction else one.decided
    found = re.match(r"[a-z]+\d+", spot.edge or spot.junction)
    return found[0] if found else ""


def agreement(first: Sequence[Place], second: Sequence[Place]) -> float:
    """Kendall's tau-b of two rankings of the same places; nan where one is all ties."""
    one, two = ({place.name: place.rank for place in table} for table in (first, second))
    pairs = list(itertools.combinations(PLACES, 2))
    a = np.sign([one[x] - one[y] for x, y in pairs])
    b = np.sign([two[x] - two[y] for x, y in pairs])
    untied = float(np.sqrt((a != 0).sum() * (b != 0).sum()))
    return float((a * b).sum()) / untied if untied else float("nan")


def main() -> int:
    """Print the ranking of all folders together, and what each pair of them agrees on."""
    parser = argparse.ArgumentParser(description="Rank the forty places by their risk.")
    parser.add_argument("folders", metavar="OUT", nargs="+", type=Path)
    parser.add_argument("--event", choices=EVENTS, default="avoidable")
    parser.add_argument("--flawed", nargs="*", default=FLAWED, metavar="PLACE", choices=PLACES)
    given = parser.parse_args()
    try:
        seeds = [[one for net in read([out]) for one in net.attacks] for out in given.folders]
    except DeepmfError as error:
        print(error, file=sys.stderr)
        return 2
    table = ranked(itertools.chain(*seeds), given.event)
    print(f"place     rank  attacks  {given.event}  risk (90 % interval)")
    for place in table:
        mark = "  <- flawed" if place.name in given.flawed else ""
        low, high = (f"{100 * end:.0f}" for end in (place.risk.low, place.risk.high))
        risk = f"{100 * place.risk.rate:.0f} % ({low} to {high})"
        print(
            f"{place.name:9} {place.rank:4.1f}  {place.attacks:7}  {place.events:6}  {risk}{mark}"
        )
    each = [ranked(attacks, given.event) for attacks in seeds]
    taus = [agreement(first, second) for first, second in itertools.combinations(each, 2)]
    if taus:
        print(f"Kendall's tau-b of {len(taus)} pairs of folders: mean {np.mean(taus):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
