"""Flaws planted on real networks: ``python studies/hazards/real.py FOLDER CONFIG...``.

For each configuration, flaw and seed `plant.py` plants one flaw. The flawed network is attacked at
``--moments`` moments with the settings of `study.py`; nothing tells the attack where the flaw is.
The sound network is attacked at the same moments. Results are in FOLDER/NAME/FLAW-SEED, and
existing ones are kept. Then a table: the place's rank by criticality as the risk map gives it
(``rank_criticality``, attacks that began there) among the attacked junctions, and the best rank of
its movements and approaches among all movements and edges; the same in the sound network; and what
`deepmf-sumo compare` says, from flawed to sound, of the runs that began at the place. Places that
cannot be told from the typical one share the mean of their ranks.

Beside that, the rank that `deepmf-sumo screen` gives the junction: by its worst finding, among all
junctions with movements; those without a finding share the last rank. ``--no-attacks`` leaves it at
that, which takes seconds. FOLDER/table.md and FOLDER/table.json have all rows.
"""

# ruff: noqa: INP001, T201 - a script beside data, not a package

import argparse
import itertools
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from flaws import FLAWS
from plant import LEAST, plant
from study import WISHES

from deepmf_sumo import files
from deepmf_sumo.errors import DeepmfError, UsageError
from deepmf_sumo.results import run_sets
from deepmf_sumo.results.changes import QuantityChange
from deepmf_sumo.results.risk import attacks, table
from deepmf_sumo.results.risk.two_sides import COMPARED, CONFIDENCE, differences
from deepmf_sumo.roadcheck.screening import GUIDELINES, screen
from deepmf_sumo.roadcheck.screening.findings import RULES, SEVERITIES, Finding

FIRST: Final = 0.05
"""Share of the places among which the flawed one should be."""
DURATION_S: Final = 10
COLUMNS: Final = {
    "network": "network", "flaw": "flaw", "seed": "seed", "junction": "place",
    "attacks": "attacks there, of all", "rank": "junction's rank",
    "sound": "in the sound network", "site": "best movement or approach",
    "site_sound": "in the sound network", "compared": "compare, at the place",
    "screen": "by screen", "screen_sound": "in the sound network",
}  # fmt: skip


def attack(config: Path, out: Path, place: dict[str, Any], more: Sequence[str]) -> int:
    """Attack a network, or go on with it; returns the exit code."""
    wishes = [
        part for key, value in WISHES.items() for part in ("--set", f"adversary.{key}={value}")
    ]
    command = [
        *(sys.executable, "-m", "deepmf_sumo.cli.main", "attack", config, "--out", out),
        *("--seed", place["seed"], "--set", f"duration_s={DURATION_S}", "--set", "opponents=one"),
        *("--until", f"{place['until_s']:g}", "--no-pictures", "--resume", *wishes, *more),
    ]
    return subprocess.run(list(map(str, command)), check=False).returncode


def row(folder: Path, place: dict[str, Any], *, attacked: bool) -> dict[str, Any]:
    """What is found in a case. Raises UsageError where nothing was attacked, or in a network."""
    sides = {
        name: _screened(folder / name / place["configuration"], place["junction"])
        for name in ("flawed", "sound")
    }
    changes: list[QuantityChange] = []
    if attacked:
        for name, side in sides.items():
            side.update(_ranks(folder / f"{name}-attacks", place))
        changes = _compared(folder, sides["flawed"]["runs"])
    return {
        "network": folder.parent.name,
        **{key: place[key] for key in ("flaw", "seed", "junction")},
        **{f"{name}_{key}": value for name, side in sides.items() for key, value in side.items()},
        "changes": [
            {
                "quantity": one.quantity, "state": one.state, "needed": one.needed,
                "difference": one.found.difference,
            }
            for one in changes
        ],
    }  # fmt: skip


def _screened(config: Path, junction: str) -> dict[str, Any]:
    """The junction's rank among all with movements, by their worst findings."""
    found = screen(config, GUIDELINES["rilsa"])
    worst = dict.fromkeys(found.roads.ways, 0.0)
    order = sorted({_severity(one) for one in found.findings}, reverse=True)
    for one in found.findings:
        place = one.worst.junction
        worst[place] = max(worst.get(place, 0.0), 1.0 + order.index(_severity(one)))
    own = [one.sentence for one in found.findings if one.worst.junction == junction]
    return {
        "screen": table.ranks(worst).get(junction) if own else None,
        "screen_places": len(worst),
        "screen_findings": own,
    }


