"""Runs that a resumed folder has beside those of the command: kept where nothing has changed.

`run a b --out r` and then `run a --out r --resume` leaves the runs of b in the tables. Whether one
is still good is told as for the command's own runs: by the key of its spec, which lies beside it.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from deepmf_sumo import spec as spec_module
from deepmf_sumo.errors import DeepmfError, UsageError
from deepmf_sumo.results import stored
from deepmf_sumo.results.folder import Store
from deepmf_sumo.results.result import IDENTITY, Result
from deepmf_sumo.spec.tasks import Task, is_run_id
from deepmf_sumo.study.sweep.inputs import Input, fingerprinted


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherRuns:
    """What a folder has beside the runs of a command.

    Attributes:
        before, after: results that are kept, in the tables before and after the command's.
        planned: `result.identity` of these, and of runs of other specs that were never begun.
        keys: of the same. read: what the kept ones read.
        stale: ids of those that are in no table any more: their files or the version changed.
    """

    before: tuple[Result, ...] = ()
    after: tuple[Result, ...] = ()
    planned: dict[str, dict[str, Any]] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    read: tuple[Input, ...] = ()
    stale: tuple[str, ...] = ()

    @property
    def kept(self) -> int:
        """Results that are kept."""
        return len(self.before) + len(self.after)

    @property
    def unbegun(self) -> int:
        """Runs of other specs that have no result."""
        return len(self.keys) - self.kept

    def without(self, tasks: Iterable[Task]) -> "OtherRuns":
        """The same but for runs that turn out to be the command's own."""
        own = {task.run_id for task in tasks}
        return replace(
            self,
            before=tuple(one for one in self.before if one["run_id"] not in own),
            after=tuple(one for one in self.after if one["run_id"] not in own),
            planned={name: one for name, one in self.planned.items() if name not in own},
            keys={name: one for name, one in self.keys.items() if name not in own},
            stale=tuple(one for one in self.stale if one not in own),
        )


def others(store: Store, planned: Sequence[Task]) -> OtherRuns:
    """What the folder has beside the planned runs."""
    mine = {task.run_id for task in planned}
    found = {one["run_id"]: one for one in _results(store, mine)}
    marked, read = fingerprinted([task for one in found.values() for task in _task_of(store, one)])
    good = {task.run_id for task in marked if task.key == found[task.run_id]["key"]}
    order = _order(store.out)
    kept = [one for one in sorted(found, key=lambda one: order.get(one, len(order))) if one in good]
    first = min((order[one] for one in mine if one in order), default=len(order))
    front = [one for one in kept if order.get(one, first) < first]
    unbegun = _unbegun(store.out, planned, found)
    identities = {one: {name: found[one][name] for name in IDENTITY} for one in kept}
    return OtherRuns(
        before=tuple(found[one] for one in front),
        after=tuple(found[one] for one in kept if one not in front),
        planned=identities | {run_id: one for run_id, (_, one) in unbegun.items()},
        keys={one: found[one]["key"] for one in kept}
        | {run_id: key for run_id, (key, _) in unbegun.items()},
        read=read,
        stale=tuple(sorted(found.keys() - good)),
    )


def _results(store: Store, without: Collection[str]) -> Iterable[Result]:
    """All other results in a folder; those of an earlier command without tables, too."""
    for file in sorted(store.runs.glob("*/result.json")):
        if is_run_id(file.parent.name) and file.parent.name not in without:
            try:
                found = store.read_run(file.parent.name)
            except UsageError:  # damaged, or of another version
                continue
            if found["run_id"] == file.parent.name:
                yield found


def _task_of(store: Store, result: Result) -> list[Task]:
    """The run as it would be planned today; none where its spec cannot be read any more."""
    file = store.runs / result["run_id"] / "spec.yaml"
    try:
        spec = spec_module.load(file)
    except DeepmfError:
        return []
    return [Task(run_id=result["run_id"], spec=spec, scene=result["scene"])]


def _order(out: Path) -> dict[str, int]:
    """Place of each run in the tables."""
    try:
        return {row["run_id"]: number for number, row in enumerate(stored.rows_of(out))}
    except UsageError:
        return {}


def _unbegun(
    out: Path, planned: Sequence[Task], found: Iterable[str]
) -> dict[str, tuple[str, dict[str, Any]]]:
    """Key and identity of runs of the manifest without a result, of specs that are not named now.

    Those of a spec that is named are as this command plans them.
    """
    try:
        keys, identities = stored.keys_of(out), stored.planned_of(out)
    except UsageError:  # no manifest, or a damaged one
        return {}
    named = {task.spec.name for task in planned}
    gone = keys.keys() - {task.run_id for task in planned} - set(found)
    known = {one: identities[one] for one in sorted(gone) if one in identities}
    return {one: (keys[one], who) for one, who in known.items() if who["spec"] not in named}
