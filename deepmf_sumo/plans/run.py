"""A plan -> a result folder with the tables of its methods."""

import os
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

from deepmf_sumo.errors import UsageError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.plans import entries, layout, tables
from deepmf_sumo.plans.entries import Entry
from deepmf_sumo.plans.layout import Layout
from deepmf_sumo.plans.plan import Loaded
from deepmf_sumo.results.folder import opened
from deepmf_sumo.results.result import Result
from deepmf_sumo.sweep import batch, shards
from deepmf_sumo.sweep.batch import Progress
from deepmf_sumo.sweep.inputs import fingerprinted
from deepmf_sumo.sweep.shards import Shard, note
from deepmf_sumo.tasks import Part, Task


def run(
    loaded: Loaded,
    options: batch.Options,
    report: Callable[[Progress], None] = lambda _: None,
    shard: Shard | None = None,
) -> list[Result]:
    """Run the plan, or a shard of it, and write runs.csv and the tables.

    Runs begin scene by scene, so that an unfinished benchmark shows all methods; tables are in the
    plan's order. An interrupt leaves the finished runs and their tables behind and is passed on.

    Raises SpecError, UsageError or OutputError before anything runs.
    """
    plan = loaded.plan
    rows = entries.entries_of(loaded, cache_folder())
    planned, read = fingerprinted(entries.tasks_of(rows, plan.seeds))
    outlined = layout.layout_of(plan, rows, planned)
    if options.resume and (options.out / layout.FILE).is_file():
        layout.read_layout(options.out)  # refuses what another version made
    chosen = shard.choose(planned) if shard else planned
    with opened(options.out, resume=options.resume, overwrite=options.overwrite) as store:
        changed = batch.begin(store, chosen, options, read)
        note(options.out, None)
        outlined.write(options.out)
        queue = _scene_by_scene(rows, plan.seeds)
        try:
            return batch.fill(store, chosen, options, report, queue=queue, changed=changed)
        finally:
            if (options.out / "runs.csv").is_file():
                tables.write(options.out)


def expected(out: Path, shard: Shard | None = None) -> int:
    """How many runs the plan of a folder, or a shard of it, has."""
    runs = list(layout.read_layout(out).runs)
    return len(runs[shard.number - 1 :: shard.of]) if shard else len(runs)


def _scene_by_scene(rows: Sequence[Entry], seeds: Sequence[int]) -> Callable[[Task], Any]:
    """Key of the order in which runs begin: own budgets first, then scene, seed, planner, method.

    So a worker reads a scene once for all methods.
    """
    every = (place.scene for entry in rows for place in entry.situations)
    scenes = {scene: number for number, scene in enumerate(dict.fromkeys(every))}
    labels = {entry.label: number for number, entry in enumerate(rows)}
    parts = get_args(Part)
    planners = list(dict.fromkeys(entry.label.planner for entry in rows))

    def key(task: Task) -> tuple[Any, ...]:
        assert task.label is not None
        return (
            parts.index(task.label.part),
            scenes[task.scene],
            seeds.index(task.spec.seed),
            planners.index(task.label.planner),
            labels[task.label],
        )

    return key


def merge(
    out: Path, folders: Sequence[Path], *, overwrite: bool = False
) -> tuple[list[Result], list[str]]:
    """Copy the runs of all shards into ``out``; returns their results and the ids of missing runs.

    Runs that are not there yet are no rows: `benchmark --resume` in ``out`` makes them. Raises
    UsageError for folders of other plans or versions, or that hold a run twice, and OutputError.
    """
    plan = _common(folders)
    found = shards.found_in(folders, plan.runs)
    missing = [run_id for run_id in plan.runs if run_id not in found]
    with shards.joining(out, folders, plan.runs, found, overwrite=overwrite) as store:
        results = shards.copied(store, folders, plan.runs, found)
        plan.write(out)
        store.finish(
            results,
            junit_too=any((folder / "junit.xml").is_file() for folder in folders),
            interrupted=bool(missing),
        )
        tables.write(out)
    return results, missing


def _common(folders: Sequence[Path]) -> Layout:
    """The plan of all shards. Raises UsageError where they differ."""
    first = layout.read_layout(folders[0])
    plan = _placeless(first)
    for folder in folders[1:]:
        other = _placeless(layout.read_layout(folder))
        if other != plan:
            names = (field.name for field in fields(Layout))
            key = next(name for name in names if getattr(plan, name) != getattr(other, name))
            raise UsageError(
                f"{folder} is of another plan than {folders[0]} (they differ in '{key}'); "
                "merge shards of one plan, run on one set of scenes."
            )
    return first


def _placeless(plan: Layout) -> Layout:
    """The plan, of its files the names alone: on another machine they lie elsewhere.

    That their contents are the same is in the keys of its runs.
    """
    return replace(plan, plan=_named(plan.plan))


def _named(value: Any) -> Any:
    """Plain values, in which absolute paths are the names at their ends."""
    if isinstance(value, dict):
        return {key: _named(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_named(each) for each in value]
    return Path(value).name if isinstance(value, str) and value.startswith(os.sep) else value