def _severity(one: Finding) -> tuple[int, int, float]:
    """As the command orders them, the worst first."""
    off = abs(one.worst.measured - one.worst.required)
    return SEVERITIES.index(one.severity), RULES.index(one.worst.rule), -round(off, 6)


def _ranks(out: Path, place: dict[str, Any]) -> dict[str, Any]:
    """Ranks of the flawed place among those attacked; None where it was not attacked."""
    (network,) = attacks.read([out])
    every = [one for one in table.rows(network) if one.counted == "began"]
    nodes = [one for one in every if one.kind == "junction"]
    sites = [one for one in every if one.kind in table.SITES]
    mine = next((one for one in nodes if one.place == place["junction"]), None)
    worse = table.ranks({f"{one.kind} {one.place}": _surely(one) for one in sites})
    own = [f"{one.kind} {one.place}" for one in sites if _at(network, one, place["junction"])]
    return {
        "runs": sorted(
            {one.run_id for one in network.attacks if one.began.junction == place["junction"]}
        ),
        "attacks": len(network.attacks),
        "hits": sum(one.hit for one in network.attacks if one.began.junction == place["junction"]),
        "rank": mine and mine.rank_criticality,
        "junctions": len(nodes),
        "criticality": mine and mine.criticality and mine.criticality.mean,
        "typical": mine and mine.criticality and mine.criticality.typical,
        "site": min((worse[one] for one in own), default=None),
        "sites": len(sites),
    }


def _surely(one: table.PlaceRow) -> float:
    return one.criticality.surely if one.criticality else 0.0


def _at(network: attacks.Network, one: table.PlaceRow, junction: str) -> bool:
    """Whether a movement is over the junction, or an edge leads to it."""
    if one.kind == "movement":
        return network.places.movements[one.place].junction == junction
    return network.places.net.edges[one.place].end == junction


def _compared(folder: Path, runs: Sequence[str]) -> list[QuantityChange]:
    """As `deepmf-sumo compare` does, of these runs alone: one name, one id on both sides."""
    sides = []
    for name in ("flawed", "sound"):
        found = run_sets.read(folder / f"{name}-attacks")
        sides.append(replace(found, runs=found.runs[found.runs["run_id"].isin(runs)]))
    return differences(sides[0], sides[1], COMPARED, CONFIDENCE) if runs else []


def said(changes: Sequence[dict[str, Any]]) -> str:
    """The verdict in a few words: what is better or worse, else how many attacks would tell."""
    states = [
        f"{state}: {', '.join(one['quantity'] for one in changes if one['state'] == state)}"
        for state in ("better", "worse")
        if any(one["state"] == state for one in changes)
    ]
    needed = [one["needed"] for one in changes if one["state"] == "cannot tell" and one["needed"]]
    if states:
        return "; ".join(states)
    return f"cannot tell; about {min(needed)} would" if needed else "cannot tell"


def cells(one: dict[str, Any]) -> dict[str, str]:
    """A row in words."""
    words = {
        **{key: str(one[key]) for key in ("network", "flaw", "seed", "junction")},
        "screen": _of(one["flawed_screen"], one["flawed_screen_places"], "no finding"),
        "screen_sound": _of(one["sound_screen"], one["sound_screen_places"], "no finding"),
    }
    if "flawed_runs" not in one:
        return {**dict.fromkeys(COLUMNS, "-"), **words}
    return {
        **words,
        "attacks": f"{len(one['flawed_runs'])} of {one['flawed_attacks']}",
        "rank": _of(one["flawed_rank"], one["flawed_junctions"]),
        "sound": _of(one["sound_rank"], one["sound_junctions"]),
        "site": _of(one["flawed_site"], one["flawed_sites"]),
        "site_sound": _of(one["sound_site"], one["sound_sites"]),
        "compared": said(one["changes"]),
    }


def _of(rank: float | None, places: int, without: str = "not attacked") -> str:
    return f"{rank:g} of {places}" if rank is not None else f"{without}, {places} others"


