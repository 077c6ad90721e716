"""Two results side by side: two designs of a network, or two planners, attacked alike.

Runs of one moment (vehicle and time, or recorded scene) and seed are pairs, whatever network,
spec or planner they belong to. Intervals are those of `results.matching`: without
enough pairs the means of moments, or all runs without pairs, are compared.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any, Final, Literal

from deepmf_sumo.datatypes import DT_S
from deepmf_sumo.errors import UsageError
from deepmf_sumo.gate import rows
from deepmf_sumo.gate.rows import Results, Row
from deepmf_sumo.gate.setups import WHOM, differing
from deepmf_sumo.results import sessions
from deepmf_sumo.results.matching import Matched, answer, match
from deepmf_sumo.results.quantities import COMPARABLE, RATE, Quantity, no_quantity, without_ladder
from deepmf_sumo.results.reader import before_note
from deepmf_sumo.results.result import Result
from deepmf_sumo.results.stored import inputs_of, result_folders
from deepmf_sumo.risk import attacks
from deepmf_sumo.risk.attacks import net_digest
from deepmf_sumo.risk.origins import Origin, Tagged, origins, tags

Sides = tuple[Mapping[str, Result], Mapping[str, Result]]
"""Successful results of A and of B, by ``OUT/runs/RUN``."""


def check(sides: Sides, names: Sequence[Path]) -> None:
    """Raise UsageError where the attacks of the sides did not have the same time.

    A longer attack hits more often, whatever is attacked.
    """
    lasting = [_durations_s(side.values()) for side in sides]
    if all(lasting) and lasting[0] != lasting[1]:
        old, new = (" and ".join(f"{one:g}" for one in sorted(side)) for side in lasting)
        raise UsageError(
            f"The attacks of {names[0]} may last {old} s and those of {names[1]} {new} s, so their"
            " hits cannot be compared; attack one of them again with the other's --duration."
        )


def notes(
    sides: Sides, *, planners_differ: bool, networks_differ: bool, changed_on_purpose: bool = False
) -> Iterator[str]:
    """Sentences on what is not the same.

    Args:
        sides: A and B.
        planners_differ: in name or settings.
        networks_differ: in name.
        changed_on_purpose: that a network is not the same needs no sentence.
    """
    old, new = (_networks(side) for side in sides)
    changed = sorted(name for name in old.keys() & new.keys() if old[name] != new[name])
    for name in [] if changed_on_purpose else changed:
        yield (
            f"the network {name} is not the same in A and B in spite of one name: a difference"
            " may be the network's"
        )
    found = [one for side in sides for one in side.values() if one["network"] is not None]
    before = [one for one in found if one["opponent"] and one.get("counterfactual") is None]
    yield from filter(None, (before_note(len(before), len(found)), without_ladder(found)))
    if planners_differ and (networks_differ or changed):
        yield (
            "planner and network are both different: a difference may be of either; compare sides"
            " that have one of them in common"
        )


def traffic_notes(a: Sequence[Path], b: Sequence[Path]) -> Iterator[str]:
    """A sentence where files of the traffic are not the same under one name."""
    old, new = (_traffic(side) for side in (a, b))
    changed = sorted(name for name in old.keys() & new.keys() if old[name] != new[name])
    if changed:
        yield (
            f"{', '.join(changed)}: not the same in A and B in spite of one name: a difference"
            " may be the traffic's"
        )


def _traffic(folders: Iterable[Path]) -> dict[str, set[str]]:
    """Digests of route and other traffic files, by name; none for live sessions."""
    found: dict[str, set[str]] = {}
    for folder in folders:
        for path, digest in inputs_of(folder).items():
            name = Path(path).name
            if name.endswith((".xml", ".xml.gz")) and ".net." not in name:
                found.setdefault(name, set()).add(digest)
    return found


def _durations_s(side: Iterable[Result]) -> set[float]:
    """The longest durations of the attacks."""
    steps = {one["duration_steps"] for one in side if one["opponent"]}
    return {round(one * DT_S, 1) for one in steps}


def _networks(side: Mapping[str, Result]) -> dict[str, set[str]]:
    """Digests of the networks by name; one run of each folder represents the others in it."""
    first: dict[tuple[Path, str], Path] = {}
    for key, result in side.items():
        if result["network"]:
            run = Path(key)
            first.setdefault((run.parents[1], result["network"]), run)
    found: dict[str, set[str]] = {}
    for (_, name), run in first.items():
        found.setdefault(name, set()).add(net_digest(run))
    return found


COMPARED: Final = (
    "av_collision_rate", "collision_rate", "impact_mps", "criticality", "ttc_s", "min_gap_m",
    "required_braking_mps2",
)  # fmt: skip
CONFIDENCE: Final = 0.95
_IDENTITY: Final = ("spec", "network", "method", "planner")
"""What may differ on purpose between the runs of the two sides."""
Differs = dict[str, tuple[tuple[str, ...], tuple[str, ...]]]
"""Name of what is not the same on both sides -> values of A, values of B."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One quantity of all runs, A and B.

    Attributes:
        found: the difference, B minus A, and what it is of.
        state: ``within margin`` where the whole interval lies within ``margin`` of zero.
        needed: about how many moments would decide, where these do not.
    """

    quantity: str
    unit: str
    found: Matched
    state: Literal["worse", "better", "within margin", "cannot tell"]
    margin: float
    needed: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """What is different in B, and where it comes from.

    Attributes:
        runs: of A and of B. pairs: moments and seeds that both have.
        differs: e.g. ``planner``, ``network``, ``planner.headway_s``.
        differences: B (new) against A (old), one row per quantity; all intervals hold together.
        origins: shares of runs that end in a hit of each kind and at each place.
        notes: what a reader should know before trusting it, as sentences.
    """

    runs: tuple[int, int]
    pairs: int
    differs: Differs
    differences: list[Change]
    origins: list[Origin]
    notes: list[str]


def compare(
    a: Path,
    b: Path,
    quantities: Sequence[str] = COMPARED,
    confidence: float = CONFIDENCE,
    *,
    changed_on_purpose: bool = False,
) -> Compared:
    """Compare two result folders, or two folders that hold result folders.

    Args:
        a: what was.
        b: what is.
        quantities: of `quantities.COMPARABLE`.
        confidence: of all intervals of a table together.
        changed_on_purpose: see `notes`.

    Raises UsageError for a folder or a quantity that cannot be used, and where the sides were made
    by different versions of the program, or their attacks had different times.
    """
    unknown = [name for name in quantities if name not in COMPARABLE]
    if unknown:
        raise UsageError(f"{no_quantity(unknown[0])}.")
    old, new = _side(a), _side(b)
    if old.version != new.version:
        raise UsageError(
            f"{a} was made by version {old.version} of deepmf-sumo and {b} by {new.version}: their"
            " attacks differ; repeat both with one version."
        )
    folders = [result_folders(side.source) for side in (old, new)]
    of_a, of_b = map(attacks.of_runs, folders)
    check((of_a, of_b), (a, b))
    differs = _differs(old.rows, new.rows)
    settings = _settings(of_a, of_b)
    unlike = notes(
        (of_a, of_b),
        planners_differ="planner" in differs or bool(settings),
        networks_differ="network" in differs,
        changed_on_purpose=changed_on_purpose,
    )
    old, new = (_alike(side, set(differs)) for side in (old, new))
    pairs = len(_moments(old) & _moments(new))
    tagged = _tagged(old, of_a), _tagged(new, of_b)
    return Compared(
        runs=(_judged(old), _judged(new)),
        pairs=pairs,
        differs=differs | settings,
        differences=differences(old, new, quantities, confidence),
        origins=origins(tagged[0], tagged[1], confidence),
        notes=[
            *sessions.notes(one.source for one in (old, new)),
            *unlike,
            *traffic_notes(*folders),
            *_notes(old, new, pairs),
        ],
    )


def differences(
    old: Results, new: Results, quantities: Sequence[str], confidence: float
) -> list[Change]:
    """Of each quantity the means, and for numbers in how many pairs each side is the worse one.

    A few runs with large differences hide many small ones in a mean, but not in that count.

    Args:
        old: rows with the ids of `compare`: those of pairs are equal.
        new: the same.
        quantities: of `quantities.COMPARABLE`.
        confidence: of all intervals together.
    """
    numbers = [name for name in quantities if not COMPARABLE[name].rate]
    alone = 1 - (1 - confidence) / (len(quantities) + len(numbers))
    sides = list(new.rows.values()), list(old.rows.values())
    found = [
        _change(one, one.name, match(one.name, *sides, alone, one.largest))
        for one in map(COMPARABLE.__getitem__, quantities)
    ]
    return found + [_leaning(COMPARABLE[name], old, new, alone) for name in numbers]


def _change(quantity: Quantity, name: str, found: Matched, *, share: bool = False) -> Change:
    """A share of pairs is worse the higher it is, and no difference of it is negligible."""
    within = RATE if share else quantity.margin
    state, needed = answer(found, 0.0 if share else quantity.negligible, within)
    worse = "more" if share or quantity.worse == "higher" else "less"
    judged: Literal["worse", "better", "within margin", "cannot tell"]
    if state in {"more", "less"}:
        judged = "worse" if state == worse else "better"
    else:
        judged = "within margin" if state == "within margin" else "cannot tell"
    return Change(
        quantity=name,
        unit="1" if share else quantity.unit,
        found=found,
        state=judged,
        margin=within,
        needed=needed,
    )


def _leaning(quantity: Quantity, old: Results, new: Results, confidence: float) -> Change:
    """The shares of pairs in which one side is worse by more than is negligible."""
    sign = 1.0 if quantity.worse == "higher" else -1.0
    name, before = quantity.name, _means(old, quantity.name)
    rows_by_id = {row.run_id: row for row in new.rows.values()}
    marked: tuple[list[Row], list[Row]] = ([], [])
    for run_id, value in _means(new, name).items():
        if run_id in before:
            worse = sign * (value - before[run_id])
            for side, each in zip(marked, (-worse, worse), strict=True):
                values = {name: float(each > quantity.negligible)}
                side.append(replace(rows_by_id[run_id], values=values))
    found = match(name, marked[1], marked[0], confidence, largest=1.0)
    return _change(quantity, f"pairs with worse {name}", found, share=True)


def _means(side: Results, name: str) -> dict[str, float]:
    """The value of each moment and seed that has one."""
    values: dict[str, list[float]] = {}
    for row in side.rows.values():
        if name in row.values:
            values.setdefault(row.run_id, []).append(row.values[name])
    return {run_id: fmean(found) for run_id, found in values.items()}


def _side(folder: Path) -> Results:
    """All runs of the result folders of one side; keys tell their folder."""
    found: dict[str, Row] = {}
    versions = set()
    setups: dict[str, Mapping[str, Any]] = {}
    for out in result_folders(folder):
        results = rows.read(out)
        versions.add(results.version)
        setups |= results.attacks
        found |= {f"{out}/runs/{run_id}": row for run_id, row in results.rows.items()}
    if len(versions) > 1:
        named = " and ".join(sorted(versions))
        raise UsageError(f"{folder} holds results of versions {named}: compare one at a time.")
    return Results(source=folder, version=versions.pop(), rows=found, attacks=setups)


def _differs(old: Mapping[str, Row], new: Mapping[str, Row]) -> Differs:
    """What the two sides do not have in common, with the values of each.

    Of a run that is not there yet only the id is known, not its planner or network.
    """
    sides = [[row for row in side.values() if row.status != "missing"] for side in (old, new)]
    values = {
        name: tuple(tuple(sorted({str(getattr(row, name)) for row in side})) for side in sides)
        for name in _IDENTITY
    }
    return {name: (was, now) for name, (was, now) in values.items() if was != now}


def _alike(side: Results, differs: set[str]) -> Results:
    """Rows whose ids leave out what is meant to be different: those of pairs are equal."""
    found = {}
    for key, row in side.rows.items():
        kept = {name: "" if name in differs else str(getattr(row, name)) for name in _IDENTITY}
        name = "--".join((*kept.values(), row.scene, str(row.seed)))
        found[key] = replace(
            row, run_id=name, spec=kept["spec"], method=kept["method"], planner=kept["planner"]
        )
    return replace(side, rows=found)


def _moments(side: Results) -> set[str]:
    """Moments and seeds with an attacked vehicle, each once; rows as of `_alike`."""
    return {row.run_id for row in side.rows.values() if row.judged}


def _judged(side: Results) -> int:
    return sum(row.judged for row in side.rows.values())


def _settings(old: Mapping[str, Result], new: Mapping[str, Result]) -> Differs:
    """The settings that both sides' planners have, with other values.

    A planner's own settings say nothing beside a planner that has none of them.
    """
    values = [[one["settings"]["planner"] for one in side.values()] for side in (old, new)]
    known = [{name for settings in side for name in settings} for side in values]
    names = sorted(known[0] & known[1])
    found = {
        f"planner.{name}": tuple(
            tuple(sorted({_text(settings[name]) for settings in side if name in settings}))
            for side in values
        )
        for name in names
    }
    return {name: (was, now) for name, (was, now) in found.items() if was != now}


def _text(value: Any) -> str:
    """A setting's value as text."""
    return "not set" if value is None else str(value)


