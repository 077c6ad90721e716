"""What makes the attack of a run, and where results and a baseline differ in it.

Two planners can be compared where the same attack is tried on both. So all of the run's spec counts
but `MAY_DIFFER`, with all defaults of the adversary, and what is in its files and weights.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

import pandas as pd

from deepmf_sumo.results.result import Result
from deepmf_sumo.spec.profiles import applies_to, described, in_todays_words

if TYPE_CHECKING:
    from deepmf_sumo.results.run_sets import RunSet

MAY_DIFFER: Final = (
    "version",  # of the spec's grammar: what it stands for is in the other keys
    "name",
    "expect",
    "planner",  # what is compared
    "seed",  # pairs of runs are compared, or specs with other seeds
    "source.network",  # a path
    "source.recording",
    "source.scenes",
    "source.start_s",  # the moment: `moment_of`
    "source.av",
)
"""Keys of the spec, each with all below it, in which results and baseline may differ."""

_FOLDERS: Final = re.compile(r"[^=,\s]*/")
WHOM: Final = "adversary.opponent"
"""The setting that holds the id of a vehicle where each moment has an opponent of its own."""

_OURS: Final = "adversary."
_UNRECORDED: Final = "earlier version"
"""The key of a setup of which less is recorded."""


def setup_of(result: Result) -> dict[str, Any]:
    """What makes a run's attack, by dotted name.

    Results of earlier versions, without their spec, have adversary, weights and budget alone.
    """
    spec = result.get("setup")
    if spec is None:
        spec = {"weights": result["weights"], "budget": result.get("budget", {})}
    adversary = {"adversary": result["settings"]["adversary"]}
    found = {
        name: value
        for name, value in _flat({**spec, **adversary})
        if not any(name == one or name.startswith(f"{one}.") for one in MAY_DIFFER)
    }
    found |= {"adversary": result["adversary"]}
    beside = found.get("source.sumo_options")
    if beside is not None:
        found["source.sumo_options"] = [_FOLDERS.sub("", one) for one in beside]
    if not applies_to(result["adversary"]):
        found.pop("profile", None)
    elif result.get("profile"):  # specs of versions 1 and 2 do not say theirs
        found["profile"] = result["profile"]
    if spec.get("version", 3) < 3:
        found.setdefault("opponents", "one")
    inputs = result.get("inputs", {})
    if "weights" in inputs:  # the name of a folder says nothing of what is in it
        found["weights"] = f"files {inputs['weights'][:12]}"
    if "adversary" in inputs:
        found.pop("adversary.file", None)
        found["adversary's files"] = f"files {inputs['adversary'][:12]}"
    if result.get("setup") is None:
        found[_UNRECORDED] = True
    return renewed(found)


def renewed(setup: Mapping[str, Any]) -> dict[str, Any]:
    """A setup that an earlier version recorded, its settings of DeepMF in the words of today."""
    if not applies_to(str(setup.get("adversary"))):
        return dict(setup)
    kept = {name: value for name, value in setup.items() if not name.startswith(_OURS)}
    ours = {name.removeprefix(_OURS): setup[name] for name in setup.keys() - kept.keys()}
    return kept | dict(_flat(in_todays_words(ours), _OURS))


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def moment_of(result: Result) -> str:
    """When and of which vehicle a network is attacked, e.g. ``ego at 40 s``; else empty."""
    source = (result.get("setup") or {}).get("source", {})
    vehicle = source.get("av", {}).get("vehicle")
    return f"{vehicle} at {source.get('start_s', 0):.12g} s" if vehicle else ""


def differences(new: "RunSet", old: "RunSet") -> list[str]:
    """A sentence for each way in which the attack differs from the baseline's, most runs first.

    A run is compared with that of the same id, else with all of the same spec.
    """
    found: Counter[str] = Counter()
    if new.version != old.version:
        told = f"the version of deepmf-sumo was {old.version} and is {new.version}"
        found[told] = len(new.runs)
    sides = _known(new), _known(old)
    chosen = set().union(*(_aimed(*each) for each in zip(sides, (new, old), strict=True)))
    run: Any
    for run in sides[0].itertuples():
        others = sides[1][sides[1]["run_id"] == run.run_id]
        same = len(others) > 0
        if not same:
            others = sides[1][sides[1]["spec"] == run.spec]
        if len(others):
            mine = new.attacks.get(str(run.setup), {})
            ignored = {WHOM} if run.spec in chosen and not same else set()
            each = [old.attacks.get(setup, {}) for setup in dict.fromkeys(others["setup"])]
            apart = [_between(mine, one, differing(mine, one) - ignored) for one in each]
            nearest = min(apart, key=len)
            was = others["moment"].iloc[0] if same else ""
            if was and run.moment and was != run.moment:
                nearest = nearest | {f"the moment was {was} and is {run.moment}"}
            found.update(sorted(nearest))
    return [f"{what} ({count} run{'s' * (count != 1)})" for what, count in found.most_common()]


def _known(side: "RunSet") -> pd.DataFrame:
    """The runs whose setup is known."""
    return side.runs[side.runs["setup"] != ""]


def _aimed(known: pd.DataFrame, side: "RunSet") -> set[str]:
    """Specs whose attacks aim at a vehicle of each moment, as with ``adversary.opponent=met``."""
    whom: dict[str, set[Any]] = {}
    for spec, setup in zip(known["spec"], known["setup"], strict=True):
        whom.setdefault(spec, set()).add(side.attacks.get(setup, {}).get(WHOM))
    return {spec for spec, values in whom.items() if len(values) > 1}


def notes(new: "RunSet", old: "RunSet") -> Iterator[str]:
    """What may also explain a difference, and cannot be told from a change of the planner."""
    ours, theirs = (side.runs[["run_id", "source"]] for side in (new, old))
    pairs = ours.merge(theirs, on="run_id", suffixes=("_new", "_old"))
    told = pairs[(pairs["source_new"] != "") & (pairs["source_old"] != "")]
    changed = int((told["source_new"] != told["source_old"]).sum())
    if changed:
        yield (
            f"the network, its traffic or the recording has other content in {changed} of"
            f" {len(pairs)} pairs: differences may be due to that"
        )
    less = [side.source for side in (new, old) if any(map(_is_less, side.attacks.values()))]
    for source in less:
        yield (
            f"{source} is of an earlier version, which recorded of the attack its adversary,"
            " weights and budget alone: only these are compared"
        )


def _is_less(setup: Mapping[str, Any]) -> bool:
    return _UNRECORDED in setup or "duration_s" not in setup


def differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> set[str]:
    """Names of what differs in two setups; of two different adversaries only ``adversary``."""
    names = a.keys() | b.keys()
    if _is_less(a) or _is_less(b):
        both = a.keys() & b.keys()
        names = {name for name in names if name in both or name.startswith("adversary.")}
    if a.get("adversary") != b.get("adversary"):
        names = {name for name in names if not name.startswith("adversary")} | {"adversary"}
    return {name for name in names if a.get(name, _shown) != b.get(name, _shown)}


def _between(a: Mapping[str, Any], b: Mapping[str, Any], names: Iterable[str]) -> set[str]:
    """``adversary.rule was 'likeliest' and is 'any'``."""
    return {f"{name} was {_shown(b, name)} and is {_shown(a, name)}" for name in names}


def _shown(setup: Mapping[str, Any], name: str) -> str:
    return repr(setup[name]) if name in setup else "not said"


def meant(setup: Mapping[str, Any]) -> str:
    """The profile of a setup with its constraints, see `profiles.described`; empty without one."""
    constraints = setup.get("adversary.constraints", ())
    return described(str(setup.get("profile") or ""), map(str, constraints))