def report(folder: Path, found: Sequence[dict[str, Any]], lost: Sequence[str]) -> str:
    """Table and sums as Markdown, also written to the folder. Raises OutputError."""
    lines = [f"| {' | '.join(COLUMNS.values())} |", f"|{' --- |' * len(COLUMNS)}"]
    lines += [f"| {' | '.join(cells(one)[key] for key in COLUMNS)} |" for one in found]
    lines += ["", *_sums(found), *(f"No case: {sentence}" for sentence in lost)]
    text = "\n".join([*lines, ""])
    files.write(folder / "table.md", text)
    files.write_json(folder / "table.json", list(found))
    return text


def _sums(found: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Two sentences: by attacks, and by the guideline."""
    attacked = [one for one in found if "flawed_runs" in one]
    first = [_first(one["flawed_rank"], one["flawed_junctions"]) for one in attacked]
    sites = [_first(one["flawed_site"], one["flawed_sites"]) for one in attacked]
    alone = [one["flawed_rank"] == 1 for one in attacked]
    better = sum("better" in cells(one)["compared"] for one in attacked)
    if attacked:
        yield (
            f"{len(attacked)} cases: the junction is alone on rank 1 in {sum(alone)}, among the"
            f" first {FIRST:.0%} in {sum(first)}; a movement or approach of it is in {sum(sites)};"
            f" compare says better in {better}."
        )
    by_book = [_first(one["flawed_screen"], one["flawed_screen_places"]) for one in found]
    named = sum(one["flawed_screen"] is not None for one in found)
    yield (
        f"By screen, {len(found)} cases: a finding at the junction in {named}, among the first"
        f" {FIRST:.0%} in {sum(by_book)}."
    )


def _first(rank: float | None, places: int) -> bool:
    """Of fewer than 20 places the first one counts."""
    return rank is not None and rank <= max(1.0, FIRST * places)


def cases(given: argparse.Namespace) -> Iterator[tuple[Path, dict[str, Any] | str]]:
    """Folders of planted flaws, or a sentence where there is no place."""
    for config, flaw, seed in itertools.product(given.configs, given.flaws, given.seeds):
        folder = given.folder / config.stem / f"{flaw}-{seed}"
        try:
            if not (folder / "place.json").is_file():
                window = {"start_s": given.start_s, "until_s": given.until_s}
                plant(config, flaw, seed, folder, least=given.least, **window)
            yield folder, json.loads((folder / "place.json").read_text("utf-8"))
        except UsageError as error:
            yield folder, str(error)


def _attacked(folder: Path, place: dict[str, Any], given: argparse.Namespace) -> int:
    """Attack the flawed network, and the sound one at the same moments; the exit code."""
    config, out = place["configuration"], folder / "flawed-attacks"
    start = [] if given.start_s is None else ["--from", f"{given.start_s:g}"]
    wish = ["--moments", given.moments, "--set", f"source.moments.prefer={given.prefer}", *start]
    return attack(folder / "flawed" / config, out, place, wish) or attack(
        folder / "sound" / config, folder / "sound-attacks", place, ["--moments-of", out]
    )


def main() -> int:
    """Plant, attack, print; ends with the exit code of what did not go through."""
    parser = argparse.ArgumentParser(
        description="Do attacks and guidelines find flaws on real networks?"
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("configs", type=Path, nargs="+", metavar="CONFIG")
    parser.add_argument("--flaws", nargs="+", choices=FLAWS, default=list(FLAWS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--no-attacks", action="store_true", help="screen the networks alone")
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--prefer", default="both", help="`source.moments.prefer` of specs")
    parser.add_argument("--least", type=int, default=LEAST, help="as of plant.py")
    parser.add_argument("--from", type=float, dest="start_s", metavar="S")
    parser.add_argument("--until", type=float, dest="until_s", metavar="S")
    given = parser.parse_args()
    found, lost = [], []
    try:
        for folder, place in cases(given):
            if isinstance(place, str):
                lost.append(place)
                continue
            code = 0 if given.no_attacks else _attacked(folder, place, given)
            if code:
                return code
            try:
                found.append(row(folder, place, attacked=not given.no_attacks))
            except UsageError as error:  # no vehicle was attacked
                lost.append(str(error))
            report(given.folder, found, lost)
        print(report(given.folder, found, lost))
    except DeepmfError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
