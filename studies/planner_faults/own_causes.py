"""Whether the first cause that is named for a faulty copy of the planner is its fault's own.

What counts is in `accepted_causes.yaml`, which was written before any cause was computed.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from deepmf_sumo.report import failures as words
from deepmf_sumo.results.failures import Failure, failures
from deepmf_sumo.results.groups import grouped
from deepmf_sumo.results.reader import Results

ACCEPTED: Final = Path(__file__).with_name("accepted_causes.yaml")
Alternative = Mapping[str, Sequence[Any]]


class First(NamedTuple):
    """The first cause of a result folder: its sentence, and whether it is the fault's own."""

    sentence: str
    own: bool


def accepted() -> dict[str, list[Alternative]]:
    """The alternatives of each fault, with the lists that they name in place of the names."""
    said: dict[str, Any] = yaml.safe_load(ACCEPTED.read_text("utf-8"))
    faults = said.pop("faults")
    return {
        fault: [
            {key: said[value] if isinstance(value, str) else value for key, value in one.items()}
            for one in alternatives
        ]
        for fault, alternatives in faults.items()
    }


def facts(failure: Failure) -> dict[str, Any]:
    """What alternatives ask for."""
    changes = (failure.run.result.get("cause") or {}).get("changes", {})
    return {
        "change": failure.change,
        "conflict": failure.conflict,
        "side": failure.side,
        "opponent": failure.opponent,
        "stood": failure.stood,
        "over": "keeps to the limit" in changes,
    }


def own(fault: str, known: Mapping[str, Any]) -> bool:
    """Whether a cause with these facts is the fault's own."""
    return any(
        all(known[key] in values for key, values in one.items()) for one in accepted()[fault]
    )


def first_cause(fault: str, folder: Path) -> First | None:
    """The first cause that page and `show --failures` name; None if there is no finding."""
    results = Results.open(folder)
    found = [one for _, one, _ in failures(results) if one is not None]
    groups = [group for group in grouped(found, len(results.runs)) if group.example.change]
    if not groups:
        return None
    return First(words.sentence(groups[0]), own(fault, facts(groups[0].example)))
