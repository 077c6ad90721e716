"""Two results side by side: two designs of a network, or two planners, attacked alike.

Runs of one moment (vehicle and time, or recorded scene) and seed are pairs, whatever network,
spec or planner they belong to. Intervals are those of `results.matching`: without
enough pairs the means of moments, or all runs without pairs, are compared.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import pandas as pd

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import run_sets, sessions
from deepmf_sumo.results.changes import QuantityChange, change, leaning
from deepmf_sumo.results.quantities import COMPARABLE, no_quantity
from deepmf_sumo.results.reader import MISSING, Run, judged_before, without_ladder
from deepmf_sumo.results.risk.attacks import net_digest
from deepmf_sumo.results.risk.origins import HitOrigin, origins, tagged
from deepmf_sumo.results.run_sets import RunSet
from deepmf_sumo.results.setups import WHOM, differing
from deepmf_sumo.results.statistics import CONFIDENCE
from deepmf_sumo.results.stored import inputs_of, result_folders
from deepmf_sumo.scene import DT_S

Sides = tuple[Sequence[Run], Sequence[Run]]
"""Successful runs of A and of B."""


def _check(sides: Sides, names: Sequence[Path]) -> None:
    """Raise UsageError where the attacks of the sides did not have the same time.

    A longer attack hits more often, whatever is attacked.
    """
    lasting = [_durations_s(side) for side in sides]
    if all(lasting) and lasting[0] != lasting[1]:
        old, new = (" and ".join(f"{one:g}" for one in sorted(side)) for side in lasting)
        raise UsageError(
            f"The attacks of {names[0]} may last {old} s and those of {names[1]} {new} s, so their"
            " hits cannot be compared; attack one of them again with the other's duration_s."
        )


def _unlike(
    sides: Sides, *, planners_differ: bool, networks_differ: bool, on_purpose: bool
) -> Iterator[str]:
    """Sentences on what is not the same.

    Args:
        sides: A and B.
        planners_differ: in name or settings.
        networks_differ: in name.
        on_purpose: that a network is not the same needs no sentence.
    """
    old, new = (_networks(side) for side in sides)
    changed = sorted(name for name in old.keys() & new.keys() if old[name] != new[name])
    for name in [] if on_purpose else changed:
        yield (
            f"the network {name} is not the same in A and B in spite of one name: a difference"
            " may be the network's"
        )
    found = [run for side in sides for run in side if run.network]
    yield from filter(None, (judged_before(found), without_ladder(found)))
    if planners_differ and (networks_differ or changed):
        yield (
            "planner and network are both different: a difference may be of either; compare sides"
            " that have one of them in common"
        )


def _traffic_notes(sides: Iterable[RunSet], but: Collection[str]) -> Iterator[str]:
    """A sentence where files of the traffic, ``but`` some, are not the same under one name."""
    old, new = (_traffic(result_folders(side.source)) for side in sides)
    same_names = (old.keys() & new.keys()) - set(but)
    changed = sorted(name for name in same_names if old[name] != new[name])
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


def _durations_s(side: Iterable[Run]) -> set[float]:
    """The longest durations of the attacks."""
    steps = {run.result["duration_steps"] for run in side if run.attacked}
    return {round(one * DT_S, 1) for one in steps}


def _networks(side: Iterable[Run]) -> dict[str, set[str]]:
    """Digests of the networks by name; one run of each folder represents the others in it."""
    first: dict[tuple[Path, str], Path] = {}
    for run in side:
        if run.network:
            first.setdefault((run.folder.parents[1], run.network), run.folder)
    found: dict[str, set[str]] = {}
    for (_, name), folder in first.items():
        found.setdefault(name, set()).add(net_digest(folder))
    return found


COMPARED: Final = (
    "av_collision_rate", "collision_rate", "impact_mps", "criticality", "ttc_s", "min_gap_m",
    "required_braking_mps2",
)  # fmt: skip
_IDENTITY: Final = {
    "spec": "spec", "network": "network", "method": "method", "planner": "planner_label",
}  # fmt: skip
"""What may differ on purpose between the runs of the two sides, and its columns."""
Differs = dict[str, tuple[tuple[str, ...], tuple[str, ...]]]
"""Name of what is not the same on both sides -> values of A, values of B."""


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
    differences: list[QuantityChange]
    origins: list[HitOrigin]
    notes: list[str]


def compare(
    a: Path,
    b: Path,
    names: Sequence[str] = COMPARED,
    confidence: float = CONFIDENCE,
    *,
    changed_on_purpose: Collection[str] = (),
) -> Compared:
    """Compare two result folders, or two folders that hold result folders.

    Args:
        a: what was.
        b: what is.
        names: of quantities, of `quantities.COMPARABLE`.
        confidence: of all intervals of a table together.
        changed_on_purpose: names of files of the network that differ because they are compared.

    Raises UsageError for a folder or a quantity that cannot be used, and where the sides were made
    by different versions of the program, or their attacks had different times.
    """
    names = tuple(dict.fromkeys(names))  # else each would widen the intervals of all
    unknown = [name for name in names if name not in COMPARABLE]
    if unknown:
        raise UsageError(f"{no_quantity(unknown[0])}.")
    old, new = _side(a), _side(b)
    if old.version != new.version:
        raise UsageError(
            f"{a} was made by version {old.version} of deepmf-sumo and {b} by {new.version}: their"
            " attacks differ; repeat both with one version."
        )
    went = _went(old), _went(new)
    _check(went, (a, b))
    differs, settings = _differs(old.runs, new.runs), _settings(*went)
    unlike = _unlike(
        went,
        planners_differ="planner" in differs or bool(settings),
        networks_differ="network" in differs,
        on_purpose=bool(changed_on_purpose),
    )
    old, new = (_alike(side, set(differs)) for side in (old, new))
    pairs = len(_moments(old) & _moments(new))
    return Compared(
        runs=(int(old.runs["judged"].sum()), int(new.runs["judged"].sum())),
        pairs=pairs,
        differs=differs | settings,
        differences=differences(old, new, names, confidence),
        origins=origins(tagged(old), tagged(new), confidence),
        notes=[
            *sessions.notes(one.source for one in (old, new)),
            *unlike,
            *_traffic_notes((old, new), changed_on_purpose),
            *_notes(old, new, pairs),
        ],
    )


def _went(side: RunSet) -> list[Run]:
    return [run for run in side.each if run.status == "ok"]


def differences(
    old: RunSet, new: RunSet, names: Sequence[str], confidence: float
) -> list[QuantityChange]:
    """Of each quantity the means, and for numbers in how many pairs each side is the worse one.

    Args:
        old: runs with the ids of `compare`: those of pairs are equal.
        new: the same.
        names: of `quantities.COMPARABLE`.
        confidence: of all intervals together.
    """
    numbers = [name for name in names if not COMPARABLE[name].rate]
    alone = 1 - (1 - confidence) / (len(names) + len(numbers))
    found = [change(COMPARABLE[name], new.runs, old.runs, alone) for name in names]
    return found + [leaning(COMPARABLE[name], new.runs, old.runs, alone) for name in numbers]


def _side(folder: Path) -> RunSet:
    """All runs of the result folders of one side."""
    sets = [run_sets.read(out) for out in result_folders(folder)]
    versions = {one.version for one in sets}
    if len(versions) > 1:
        named = " and ".join(sorted(versions))
        raise UsageError(f"{folder} holds results of versions {named}: compare one at a time.")
    return RunSet(
        source=folder,
        version=versions.pop(),
        runs=pd.concat([one.runs for one in sets], ignore_index=True),
        attacks={digest: setup for one in sets for digest, setup in one.attacks.items()},
        each=tuple(run for one in sets for run in one.each),
    )


def _differs(old: pd.DataFrame, new: pd.DataFrame) -> Differs:
    """What the two sides do not have in common, with the values of each.

    Of a run that is not there yet only the id is known, not its planner or network; of a side
    without any run nothing.
    """
    sides = [side[side["status"] != MISSING] for side in (old, new)]
    values = {
        name: tuple(tuple(sorted(set(side[column]))) for side in sides)
        for name, column in _IDENTITY.items()
    }
    return {name: (was, now) for name, (was, now) in values.items() if was and now and was != now}


def _alike(side: RunSet, differs: set[str]) -> RunSet:
    """Runs whose ids leave out what is meant to be different: those of pairs are equal.

    ``run`` is what they were.
    """
    runs = side.runs
    blank = pd.Series("", index=runs.index, dtype=object)
    kept = {
        column: blank if name in differs else runs[column] for name, column in _IDENTITY.items()
    }
    parts = zip(*kept.values(), runs["scene"], map(str, runs["seed"]), strict=True)
    kept |= {"network": runs["network"], "run": runs["run_id"]}
    return replace(side, runs=runs.assign(**kept, run_id=["--".join(part) for part in parts]))


def _moments(side: RunSet) -> set[str]:
    """Moments and seeds with an attacked vehicle, each once; runs as of `_alike`."""
    return set(side.runs.loc[side.runs["judged"], "run_id"])


def _settings(old: Sequence[Run], new: Sequence[Run]) -> Differs:
    """The settings that both sides' planners have, with other values.

    A planner's own settings say nothing beside a planner that has none of them.
    """
    values = [[run.result["settings"]["planner"] for run in side] for side in (old, new)]
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


def _notes(old: RunSet, new: RunSet, pairs: int) -> Iterable[str]:
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
        if side.runs["run_id"].nunique() < len(side.runs):
            yield f"{name} holds several runs of one moment and seed: their means are compared"
        lost = int((side.runs["status"] != "ok").sum())
        if lost:
            yield f"{lost} runs of {name} failed, timed out or are missing, and are not compared"


def _attacks_differ(old: RunSet, new: RunSet) -> str:
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


def _setups(side: RunSet) -> list[Mapping[str, Any]]:
    """How the runs of a side were attacked, each setup once."""
    return [side.attacks[digest] for digest in sorted(set(side.runs["setup"]) - {""})]
