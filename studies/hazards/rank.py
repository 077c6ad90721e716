"""Places of `build.py` by how critical attacks were there: ``python rank.py OUT...``.

Each OUT is a seed: a result folder of ``deepmf-sumo attack hazards.sumocfg``, or a folder of such.
An attack belongs to the place where it started: its edges are named after it. The mean criticality
of its attacks is drawn to the typical place of its kind as far as the data are thin (the package's
``results.statistics``). Places are ranked by how far the lower end of the interval is above
the typical one, as road authorities rank sites by reference populations: at a stop ways always
cross, on a motorway never. Those that cannot be told from the typical one share one rank.

``--conflicts OUT...``: folders of ``deepmf-sumo conflicts`` instead; places are ranked by how many
conflicts they have more than the median place of their kind.
"""

# ruff: noqa: INP001, T201 - a script beside data, not a package

import argparse
import csv
import itertools
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.results.risk.attacks import Attacked, read
from deepmf_sumo.results.statistics import PlaceMean, by_unit, place_means, ranks, units_of

KINDS: Final = ("merge", "signal", "left", "stop")
FLAWED: Final = ("merge3", "signal6", "left1", "stop8")
PLACES: Final = tuple(f"{kind}{number}" for kind in KINDS for number in range(10))


class Place(NamedTuple):
    """A place; ``rank`` 1 is the worst, and equals share the mean of their ranks."""

    name: str
    attacks: int
    hits: int
    risk: PlaceMean
    rank: float


def ranked(attacks: Iterable[Attacked]) -> list[Place]:
    """All forty places, the worst first; those without an attack are taken as typical."""
    groups: dict[str, list[Attacked]] = {name: [] for name in PLACES}
    for one in attacks:
        groups.get(_place(one), []).append(one)
    values = {
        name: units_of(by_unit((one.unit, one.criticality or 0.0) for one in groups[name]))
        for name in PLACES
    }
    risks = place_means(values, {name: name.rstrip("0123456789") for name in PLACES})
    rank = ranks({name: risks[name].surely for name in PLACES})
    hits = {name: sum(one.hit for one in groups[name]) for name in PLACES}
    table = [Place(name, len(groups[name]), hits[name], risks[name], rank[name]) for name in PLACES]
    return sorted(table, key=lambda place: (place.rank, -place.risk.excess, place.name))


def _ranks(table: Iterable[Place]) -> dict[str, float]:
    return {one.name: one.rank for one in table}


def _excesses(table: Iterable[Place]) -> dict[str, float]:
    """Of all places, those that cannot be told from the typical one as well; less is better."""
    return {one.name: -round(one.risk.excess, 6) for one in table}


def agreement(first: Mapping[str, float], second: Mapping[str, float]) -> float:
    """Kendall's tau-b of two rankings of the same places; nan where one is all ties."""
    pairs = list(itertools.combinations(first, 2))
    a = np.sign([first[x] - first[y] for x, y in pairs])
    b = np.sign([second[x] - second[y] for x, y in pairs])
    untied = float(np.sqrt((a != 0).sum() * (b != 0).sum()))
    return float((a * b).sum()) / untied if untied else float("nan")


def _place(one: Attacked) -> str:
    """The place that the names of edges and junctions begin with; empty off the network."""
    spot = one.began if one.began.edge or one.began.junction else one.decided
    found = re.match(r"[a-z]+\d+", spot.edge or spot.junction)
    return found[0] if found else ""


def ranked_by_conflicts(folders: Iterable[Path]) -> list[tuple[str, int, float, float]]:
    """Place, conflicts, how many more than its kind's median, and rank; the worst first."""
    counts = dict.fromkeys(PLACES, 0)
    for folder in folders:
        with (folder / "conflicts.csv").open(newline="", encoding="utf-8") as table:
            for row in csv.DictReader(table):
                found = re.match(r"[a-z]+\d+", row["place"])
                if found and found[0] in counts:
                    counts[found[0]] += 1
    kinds = {
        kind: float(np.median([counts[f"{kind}{number}"] for number in range(10)]))
        for kind in KINDS
    }
    more = {name: counts[name] - kinds[name.rstrip("0123456789")] for name in PLACES}
    rank = ranks(more)
    order = sorted(PLACES, key=lambda name: (rank[name], name))
    return [(name, counts[name], more[name], rank[name]) for name in order]


def _print(table: Sequence[Place], flawed: Sequence[str]) -> None:
    print("place     rank  attacks  hits  criticality  of its kind  excess  drawn (90 % interval)")
    for place in table:
        risk = place.risk
        marks = ("  *" if risk.stands_out else "") + ("  <- flawed" * (place.name in flawed))
        print(
            f"{place.name:9} {place.rank:4.1f}  {place.attacks:7}  {place.hits:4}"
            f"  {risk.mean:11.2f}  {risk.typical:11.2f}  {risk.excess:+.3f}"
            f"  {risk.shrunk:.3f} ({risk.low:.3f} to {risk.high:.3f}){marks}"
        )
    found = ", ".join(f"{place.rank:g}" for place in table if place.name in flawed)
    print(f"* surely above the typical place of its kind. Ranks of the flawed places: {found}")


def main() -> int:
    """Print the ranking of all folders together, and what each pair of them agrees on."""
    parser = argparse.ArgumentParser(description="Rank the forty places by their criticality.")
    parser.add_argument("folders", metavar="OUT", nargs="+", type=Path)
    parser.add_argument("--flawed", nargs="*", default=FLAWED, metavar="PLACE", choices=PLACES)
    parser.add_argument("--conflicts", action="store_true", help="OUT is of deepmf-sumo conflicts")
    given = parser.parse_args()
    if given.conflicts:
        print("place     rank  conflicts  more than the median of its kind")
        for name, count, more, rank in ranked_by_conflicts(given.folders):
            flawed = "  <- flawed" * (name in given.flawed)
            print(f"{name:9} {rank:4.1f}  {count:9}  {more:+.1f}{flawed}")
        return 0
    try:
        seeds = [[one for net in read([out]) for one in net.attacks] for out in given.folders]
    except DeepmfError as error:
        print(error, file=sys.stderr)
        return 2
    old = sum(one.criticality is None for attacks in seeds for one in attacks)
    if old:
        print(
            f"{old} attacks without a measured time to spare; repeat the attacks.", file=sys.stderr
        )
        return 2
    _print(ranked(itertools.chain(*seeds)), given.flawed)
    each = [ranked(attacks) for attacks in seeds]
    for out, table in zip(given.folders, each, strict=True):
        first = [f"{one.name}{'*' * one.risk.stands_out}" for one in table[:5]]
        print(f"{out}: first {', '.join(first)}")
    pairs = list(itertools.combinations(each, 2))
    if pairs:
        same = [agreement(*map(_ranks, two)) for two in pairs]
        whole = [agreement(*map(_excesses, two)) for two in pairs]
        print(
            f"Kendall's tau-b of {len(pairs)} pairs of folders: ranks {np.mean(same):.2f} in the"
            f" mean, {np.min(same):.2f} at least; all excesses, of places that cannot be told from"
            f" the typical one as well, {np.mean(whole):.2f} in the mean"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