def _tagged(side: Results, results: Mapping[str, Result]) -> list[Tagged]:
    """The attacked runs with where and how each hit was."""
    known = tags(results, result_folders(side.source))
    return [
        Tagged(row=row, tags=known.get(key, {}))
        for key, row in side.rows.items()
        if "collision_rate" in row.values
    ]


def _notes(old: Results, new: Results, pairs: int) -> Iterable[str]:
    fewer = min(len(_moments(side)) for side in (old, new))
    if pairs < fewer:
        yield (
            f"{fewer - pairs} of {fewer} runs have no partner: moments that both sides were"
            " attacked at are compared in pairs as far as they suffice"
        )
    unlike = _attacks_differ(old, new)
    if unlike:
        yield f"the attack is set up differently ({unlike}): differences may be the attack's"
    for name, side in (("A", old), ("B", new)):
        if len({row.run_id for row in side.rows.values()}) < len(side.rows):
            yield f"{name} holds several runs of one moment and seed: their means are compared"
        lost = sum(row.status != "ok" for row in side.rows.values())
        if lost:
            yield f"{lost} runs of {name} failed, timed out or are missing, and are not compared"


def _attacks_differ(old: Results, new: Results) -> str:
    """The settings of the attack that are not the same on both sides, with their values.

    Which vehicle an attack aims at belongs to the moment where it changes from run to run, as
    with ``adversary.opponent=met``, and not of the setup.
    """
    setups = [_setups(side) for side in (old, new)]
    if not all(setups):
        return ""
    names = set().union(*(differing(a, b) for a in setups[0] for b in setups[1]))
    sentences = []
    for name in sorted(names):
        values = [sorted({_text(one.get(name)) for one in side}) for side in setups]
        if values[0] == values[1] or (name == WHOM and max(map(len, values)) > 1):
            continue
        sentences.append(f"{name}: {', '.join(values[0])} in A, {', '.join(values[1])} in B")
    return "; ".join(sentences)


def _setups(side: Results) -> list[Mapping[str, Any]]:
    """How the runs of a side were attacked, each setup once."""
    used = {row.attack for row in side.rows.values() if row.attack}
    return [side.attacks[digest] for digest in sorted(used)]
