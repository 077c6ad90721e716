"""A plan -> a result folder with the tables of its methods."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

from deepmf_sumo.benchmark import batch
from deepmf_sumo.benchmark.batch import Progress
from deepmf_sumo.benchmark.home import cache_folder
from deepmf_sumo.benchmark.inputs import fingerprinted
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.shards import Shard, note
from deepmf_sumo.benchmark.store import opened
from deepmf_sumo.benchmark.study import entries, layout, tables
from deepmf_sumo.benchmark.study.entries import Entry
from deepmf_sumo.benchmark.study.plan import Loaded
from deepmf_sumo.benchmark.tasks import Part, Task


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
        layout.read(options.out)  # refuses what another version made
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
    runs = list(layout.read(out).runs)
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
