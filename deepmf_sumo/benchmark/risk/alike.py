"""What two sides of a comparison must have in common, and what must be said where they do not."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.risk.attacks import net_digest
from deepmf_sumo.benchmark.stored import inputs_of
from deepmf_sumo.datatypes import DT_S
from deepmf_sumo.errors import UsageError

Sides = tuple[Mapping[str, Result], Mapping[str, Result]]
"""Results of A and of B that went through, by ``OUT/runs/RUN``."""


def check(sides: Sides, names: Sequence[Path]) -> None:
    """Raise UsageError where the attacks of the sides did not have the same time.

    A longer attack hits more often, whatever is attacked.
    """
    lasting = [_durations_s(side.values()) for side in sides]
    if all(lasting) and lasting[0] != lasting[1]:
        old, new = (" and ".join(f"{one:g}" for one in sorted(side)) for side in lasting)
        raise UsageError(
            f"The attacks of {names[0]} may last {old} s and those of {names[1]} {new} s, so their"
            " hits cannot be compared; attack one of them anew with the other's --duration."
        )


def notes(sides: Sides, *, planners_differ: bool, networks_differ: bool) -> Iterator[str]:
    """Sentences on what is not the same.

    Args:
        sides: A and B.
        planners_differ: in name or settings.
        networks_differ: in name.
    """
    old, new = (_networks(side) for side in sides)
    changed = sorted(name for name in old.keys() & new.keys() if old[name] != new[name])
    for name in changed:
        yield (
            f"the network {name} is not the same in A and B, though it has one name: a difference"
            " may be the network's"
        )
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
            f"{', '.join(changed)}: not the same in A and B, though of one name: a difference may"
            " be the traffic's"
        )


def _traffic(folders: Iterable[Path]) -> dict[str, set[str]]:
    """Digests of files of routes and the like, by name; of live sessions none are known."""
    found: dict[str, set[str]] = {}
    for folder in folders:
        for path, digest in inputs_of(folder).items():
            name = Path(path).name
            if name.endswith((".xml", ".xml.gz")) and ".net." not in name:
                found.setdefault(name, set()).add(digest)
    return found


def _durations_s(side: Iterable[Result]) -> set[float]:
    """How long attacks could last."""
    steps = {one["duration_steps"] for one in side if one.get("opponent")}
    return {round(one * DT_S, 1) for one in steps}


def _networks(side: Mapping[str, Result]) -> dict[str, set[str]]:
    """Digests of the networks by name; one run of each folder speaks for the others in it."""
    first: dict[tuple[Path, str], Path] = {}
    for key, result in side.items():
        if result.get("network"):
            run = Path(key)
            first.setdefault((run.parents[1], str(result["network"])), run)
    found: dict[str, set[str]] = {}
    for (_, name), run in first.items():
        found.setdefault(name, set()).add(net_digest(run))
    return found


__all__ = ["Sides", "check", "notes", "traffic_notes"]
