"""``session.json`` of a live session: for how long no attack could begin, since it was turned off.

Without attacks an AV looks good. Whoever judges the results has to be told.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import stored

FILE: Final = "session.json"
_AGAIN: Final = "remove it, and the session is not known any more"


def switched_off(out: Path) -> tuple[str, ...]:
    """A sentence for each time in which new attacks were off in the session of a result folder.

    None where there was no session. Raises UsageError where ``session.json`` is damaged.
    """
    file = out / FILE
    if not file.is_file():
        return ()
    values = stored.mapping(file, again=_AGAIN)
    try:
        return sentences(values.get("switches", ()))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise UsageError(f"{file} is damaged: its switches cannot be read; {_AGAIN}.") from None


def notes(folders: Iterable[Path]) -> Iterator[str]:
    """The sentences of result folders, or of those that they contain, each with its folder.

    Raises UsageError as `switched_off`, or where there is no result folder.
    """
    for folder in folders:
        single = (folder / stored.RUNS).is_file()
        for out in [folder] if single else stored.result_folders(folder):
            yield from (f"{out}: {one}" for one in switched_off(out))


def sentences(switches: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """``new attacks on 'ego' were off from 2.0 s to the end (HTTP)``, in the order of times."""
    off: dict[tuple[int, str], Mapping[str, Any]] = {}
    found: dict[int, str] = {}
    changes = list(switches)
    for place, one in enumerate(changes):
        key = int(one["simulation"]), str(one["av"])
        if one["new_attacks"] == "off":
            off.setdefault(key, {**one, "place": place})
        elif before := off.pop(key, None):
            until = f"{float(one['time_s']):.1f} s"
            found[before["place"]] = _sentence(before, until, str(one["door"]))
    for before in off.values():
        found[before["place"]] = _sentence(before, "the end", "")
    return tuple(found[place] for place in sorted(found))


def _sentence(begin: Mapping[str, Any], until: str, by: str) -> str:
    number = int(begin["simulation"])
    of = f" of simulation {number}" * (number > 1)
    door = str(begin["door"])
    doors = door if by in {"", door} else f"{door}, {by}"
    since = f"{float(begin['time_s']):.1f} s"
    return f"new attacks on '{begin['av']}' were off from {since} to {until}{of} ({doors})"
